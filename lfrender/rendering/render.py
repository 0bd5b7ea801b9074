"""Pictures from a flat: all-in-focus, at one patch size, and traditional."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError

from ..data.depth_map import DepthMap
from ..data.region import check_region
from ..data.rendering import Rendering
from ..data.surface import Surface
from ..data.viewpoint import Viewpoint
from ..depth.analyze import analyze
from ..flat.lens_blur import measure_lens_blur
from ..flat.validation import check_flat
from ..runtime.quantiles import quantile
from .plan import Part, RenderPlan, convert_to_dtype

__all__ = ["default_scale", "expand_roi", "make_plan", "render"]

# Lenses farther than this many pitches from a scene point add little but blur; those that are nearer than the second
# number suffice to see every point.
_REACH, _REACH_FAST = 1.7, 1.0
# Difference from the mean colour, as a share of white, at which a lens counts a quarter: ghosts differ by more.
_AGREEMENT = 0.2
_LARGEST_SCALE_SHARE = 0.98
# Where patches exceed output pixels by less than this factor, an output pixel is read at one place in any case.
_COARSE = 1.4
_MIDDLE = Viewpoint()


def default_scale(depth: DepthMap) -> float:
    """Output pixels per pitch that keep the flat's resolution where patches are largest [px per pitch].

    The paper's full resolution (section 4): as many output pixels per lens as its patch has.
    """
    sizes = np.abs(depth.patch_size[np.isfinite(depth.patch_size)])
    if sizes.size == 0:
        return 1.0
    return max(1.0, quantile(sizes, _LARGEST_SCALE_SHARE))


def render(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap | None = None,
    *,
    patch_size: float | None = None,
    scale: float | None = None,
    blend: bool | None = None,
    sharpen: float | Literal["auto"] | None = None,
    roi: tuple[float, float, float, float] | None = None,
    previous: tuple[NDArray, DepthMap, Rendering] | None = None,
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
    roi : (float, float, float, float), optional [px]
        Draw only the pixels whose scene points lie between `x0, y0` and `x1, y1`, as they are in the whole picture.
        Without `depth` only lenses in there, and those that they need, are analysed.
    previous : (flat, DepthMap, Rendering), optional
        An earlier frame of the same camera and exposure, its depth, and its picture drawn with the same options, whose
        scale is the default then. Pixels keep their colour where no lens that shows them has changed by more than
        noise, and the depth has not: still parts do not flicker. All others are as in a whole new picture. It is quick
        where `depth` was analysed with the same earlier frame as `previous`.

    Returns
    -------
    Rendering
        Image of the flat's dtype and channels.

    Raises
    ------
    FlatError, CalibrationError
        As `analyze`; also if `depth` belongs to another flat size or lattice.
    ValueError
        If both `depth` and `patch_size` are given, a number makes no picture, or `roi` and `sharpen` are given, which
        needs the whole picture; or `previous` without `depth`, with either of these, or of another scale or kind.
    """
    pixels = check_flat(flat, calibration)
    if roi is not None:
        roi = check_region(roi, calibration.lattice)
        if sharpen is not None:
            raise ValueError("sharpen needs the whole picture; give either roi or sharpen")
    if sharpen is not None and sharpen != "auto" and not (np.isfinite(sharpen) and sharpen >= 0):
        raise ValueError(f"sharpen must be 'auto' or a width of 0 or more output pixels, got {sharpen!r}")
    if previous is not None:
        _check_previous(previous[2], pixels, depth, scale, roi is not None or sharpen is not None)
        scale = previous[2].scale
    if patch_size is None and depth is None:
        depth = analyze(pixels, calibration, roi=roi and expand_roi(roi, calibration))

    def look(part: Part) -> NDArray:
        return pixels[part[1] : part[3], part[0] : part[2]]

    drawing = make_plan(look, calibration, depth, patch_size, scale, blend)
    part = (0, 0, *drawing.size) if roi is None else drawing.part_of_region(roi)
    if previous is None:
        image, valid = drawing.draw(pixels, part=part, stored=sharpen is None)
    else:
        image, valid = _redrawn(drawing, pixels, depth, *previous)
    if sharpen is not None:
        from .sharpen import sharpen_picture

        one = np.full(len(calibration.lattice), patch_size, np.float32)
        sizes, full = (one, abs(drawing.scale)) if depth is None else (depth.patch_size, default_scale(depth))
        image = sharpen_picture(
            image.astype(np.float32), valid, sharpen, pixels, calibration, drawing.surface, sizes,
            drawing.scale, full, drawing.blend, drawing.blur,
        )  # fmt: skip
    if np.ndim(flat) == 2 and pixels.shape[2] == 1:
        image = image[:, :, 0]
    affine = drawing.affine
    affine[:, 2] += affine[:, :2] @ part[:2]
    return Rendering(
        convert_to_dtype(image, np.asarray(flat).dtype), affine, valid, drawing.scale, calibration.white_level
    )


