"""Pictures of the scene as seen from different places in the main lens' aperture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.errors import check_type

from ..data.depth_map import DepthMap, check_depth, default_scale
from ..data.rendering import Rendering, check_scale, finish_picture
from ..depth.analyze import analyze
from ..detail.blur import choose_blur
from ..flat.validation import check_flat
from .blend.lit_flat import LitFlat
from .renderer import Renderer
from .warped_surface import Viewpoint, virtual_depth

__all__ = ["circle_offsets", "grid_offsets", "still_depth", "views", "views_with_depth"]


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

    All microimages are read about the same offset `q` from their centres, which is a viewpoint in
    the main lens. With `q` to the right, the view is that of a camera farther to the right: a scene
    point moves by `q (D / s - D / still)`, near ones to the left of far ones. Places that the
    middle view hides get the depth of the farther surface beside them.

    Parameters
    ----------
    flat, calibration, depth, scale
        As for `render`.
    offsets : iterable of (float, float) [px]
        `q` of each view, order `x, y`, within the usable radius of the microimages,
        `calibration.lattice.radius`.
    still : float, optional [px]
        Signed patch size of scene points that keep their place in all views; infinity for the
        microlens plane. By default that of the median of `D / s`.

    Returns
    -------
    iterator of Rendering
        One per offset, drawn on demand, all of one size. `(0, 0)` is the picture of `render`. The
        affine holds for scene points that keep their place. Errors are those of `render`.

    Examples
    --------
    >>> import lfrender
    >>> left, right = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> left.image.shape, bool((left.image != right.image).any())
    ((47, 62, 3), True)
    """
    return (picture for picture, _ in _prepare(flat, calibration, depth, offsets, scale, still))


def views_with_depth(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    *,
    offsets: Iterable[tuple[float, float]],
    scale: float | None = None,
    still: float,
) -> Iterator[tuple[Rendering, NDArray[np.float32]]]:
    """As `views`, with the signed patch size (h, w) [px] of what each pixel shows.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> found = views_with_depth(flat, camera, depth, offsets=[(4, 0)], scale=6, still=-7.0)
    >>> picture, size = next(found)
    >>> picture.image.shape, size.shape
    ((47, 62, 3), (47, 62))
    """
    check_depth(depth, calibration)
    drawn = _prepare(flat, calibration, depth, offsets, scale, still)
    return ((picture, renderer.seen_depth()) for picture, renderer in drawn)


def still_depth(depth: DepthMap) -> float:
    """Signed patch size [px] of the median of `D / s`: of places that keep their place in all
    views.
    """
    return depth.pitch / float(np.median(virtual_depth(depth.surface.patch_size, depth.pitch)))


def _prepare(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap | None,
    offsets: Iterable[tuple[float, float]],
    scale: float | None,
    still: float | None,
) -> Iterator[tuple[Rendering, Renderer]]:
    """Check what was given at once, and draw on demand."""
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    check_type(offsets, Iterable, "offsets", "give x, y of each view, as grid_offsets does")
    places = [_check_offset(offset, lattice.radius) for offset in offsets]
    if still is not None and not abs(still) > 0:
        raise ValueError(f"still must not be zero, got {still}")
    if depth is None:
        depth = analyze(pixels, calibration)
    check_depth(depth, calibration)
    scale = check_scale(default_scale(depth) if scale is None else scale, lattice.pitch)
    middle = lattice.pitch / (still_depth(depth) if still is None else still)
    renderer = Renderer(
        calibration, depth.surface, scale, True, lens_blur=choose_blur(calibration, depth)
    )
    return _draw(flat, pixels, renderer, [Viewpoint(place, middle) for place in places])


def _draw(
    flat: NDArray, pixels: NDArray, middle: Renderer, points: list[Viewpoint]
) -> Iterator[tuple[Rendering, Renderer]]:
    lit: LitFlat | None = None
    for point in points:
        renderer = replace(middle, viewpoint=point)
        if any(point.offset):
            lit = lit or middle.light(pixels, viewpoints=points)
            renderer = replace(renderer, lit=lit)
        image, valid = renderer.draw(pixels, dtype=pixels.dtype)
        yield (
            finish_picture(
                image, valid, renderer.grid.affine(), middle.scale, flat, middle.calibration
            ),
            renderer,
        )


def _check_offset(offset: tuple[float, float], radius: float) -> tuple[float, float]:
    place = np.array(offset, dtype=float)
    if place.shape != (2,) or not np.hypot(*place) <= radius:
        raise ValueError(
            f"offsets must be x, y within the radius {radius:.2f} px of the microimages, got "
            f"{offset!r}"
        )
    return float(place[0]), float(place[1])


def grid_offsets(rows: int, columns: int, radius: float) -> list[tuple[float, float]]:
    """Viewpoints on a regular grid inscribed in a circle of this radius, row by row from the top
    left [px].

    Examples
    --------
    >>> grid_offsets(1, 3, 4.0)
    [(-4.0, 0.0), (0.0, 0.0), (4.0, 0.0)]
    """
    if min(rows, columns) < 1:
        raise ValueError(f"a grid has at least one row and one column, got {rows} x {columns}")
    # The corners touch the circle; a single row or column takes its whole width.
    spread = np.array([columns > 1, rows > 1], dtype=float)
    half = radius * spread / max(float(np.hypot(*spread)), 1.0)
    across = np.linspace(-half[0], half[0], columns)
    return [(float(x), float(y)) for y in np.linspace(-half[1], half[1], rows) for x in across]


def circle_offsets(count: int, radius: float) -> list[tuple[float, float]]:
    """Viewpoints evenly spread on a circle, from the right clockwise in the picture [px].

    Examples
    --------
    >>> [(round(x), round(y)) for x, y in circle_offsets(4, 10)]
    [(10, 0), (0, 10), (-10, 0), (0, -10)]
    """
    angles = 2 * np.pi * np.arange(count) / max(count, 1)
    return [(float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles]
