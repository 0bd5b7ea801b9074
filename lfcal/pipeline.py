"""Calibrate a focused plenoptic camera from its flats, white or scene, with nothing else given."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera.calibration import Calibration
from .images.mosaic import balance_mosaic, check_mosaic, find_mosaic
from .lattice.stated import LatticeHint
from .runtime.errors import CalibrationError
from .runtime.image_formats import Mosaic
from .runtime.progress import Progress, Step, show_progress

if TYPE_CHECKING:
    from .lattice_search import FittedLattice

__all__ = ["SURE_CONFIDENCE", "calibrate"]

#: A calibration of less confidence is doubtful, and has a warning.
SURE_CONFIDENCE = 0.8
# Confidence where most of the flat is dark, and the lattice there follows from the rest alone.
_DARK_CONFIDENCE = 0.4
# Share of clipped pixels from which on a white image is over-exposed.
_CLIPPED = 0.02
# Of a calibration, for its progress: lattice, light of the microimages, blur of their rims.
_STAGES = 3


def calibrate(
    image: ArrayLike | str | os.PathLike[str] | Sequence[ArrayLike | str | os.PathLike[str]],
    kind: Literal["auto", "white", "scene"] = "auto",
    mosaic: Mosaic | None = None,
    pitch: float | None = None,
    rotation: float | None = None,
    progress: Progress = None,
) -> Calibration:
    """Find the microlens lattice on one or more flats of a camera.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array_like, path-like, or a sequence of such
        Raw sensor picture of any integer or float type: a white image or any scene; a path is read
        with `read_flat`. Several are combined: white images are added, weighted by their exposure
        and without clipped pixels; of scenes the edges between microimages are averaged. Flats
        without contrast, such as dark or saturated ones, are left out.
    kind : {"auto", "white", "scene"}
        What the flats show; `"auto"` decides by whether microimages are evenly lit inside. Where
        some of several are white images, only these are used.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"} or None
        Colour filters over the top left 2 x 2 pixels of a flat (h, w). With None they are found, if
        there are any; which of them are red and which blue is a guess then, with a warning.
    pitch : float or None [px]
        Hint where a lattice is hard to find: mean distance between neighbouring centres, right to a
        tenth. Only lattices with this pitch are considered; the confidence is measured on the flat
        as without the hint.
    rotation : float or None [degrees]
        With `pitch`: rotation as `lfcal info` prints it, right to 2 degrees.
    progress : bool or callable, optional
        True shows a bar on a terminal or in a notebook, and compiles the kernels of a new
        installation first; a function is called with the numbers of finished and of all stages.

    Returns
    -------
    Calibration
        Flats of more than 48 megapixels are averaged in square blocks of pixels first, or, where
        their pitch is too short for that and they are white images, calibrated on parts of them and
        on the light of each lens: they list no defects of single pixels. `confidence` is the
        probability that the lattice is right, by its `evidence`; below 0.8 there is a warning.

    Raises
    ------
    FlatError
        If an image cannot be a flat: wrong shape, NaN, too small, or of another size than the
        first.
    CalibrationError
        If no trustworthy lattice is on it.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:240, :300]
    >>> distance = np.hypot((x - 9) % 20 - 10, (y - 6) % 20 - 10)
    >>> noise = np.random.default_rng(0).normal(20, 2, x.shape)
    >>> white = 200 * np.clip(9.5 - distance, 0, 1) + noise
    >>> camera = calibrate(white)
    >>> camera.source, round(camera.lattice.pitch, 2)
    ('white', 20.0)
    """
    if kind not in ("auto", "white", "scene"):
        raise ValueError(f"kind must be 'auto', 'white' or 'scene', got {kind!r}")
    if rotation is not None and pitch is None:
        raise ValueError("rotation is a hint beside pitch; give both")
    hint = None if pitch is None else LatticeHint(pitch, rotation)
    # Compiled code is loaded only once there is a flat.
    from .images.stack import check_flats

    flats = check_flats(image)
    with show_progress(progress, "calibrate") as step:
        return _combine(flats, kind, mosaic, hint, step)


def _combine(
    flats: list[NDArray[Any]],
    kind: str,
    mosaic: Mosaic | None,
    hint: LatticeHint | None,
    step: Step,
) -> Calibration:
    """The calibration of flats, with their white level, mosaic, exposure and blur."""
    from threadpoolctl import threadpool_limits

    from .detection.downscale import choose_block_size
    from .images.stack import estimate_white_level, measure_overexposure

    clipped = max(measure_overexposure(flat) for flat in flats)
    for flat in flats:
        check_mosaic(mosaic, flat)
    found = [mosaic] if mosaic is not None else [find_mosaic(flat) for flat in flats]
    try:
        # The equations are too small for more threads to pay off.
        with threadpool_limits(1, "blas"):
            filtered = any(found) and all(flat.ndim == 2 for flat in flats)
            block = choose_block_size(flats[0], filtered)
            camera = _calibrate(flats, block, kind, filtered, hint, step)
    except CalibrationError as error:
        if clipped <= _CLIPPED:
            raise
        raise CalibrationError(
            f"{error} ({clipped:.0%} of the pixels are over-exposed: expose less)"
        ) from error
    if camera.source == "white" and clipped > _CLIPPED:
        warning = (
            f"the white image is over-exposed ({clipped:.0%} of its pixels are clipped): expose "
            "less, by a half or more"
        )
        camera = replace(camera, warnings=(*camera.warnings, warning))
    camera = replace(camera, white_level=estimate_white_level(flats), mosaic=mosaic)
    for one in found:
        if mosaic is None and one is not None:
            camera = camera.with_mosaic(one, guessed=True)
    if camera.source == "white" and camera.mosaic is not None and flats[0].ndim == 2:
        level = camera.white_level
        balance = balance_mosaic(flats[0], camera.mosaic, level, camera.encoded)
        camera = replace(camera, white_balance=balance)
    # Rims of several lens types take seconds to fit: of scenes, those of one type are measured.
    quick = camera.source == "white" or camera.lens_types is None
    sure = camera.confidence >= SURE_CONFIDENCE
    if quick and sure:
        from .lens_blur.rims import measure_rims

        camera = replace(camera, lens_blur=measure_rims(flats[0], camera))
    if sure:
        camera = replace(camera, flats=tuple(map(camera.digest, flats)))
    step(_STAGES, _STAGES)
    return camera


def _calibrate(
    flats: list[NDArray[Any]],
    block: int,
    kind: str,
    filtered: bool,
    hint: LatticeHint | None,
    step: Step,
) -> Calibration:
    """The calibration of flats that may be averaged in squares of `block` px."""
    from .detection.downscale import average_blocks, choose_block_size, upscale_calibration
    from .lattice_search import find_lattice

    found = None
    if len(flats) == 1 and kind != "scene" and hint is None:
        found = _find_large(flats[0], kind, filtered, block)
    if found is None and block > 1:
        size = flats[0].shape[1], flats[0].shape[0]
        small = hint and hint.scaled(block)
        averaged = [average_blocks(flat, block) for flat in flats]
        again = choose_block_size(averaged[0], False)
        camera = _calibrate(averaged, again, kind, False, small, step)
        return upscale_calibration(camera, block, size)
    found = found or find_lattice(flats, kind, filtered, hint)
    step(1, _STAGES)
    camera = _measure(found)
    step(2, _STAGES)
    return camera


def _find_large(flat: NDArray[Any], kind: str, filtered: bool, block: int) -> FittedLattice | None:
    """The lattice of a large white image from parts of it; None where the flat is to be calibrated
    as a whole.
    """
    from .detection.downscale import LARGE, PIECES
    from .lattice_search import find_lattice_of_large

    pixels = flat.shape[0] * flat.shape[1]
    found = None
    if pixels >= LARGE * block**2:
        found = find_lattice_of_large(flat, kind, filtered, in_crops=True)
    if found is None and block == 1 and not filtered and pixels >= PIECES:
        found = find_lattice_of_large(flat, kind, False, in_crops=False)
    return found


def _measure(found: FittedLattice) -> Calibration:
    """The calibration with illumination, defects and lens types, and what is doubtful about it."""
    from .illumination.measure import measure_illumination
    from .lens_types.classify import find_lens_types

    fit = found.fit
    picture = found.picture
    white = found.white
    light = measure_illumination(
        picture,
        fit.lattice,
        white,
        fit.cut,
        found.read_crop,
        lambda lattice: find_lens_types(picture, lattice, white),
    )
    confidence = found.probability
    warnings = list(light.warnings)
    if fit.doubt is not None:
        warnings.append(fit.doubt)
    dark = None
    if not white and isinstance(picture, np.ndarray):
        dark = _find_dark_rest(picture, fit.lattice.pitch)
    if dark is not None:
        warnings.append(dark)
        confidence = min(confidence, _DARK_CONFIDENCE)
    if confidence < SURE_CONFIDENCE:
        warnings.append(
            f"the lattice is uncertain (probability {confidence:.2f}): "
            f"{found.evidence.describe_doubt()}; check the circles on the flat ('lfcal show') or "
            "calibrate on a white image"
        )
    types = light.lens_types
    if types and not types.ordered:
        warnings.append(
            f"{types.count} lens types were found, but not which is focused at which depth; "
            "calibrate on a scene with detail at several depths"
        )
    return Calibration(
        fit.lattice.with_radius(light.radius),
        light.vignetting,
        source="white" if white else "scene",
        residual_rms=fit.residual_rms,
        lenses_used=fit.lenses_used,
        confidence=confidence,
        warnings=tuple(warnings),
        lens_types=types,
        gain_map=light.gain_map,
        defects=light.defects,
        errors=fit.errors,
        residuals=fit.residuals,
        evidence=found.evidence,
    )


def _find_dark_rest(picture: NDArray[np.float32], pitch: float) -> str | None:
    """A warning if the convex hull of the light of a scene (h, w) leaves out much of the flat."""
    import cv2

    from .microimage.lit import UNLIT, is_lit

    side = int(np.ceil(pitch))
    mean = cv2.blur(picture, (side, side))[side // 2 :: side, side // 2 :: side]
    y, x = np.nonzero(is_lit(mean**2, UNLIT))
    hull: Any = cv2.convexHull(np.column_stack([x, y]).astype(np.int32))
    share = cv2.contourArea(hull) / np.prod(np.maximum(np.array(mean.shape) - 1, 1))
    # Captures have 0.77 and more; one that was a quarter of a pitch beside its lattice 0.17.
    if share >= 0.5:
        return None
    where = (
        f"light lies on {share:.0%} of the flat, and the lattice of all the rest follows from there"
    )
    return f"{where}; calibrate on a white image or on a scene that fills the flat"