def _check_previous(
    picture: Rendering, pixels: NDArray, depth: DepthMap | None, scale: float | None, part: bool
) -> None:
    """Refuse an earlier picture that this frame cannot follow."""
    if depth is None or part:
        raise ValueError("previous needs depth, and the whole picture without roi and sharpen")
    if scale is not None and scale != picture.scale:
        raise ValueError(f"the earlier picture has scale {picture.scale}, not {scale}; draw without previous")
    channels = picture.image.shape[2] if picture.image.ndim == 3 else 1
    if picture.image.dtype != pixels.dtype or channels != pixels.shape[2]:
        raise ValueError(
            f"the earlier picture is {channels} x {picture.image.dtype}, the flat {pixels.shape[2]} x {pixels.dtype}; "
            "draw without previous"
        )


def _redrawn(
    drawing: RenderPlan, pixels: NDArray, depth: DepthMap | None, earlier: NDArray, before: DepthMap, picture: Rendering
) -> tuple[NDArray, NDArray[np.bool_]]:
    """The picture, drawn anew where it may differ from the earlier one."""
    from ..depth.incremental import changed_since
    from .redraw import find_changed_pixels

    assert depth is not None
    earlier = check_flat(earlier, drawing.calibration)
    columns, rows = drawing.size
    if picture.image.shape[:2] != (rows, columns) or earlier.shape != pixels.shape or earlier.dtype != pixels.dtype:
        raise ValueError("the earlier frame or its picture is of another kind or size; draw without previous")
    changed = changed_since(before, depth, earlier, pixels, drawing.calibration)
    wanted = find_changed_pixels(drawing, before.surface, changed)
    return drawing.render_changed(pixels, wanted, picture.image.reshape(rows, columns, -1), picture.valid)


def expand_roi(roi: tuple[float, float, float, float], calibration: Calibration) -> tuple[float, float, float, float]:
    """The part of the flat `x0, y0, x1, y1` [px] whose lenses show a part of the scene."""
    margin = _REACH * calibration.lattice.pitch
    return roi[0] - margin, roi[1] - margin, roi[2] + margin, roi[3] + margin


def make_plan(
    look: Callable[[Part], NDArray],
    calibration: Calibration,
    depth: DepthMap | None,
    patch_size: float | None,
    scale: float | None,
    blend: bool | None,
) -> RenderPlan:
    """What `render` draws; `look` gives the pixels (h, w, C) of a part of the flat."""
    lattice = calibration.lattice
    if patch_size is not None:
        if depth is not None:
            raise ValueError("give either depth or patch_size, not both")
        if not 0 < abs(patch_size) < lattice.pitch:
            raise ValueError(f"patch_size must lie between 0 and the pitch {lattice.pitch:.1f} px, got {patch_size}")
        surface = Surface(np.full((1, 1), patch_size, np.float32), (0.0, 0.0), 1.0)
        full, sizes = abs(patch_size), np.full(len(lattice), patch_size, np.float32)
    else:
        if depth is None:
            raise ValueError("give depth or patch_size")
        if depth.image_size != calibration.image_size or len(depth) != len(lattice):
            raise CalibrationError("the depth map was made with another camera or flat size; analyze this flat")
        surface, full, sizes = depth.surface, default_scale(depth), depth.patch_size
    scale = full if scale is None else scale
    if not (np.isfinite(scale) and 0 < scale <= 4 * lattice.pitch):
        raise ValueError(f"scale must lie between 0 and four times the pitch ({4 * lattice.pitch:.0f}), got {scale}")
    blend = patch_size is None if blend is None else blend
    blur = measure_lens_blur(look, calibration, sizes) if scale * _COARSE < full else 0.0
    reach = _REACH_FAST if depth is not None and depth.preset == "fast" else _REACH
    return RenderPlan(calibration, surface, float(scale), blend, blur, reach, _AGREEMENT)


def render_plan(
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
    stored: bool = False,
) -> tuple[NDArray, NDArray[np.bool_], NDArray[np.float64]]:
    """The picture in the flat's units, which of its pixels some lens has seen, and the affine to scene coordinates."""
    drawing = RenderPlan(calibration, surface, scale, blend, blur, reach, agreement, aperture, viewpoint)
    return *drawing.draw(pixels, stored=stored), drawing.affine
