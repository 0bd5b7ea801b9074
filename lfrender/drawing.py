"""Pictures from a flat: all-in-focus, at one patch size, and traditional."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError, Lattice

from .analysis import analyze
from .bending import lattice_bend
from .depthmap import DepthMap
from .flatcheck import check_flat
from .lens_focus import focus_shares
from .mosaic import draw_rows
from .patches import lay_patches
from .radiance import gain_table, lens_by_lens, white_level
from .rendering import Rendering
from .sharpness import lens_blur, ready_to_read
from .surface import Surface
from .visibility import lens_depths
from .warping import Viewpoint

__all__ = ["default_scale", "render"]

# Lenses farther than this many pitches from a scene point add little but blur; those that are nearer than the second
# number suffice to see every point.
_REACH, _REACH_FAST = 1.7, 1.0
# Difference from the mean colour, as a share of white, at which a lens counts a quarter: ghosts differ by more.
_AGREEMENT = 0.2
_LARGEST_SCALE_SHARE = 0.98
# Where patches exceed output pixels by less than this factor, an output pixel is read at one place in any case.
_COARSE = 1.4
# Lenses at which the spacing of a distorted lattice is looked at: it changes slowly over the field.
_PROBES = 500
_MIDDLE = Viewpoint()


def default_scale(depth: DepthMap) -> float:
    """Output pixels per pitch that keep the flat's resolution where patches are largest [px per pitch].

    The paper's full resolution (section 4): as many output pixels per lens as its patch has.
    """
    sizes = np.abs(depth.patch_size[np.isfinite(depth.patch_size)])
    if sizes.size == 0:
        return 1.0
    return max(1.0, float(np.quantile(sizes, _LARGEST_SCALE_SHARE)))


def render(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap | None = None,
    *,
    patch_size: float | None = None,
    scale: float | None = None,
    blend: bool | None = None,
    sharpen: float | Literal["auto"] | None = None,
) -> Rendering:
    """Draw the scene that a flat shows, sharp at every depth.

    Every output pixel is a scene point `X`; a lens at `c` shows it at `c - (X - c) * s / D`
    (Lumsdaine and Georgiev 2008, sections 4 and 5, for both modes by the sign of `s`).

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array, uint8, uint16 or float
    calibration : Calibration
        Of the same image size.
    depth : DepthMap, optional
        Of this flat; analysed first where it is not given.
    patch_size : float, optional [px]
        One signed patch size for all places: the paper's figures 15 and 16. No depth is needed then.
    scale : float, optional
        Output pixels per pitch; by default the flat's full resolution: the largest patch, or `|patch_size|`.
    blend : bool, optional
        True averages all lenses that agree on a point, False reads each point from the lens
        whose centre is nearest. By default True for a depth map and False for one patch size.
    sharpen : float or "auto", optional
        Take back the blur of the microlenses as far as noise allows: "auto" that which is measured on the flat, a
        number that of a square with sides of so many output pixels.

    Returns
    -------
    Rendering
        Image of the flat's dtype and channels.

    Raises
    ------
    FlatError, CalibrationError
        As `analyze`; also if `depth` belongs to another flat size or lattice.
    ValueError
        If both `depth` and `patch_size` are given, or a number makes no picture.
    """
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    if patch_size is not None:
        if depth is not None:
            raise ValueError("give either depth or patch_size, not both")
        if not 0 < abs(patch_size) < lattice.pitch:
            raise ValueError(f"patch_size must lie between 0 and the pitch {lattice.pitch:.1f} px, got {patch_size}")
        surface = Surface(np.full((1, 1), patch_size, np.float32), (0.0, 0.0), 1.0)
        full, sizes = abs(patch_size), np.full(len(lattice), patch_size, np.float32)
    else:
        depth = analyze(pixels, calibration) if depth is None else depth
        if depth.image_size != calibration.image_size or len(depth) != len(lattice):
            raise CalibrationError("the depth map was made with another camera or flat size; analyze this flat")
        surface, full, sizes = depth.surface, default_scale(depth), depth.patch_size
    scale = full if scale is None else scale
    if not (np.isfinite(scale) and 0 < scale <= 4 * lattice.pitch):
        raise ValueError(f"scale must lie between 0 and four times the pitch ({4 * lattice.pitch:.0f}), got {scale}")
    if sharpen is not None and sharpen != "auto" and not (np.isfinite(sharpen) and sharpen >= 0):
        raise ValueError(f"sharpen must be 'auto' or a width of 0 or more output pixels, got {sharpen!r}")
    blend = patch_size is None if blend is None else blend
    if patch_size is not None and not blend and scale == full and _plain(calibration):
        image, valid, affine = _patches(pixels, calibration, patch_size)
        return Rendering(image[:, :, 0] if np.ndim(flat) == 2 and pixels.shape[2] == 1 else image, affine, valid, full)
    blur = lens_blur(pixels, calibration, sizes) if scale * _COARSE < full else 0.0
    reach = _REACH_FAST if depth is not None and depth.preset == "fast" else _REACH
    image, lenses, affine = _draw(pixels, calibration, surface, float(scale), blend, blur, reach=reach)
    if sharpen is not None:
        from .sharpening import sharpened

        image = sharpened(
            image, lenses > 0, sharpen, pixels, calibration, surface, sizes, float(scale), full, blend, blur
        )
    if np.ndim(flat) == 2 and pixels.shape[2] == 1:
        image = image[:, :, 0]
    return Rendering(_like(image, np.asarray(flat).dtype), affine, lenses > 0, float(scale))


def _plain(calibration: Calibration) -> bool:
    """Whether all lenses lie on a straight lattice and have the same light."""
    return calibration.lattice.distortion is None and not lens_by_lens(calibration)


def _patches(
    pixels: NDArray, calibration: Calibration, patch_size: float
) -> tuple[NDArray, NDArray[np.bool_], NDArray[np.float64]]:
    """The picture of one patch size at its full resolution, what was seen, and the affine to scene coordinates."""
    lattice = calibration.lattice
    columns, rows, spacing, first = _grid(lattice, abs(patch_size))
    out = np.empty((rows, columns, pixels.shape[2]), pixels.dtype)
    valid = np.ones((rows, columns), bool)
    left, top, right, bottom = lay_patches(pixels, lattice, patch_size, first, *gain_table(calibration), out)
    # What the kernel has left out, at the border.
    for x0, y0, x1, y1 in (
        (0, 0, columns, top),
        (0, bottom, columns, rows),
        (0, top, left, bottom),
        (right, top, columns, bottom),
    ):
        if x0 < x1 and y0 < y1:
            image, seen = _draw_rows(
                pixels, calibration, Surface(np.full((1, 1), patch_size, np.float32), (0.0, 0.0), 1.0),
                abs(patch_size), (x1 - x0, y1 - y0), np.array([first + x0 * spacing, first + y0 * spacing]),
            )  # fmt: skip
            out[y0:y1, x0:x1] = _like(image, pixels.dtype)
            valid[y0:y1, x0:x1] = seen > 0
    return out, valid, np.array([[spacing, 0.0, first], [0.0, spacing, first]])


def _draw(
    pixels: NDArray,
    calibration: Calibration,
    surface: Surface,
    scale: float,
    blend: bool,
    blur: float,
    *,
    reach: float = _REACH,
    aperture: float = 1.0,
    agreement: float = _AGREEMENT,
    viewpoint: Viewpoint = _MIDDLE,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """The picture in the flat's units, what was seen of each pixel (0..1), and the affine to scene coordinates."""
    columns, rows, spacing, first = _grid(calibration.lattice, scale)
    image, seen = _draw_rows(
        pixels, calibration, surface, scale, (columns, rows), np.array([first, first]), blend, blur, reach, aperture,
        agreement, viewpoint,
    )  # fmt: skip
    return image, seen, np.array([[spacing, 0.0, first], [0.0, spacing, first]])


