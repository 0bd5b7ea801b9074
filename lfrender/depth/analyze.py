"""Depth analysis of a flat: the signed patch size of every microlens, from its neighbours alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.progress import Progress, show_progress

from ..data.depth_map import DepthMap
from ..data.flat_samples import sample_flat
from ..flat.lens_blur import find_lens_blur
from ..flat.validation import check_flat, exposure_rows, match_exposure, verify_camera
from ..runtime.choices import Preset, Shortcut, check_choice
from .incremental import update_depth
from .pipeline import estimate_part, locate_part_edges, prepare_flat
from .presets import PRESETS, Shortcuts
from .region import Part, check_region, embed_region, rescale_depth, select_lenses

__all__ = ["PRESETS", "analyze"]

# Of an analysis, for its progress: reading the flat, matching, edges, blur of the microlenses.
_STAGES = 4


def analyze(
    flat: NDArray,
    calibration: Calibration,
    preset: Preset = "balanced",
    *,
    skip: bool | Iterable[Shortcut] = True,
    roi: tuple[float, float, float, float] | None = None,
    previous: tuple[NDArray, DepthMap] | None = None,
    edges: bool | None = None,
    check: bool = True,
    progress: Progress = None,
) -> DepthMap:
    """Estimate the signed patch size, mode and magnification of every microlens.

    Neighbouring microimages are correlated over all signed shifts at once (Lumsdaine and Georgiev
    2008, sections 4 to 6: telescopic and binocular differ only in the sign), semi-global matching
    along the lattice chooses one shift, and that is refined on the pixels of every pair, to a plane
    through each lens.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
        Raw capture; integers are taken relative to the `white_level` of the camera or the range of
        their type, floats to 1.
    calibration : Calibration
        Of the same image size.
    preset : {"fast", "balanced"}
        How much time to spend.
    skip : bool or names
        Shortcuts to take: True all, False none (the exhaustive search), or some of `"blank"`,
        `"ranges"`, `"still"`, `"steady"` (see `Shortcuts`). `DepthMap.saved` has the share of the
        work that each has saved.
    roi : (x0, y0, x1, y1), optional [px]
        Only lenses with their centre between these opposite corners are analysed; the others are
        unresolved.
    previous : (flat, DepthMap), optional
        An earlier frame of the same camera and exposure, and its depth with the same preset: lenses
        whose pixels, and those of their neighbours, have not changed keep it; so do lenses that
        still match at that depth. Over many frames with slow changes give the frame that was
        analysed, not the last one, or changes smaller than the noise add up.
    edges : bool, optional
        Locate depth edges of the surface on the pixels of the microimages, which draws scenes with
        occlusion 1 to 3 dB better and takes about as long as the rest of `"balanced"`. By default
        `"balanced"` does so.
    check : bool
        Check first that the flat shows the lattice of this camera, as `lfcal.check_camera` does,
        and warn where it is slightly stretched or turned; not done with `previous`.
    progress : bool or callable, optional
        True shows a bar on a terminal or in a notebook, and compiles the kernels of a new
        installation first; a function is called with the numbers of finished and of all stages.

    Returns
    -------
    DepthMap

    Raises
    ------
    FlatError
        If `flat` is not a picture of finite numbers, or the earlier flat is of another kind.
    CalibrationError
        If `calibration` was made for another image size.
    CameraError
        If the flat was made with another camera, or its microimages lie beside those of this one.
    ValueError
        If an option has no meaning, or no lens lies in `roi`.

    Examples
    --------
    A plane with a patch size of 6 px: a pixel at `delta` from the centre `c` of its lens shows
    `X = c - delta * D / s`.

    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (300, 240), 9.5))
    >>> y, x = np.mgrid[:240, :300]
    >>> u, v = (10 + p // 20 * 20 - (p % 20 - 10) * 20 / 6 for p in (x, y))
    >>> waves = np.sin(u / 7 + 2 * np.sin(v / 31)) + np.sin(v / 8 + 3 * np.sin(u / 43))
    >>> flat = 0.5 + 0.2 * waves
    >>> depth = analyze(flat, camera, "fast")
    >>> round(float(np.nanmedian(depth.patch_size)), 1)
    6.0
    """
    check_choice(preset, Preset, "preset")
    edges = PRESETS[preset].edges if edges is None else edges
    shortcuts = Shortcuts.of(skip)
    flat = check_flat(flat, calibration)
    if check and previous is None:
        verify_camera(flat, calibration)
    calibration = match_exposure(flat[exposure_rows(len(flat))], calibration)
    lattice = calibration.lattice
    if previous is not None and not (
        isinstance(previous, tuple) and isinstance(previous[-1], DepthMap)
    ):
        raise TypeError("previous must be (flat, DepthMap) of an earlier frame")
    inside = None if roi is None else select_lenses(check_region(roi, lattice), lattice)
    if previous is not None and shortcuts.still:
        if inside is not None:
            raise ValueError("give either roi or previous, not both")
        return replace(
            update_depth(flat, calibration, preset, shortcuts, edges, *previous),
            flat_samples=sample_flat(flat),
            lens_blur=previous[-1].lens_blur,
        )
    with show_progress(progress, "analyze") as step:
        gray, small, factor = prepare_flat(flat, calibration, preset)
        part = Part(gray, small, preset)
        if inside is not None:
            part = part.crop(inside)
        step(1, _STAGES)
        depth = estimate_part(part, shortcuts)
        step(2, _STAGES)
        depth = locate_part_edges(part, depth) if edges else depth
        step(3, _STAGES)
        if inside is not None:
            depth = embed_region(depth, part.lattice, small, inside)
        depth = rescale_depth(depth, lattice, factor, flat_samples=sample_flat(flat))
        blur = find_lens_blur(flat, (0, 0), calibration, depth.patch_size)
        step(_STAGES, _STAGES)
    return replace(depth, lens_blur=blur)
