"""All-in-focus pictures, and those of one patch size."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import replace

from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.errors import check_type
from lfcal.runtime.progress import Progress, show_progress

from ..data.depth_map import DEPTH_ADVICE, DepthMap, check_depth, default_scale
from ..data.rendering import Part, Rendering, check_patch_size, check_scale, finish_picture
from ..data.surface import constant_surface
from ..depth.analyze import analyze
from ..depth.region import check_region
from ..detail.blur import choose_blur
from ..detail.noise import measure_noise
from ..flat.capture import complete_capture
from ..flat.validation import check_flat, exposure_rows, match_exposure
from ..runtime.choices import Detail, check_choice
from .redraw import redraw
from .renderer import REACH, Renderer
from .traditional import TOO_LITTLE, find_depth_problem, traditional

__all__ = ["expand_roi", "make_renderer", "render"]


def render(
    flat: NDArray | str | os.PathLike[str],
    calibration: Calibration | None = None,
    depth: DepthMap | None = None,
    *,
    patch_size: float | None = None,
    scale: float | None = None,
    blend: bool | None = None,
    detail: Detail | None = None,
    roi: tuple[float, float, float, float] | None = None,
    previous: tuple[NDArray, DepthMap, Rendering] | None = None,
    progress: Progress = None,
) -> Rendering:
    """Draw the scene that a flat shows, sharp at every depth.

    Every output pixel is a scene point `X`; a lens at `c` shows it at `c - (X - c) * s / D`
    (Lumsdaine and Georgiev 2008, sections 4 and 5, for both modes by the sign of `s`).

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array, uint8, uint16 or float, or path-like
        A raw mosaic of colour filters is demosaicked.
    calibration : Calibration, optional
        Of the same image size; by default the flat itself is calibrated.
    depth : DepthMap, optional
        Of this flat; analysed first if it is not given.
    patch_size : float, optional [px]
        One signed patch size for all places: the paper's figures 15 and 16. No depth is needed
        then.
    scale : float, optional
        Output pixels per pitch; by default the flat's full resolution: the largest patch, or
        `|patch_size|`.
    blend : bool, optional
        True averages all lenses that agree on a point, False reads each point from the lens
        whose centre is nearest. By default True for a depth map and False for one patch size.
    detail : "natural" or "off", optional
        Undo the blur by pixels and microlenses, place by place, as noise, seams and depth edges
        allow; that of the microlenses as far as the camera tells it (`Calibration.lens_blur`). By
        default "natural" for the mean over lenses of a depth map; with `previous` as in that
        picture.
    roi : (float, float, float, float), optional [px]
        Draw only the pixels whose scene points lie between two opposite corners, with the bits of
        the whole picture. Without `depth`, only the lenses in there are analysed.
    previous : (flat, DepthMap, Rendering), optional
        An earlier frame of the same camera and exposure, its depth, and its picture drawn with the
        same options. Pixels whose depth and lenses have not changed by more than noise keep their
        colour, so that still parts do not flicker; all others are as in a new picture. Fast if
        `depth` was analysed with the same `previous` frame.
    progress : bool or callable, optional
        As in `analyze`: of the analysis, if there is one, then of the drawing.

    Returns
    -------
    Rendering
        Image of the flat's dtype and channels. Where next to no lens has a depth, and no option
        asks for more, it is the traditional picture, with a UserWarning: one pixel per pitch, all
        else would be made up. FlatError and CalibrationError are raised as by `analyze`, ValueError
        if options exclude each other or make no picture.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> flat = np.full((300, 400), 100, np.uint8)
    >>> render(flat, camera, patch_size=-5).image.shape
    (75, 100)
    """
    flat, calibration = complete_capture(flat, calibration)
    pixels = check_flat(flat, calibration)
    if depth is not None:
        check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
    if roi is not None:
        roi = check_region(roi, calibration.lattice)
    if detail is not None:
        check_choice(detail, Detail, "detail")
    if detail == "natural" and (patch_size is not None or blend is False):
        raise ValueError(f"detail={detail!r} needs a depth map and the mean over lenses")
    if previous is not None:
        if not (
            isinstance(previous, tuple)
            and [type(one) for one in previous[1:]] == [DepthMap, Rendering]
        ):
            raise TypeError("previous must be (flat, DepthMap, Rendering) of an earlier frame")
        if depth is None or roi is not None:
            raise ValueError("previous needs depth, and the whole picture without roi")
        if scale is not None and scale != previous[2].scale:
            raise ValueError(
                f"the earlier picture has scale {previous[2].scale}, not {scale}; draw without "
                "previous"
            )
        scale = previous[2].scale
    if patch_size is None and depth is None:
        depth = analyze(
            pixels, calibration, roi=roi and expand_roi(roi, calibration), progress=progress
        )
    plain = all(option is None for option in (patch_size, scale, blend, roi, previous))
    if (
        depth is not None
        and plain
        and depth.image_size == calibration.image_size
        and find_depth_problem(depth)
    ):
        warnings.warn(TOO_LITTLE.format("scale"), stacklevel=2)
        return traditional(flat, calibration)
    exposed = match_exposure(pixels[exposure_rows(len(pixels))], calibration)
    noise = None
    if previous is not None:
        # Pixels that stay were restored against the noise measured then.
        noise = previous[2].noise
        detail = "off"
    with show_progress(progress, "render") as step:
        renderer = make_renderer(
            lambda part: pixels[part[1] : part[3], part[0] : part[2]],
            exposed,
            depth,
            patch_size,
            scale,
            blend,
            detail,
            noise,
        )
        step(1, 2)
        part = renderer.grid.whole if roi is None else renderer.grid.part_of_region(roi)
        if previous is None:
            image, valid = renderer.draw(pixels, part=part, dtype=pixels.dtype)
        else:
            assert depth is not None
            image, valid = redraw(renderer, pixels, exposed, depth, *previous)
        step(2, 2)
    picture = finish_picture(
        image, valid, renderer.grid.affine(part), renderer.grid.scale, flat, calibration
    )
    return replace(picture, noise=renderer.noise)


def expand_roi(
    roi: tuple[float, float, float, float], calibration: Calibration
) -> tuple[float, float, float, float]:
    """The part of the flat `x0, y0, x1, y1` [px] whose lenses show a part of the scene."""
    roi = check_region(roi, calibration.lattice)
    margin = REACH * calibration.lattice.pitch
    return roi[0] - margin, roi[1] - margin, roi[2] + margin, roi[3] + margin


def make_renderer(
    look: Callable[[Part], NDArray],
    calibration: Calibration,
    depth: DepthMap | None,
    patch_size: float | None,
    scale: float | None,
    blend: bool | None,
    detail: Detail | None = None,
    noise: float | None = None,
) -> Renderer:
    """What draws the picture of `render`, against this `noise` if it is given; `look` gives pixels
    (h, w, C) of the flat.
    """
    lattice = calibration.lattice
    reach = REACH
    if (depth is None) == (patch_size is None):
        raise ValueError(
            "give either depth or patch_size, not both"
            if depth is not None
            else "give depth or patch_size"
        )
    if patch_size is not None:
        check_patch_size(patch_size, lattice.pitch)
        surface = constant_surface(patch_size)
        full = abs(patch_size)
    else:
        assert depth is not None
        check_depth(depth, calibration)
        surface = depth.surface
        full = default_scale(depth)
        # Enough lenses to see every point, in two thirds of the time.
        reach = 1.0 if depth.preset == "fast" else reach
    scale = check_scale(full if scale is None else scale, lattice.pitch)
    blend = patch_size is None if blend is None else blend
    if noise is None and blend and depth is not None and detail != "off":
        noise = measure_noise(look, calibration)
    blur = None if depth is None else choose_blur(calibration, depth)
    return Renderer(calibration, surface, scale, blend, reach=reach, lens_blur=blur, noise=noise)