def _grid(lattice: Lattice, scale: float) -> tuple[int, int, float, float]:
    """Columns and rows of a picture of so many pixels per pitch, their spacing and the first place [px]."""
    width, height = lattice.image_size
    spacing = lattice.pitch / scale
    return max(1, round(width / spacing)), max(1, round(height / spacing)), spacing, 0.5 * spacing - 0.5


def _draw_rows(
    pixels: NDArray,
    calibration: Calibration,
    surface: Surface,
    scale: float,
    size: tuple[int, int],
    first: NDArray[np.float64],
    blend: bool = False,
    blur: float = 0.0,
    reach: float = _REACH,
    aperture: float = 1.0,
    agreement: float = _AGREEMENT,
    viewpoint: Viewpoint = _MIDDLE,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A picture of `size` columns and rows from the scene point `first` on, and what was seen of each pixel."""
    lattice = calibration.lattice
    spacing = lattice.pitch / scale
    image = np.empty((size[1], size[0], pixels.shape[2]), np.float32)
    seen = np.empty((size[1], size[0]), np.float32)
    edge = max(0.5, 0.03 * lattice.pitch)
    seen_depth = np.empty((0, 0), np.float32)
    if blend and surface.patch_size.size > 1:
        seen_depth = lens_depths(surface, lattice, reach * lattice.pitch + viewpoint.parallax(surface, lattice), edge)
    gains, step = gain_table(calibration)
    lights = 1 / gains
    if lens_by_lens(calibration):
        pixels, gains = calibration.flatten(pixels), np.ones_like(gains)
        unlit = _beside(np.isnan(calibration.gain()))
        seen_depth = np.where(unlit, np.float32(np.inf), seen_depth if seen_depth.size else np.float32(np.nan))
    bend, low = lattice_bend(lattice)
    drawn, moved = viewpoint.seen_from(surface, lattice, edge)
    offsets, steps = lens_offsets(lattice, reach * lattice.pitch)
    single = np.float32
    draw_rows(
        # Only a mean over many lenses has the sharpness of the flat where what interpolation blurs is given back.
        ready_to_read(pixels) if blend else pixels, (0,) * pixels.shape[2], seen_depth, gains, lights, single(step),
        lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, bend, low, offsets, steps,
        *focus_shares(calibration.lens_types), single(aperture * lattice.radius), single(lattice.pitch),
        drawn.patch_size, single(drawn.first[0]), single(drawn.first[1]), single(drawn.spacing),
        single(edge), single(scale), first + moved, spacing, single((blur * scale) ** 2),
        single(reach * lattice.pitch), single(agreement * white_level(pixels) if blend else 0.0),
        np.array(viewpoint.offset, single), image, seen,
    )  # fmt: skip
    return image, seen


def _beside(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """These pixels and those beside them, which cannot be read without them."""
    import cv2

    return cv2.dilate(pixels.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool)


def lens_offsets(lattice: Lattice, reach: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """All lenses about one within `reach` and a pitch, the nearest first.

    Returns
    -------
    offsets : (k, 3) float32 [px]
        Offset `x, y` on the straight lattice, and the least distance that such two lenses have on the flat.
    steps : (k, 2) int32
        The same in lattice indices.
    """
    limit = reach + lattice.pitch
    span = np.arange(-1, 2) if limit <= 0 else np.arange(-_span(lattice, limit), _span(lattice, limit) + 1)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    offsets = steps @ lattice.basis
    distance = np.linalg.norm(offsets, axis=1)
    if lattice.distortion is not None:
        ij = lattice.indices()
        some = ij[:: max(1, len(ij) // _PROBES)]
        here = lattice.points(some)
        distance = np.array([np.linalg.norm(lattice.points(some + step) - here, axis=1).min() for step in steps])
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= limit]
    return np.column_stack([offsets, distance])[order].astype(np.float32), steps[order].astype(np.int32)


def _span(lattice: Lattice, limit: float) -> int:
    """Largest lattice index of a point within `limit` of the origin."""
    return int(np.ceil(limit * np.linalg.norm(np.linalg.inv(lattice.basis), axis=0).max()))


def _like(image: NDArray[np.float32], dtype: np.dtype) -> NDArray:
    """Round and clip to the range of `dtype`."""
    if dtype.kind == "f":
        return image.astype(dtype, copy=False)
    return np.clip(np.rint(image), 0, np.iinfo(dtype).max).astype(dtype)
