"""Pictures of the scene as seen from different places in the main lens' aperture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..data.viewpoint import Viewpoint, virtual_depth
from ..depth.analyze import analyze
from ..flat.lens_blur import measure_lens_blur
from ..flat.validation import check_flat
from .render import _COARSE, convert_to_dtype, default_scale, render_plan

__all__ = ["circle_offsets", "grid_offsets", "views"]


def views(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap | None = None,
    *,
    offsets: Iterable[tuple[float, float]],
    scale: float | None = None,
    still: float | None = None,
) -> Iterator[Rendering]:
    """Draw the scene sharp at every depth, as seen from places in the main lens' aperture.

    All microimages are read about the same offset `q` from their centres, which is a viewpoint in the main lens. With
    `q` to the right, the view is that of a camera farther to the right: a place moves by `q (D / s - D / still)` in
    scene coordinates, near places to the left of far ones.

    What is hidden from the middle takes the depth of the farther surface beside it and is read from the lenses
    that do see it.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array, uint8, uint16 or float
    calibration : Calibration
        Of the same image size.
    depth : DepthMap, optional
        Of this flat; analysed first where it is not given.
    offsets : iterable of (float, float) [px]
        `q` of each view, order `x, y`, within the usable radius of the microimages, `calibration.lattice.radius`.
    scale : float, optional
        Output pixels per pitch; by default the flat's full resolution.
    still : float, optional [px]
        Signed patch size of places that are at the same place in all views; infinity for the microlens plane. By
        default that of the median of `D / s`.

    Returns
    -------
    iterator of Rendering
        One per offset, drawn when asked for, all of one size. `(0, 0)` is the picture of `render`. The affine holds for
        the places that stay; pixels are valid where a lens shows their place.

    Raises
    ------
    FlatError, CalibrationError
        As `render`.
    ValueError
        If a number makes no picture.
    """
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    places = [_checked(offset, lattice.radius) for offset in offsets]
    if still is not None and not abs(still) > 0:
        raise ValueError(f"still must not be zero, got {still}")
    if scale is not None and not (np.isfinite(scale) and 0 < scale <= 4 * lattice.pitch):
        raise ValueError(f"scale must lie between 0 and four times the pitch ({4 * lattice.pitch:.0f}), got {scale}")
    if depth is not None and (depth.image_size != calibration.image_size or len(depth) != len(lattice)):
        raise CalibrationError("the depth map was made with another camera or flat size; analyze this flat")
    depth = analyze(pixels, calibration) if depth is None else depth
    if still is None:
        middle = float(np.median(virtual_depth(depth.surface.patch_size, lattice.pitch)))
    else:
        middle = lattice.pitch / still
    plain = np.ndim(flat) == 2 and pixels.shape[2] == 1
    points = [Viewpoint(place, middle) for place in places]
    return _drawn(pixels, calibration, depth, points, scale, np.asarray(flat).dtype, plain)


def _drawn(
    pixels: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    points: list[Viewpoint],
    scale: float | None,
    dtype: np.dtype,
    plain: bool,
) -> Iterator[Rendering]:
    full = default_scale(depth)
    scale = float(full if scale is None else scale)
    blur = measure_lens_blur(pixels, calibration, depth.patch_size) if scale * _COARSE < full else 0.0
    for point in points:
        image, valid, affine = render_plan(
            pixels, calibration, depth.surface, scale, True, blur, viewpoint=point, stored=True
        )
        yield Rendering(
            convert_to_dtype(image[:, :, 0] if plain else image, dtype), affine, valid, scale, calibration.white_level
        )


def _checked(offset: tuple[float, float], radius: float) -> tuple[float, float]:
    place = np.array(offset, dtype=float)
    if place.shape != (2,) or not np.hypot(*place) <= radius:
        raise ValueError(f"offsets must be x, y within the radius {radius:.2f} px of the microimages, got {offset!r}")
    return float(place[0]), float(place[1])


def grid_offsets(rows: int, columns: int, radius: float) -> list[tuple[float, float]]:
    """Viewpoints on a regular grid inscribed in a circle, row by row from the top left [px].

    Parameters
    ----------
    rows, columns : int
    radius : float [px]
        Of that circle.
    """
    if min(rows, columns) < 1:
        raise ValueError(f"a grid has at least one row and one column, got {rows} x {columns}")
    # The corners touch the circle; a single row or column takes its whole width.
    spread = np.array([columns > 1, rows > 1], dtype=float)
    half = radius * spread / max(float(np.hypot(*spread)), 1.0)
    return [(float(x), float(y)) for y in np.linspace(-half[1], half[1], rows) for x in _row(half[0], columns)]


def _row(half: float, columns: int) -> NDArray[np.float64]:
    return np.linspace(-half, half, columns)


def circle_offsets(count: int, radius: float) -> list[tuple[float, float]]:
    """Viewpoints evenly spread on a circle, from the right clockwise in the picture [px]."""
    angles = 2 * np.pi * np.arange(count) / max(count, 1)
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles]
