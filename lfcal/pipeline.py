"""Calibrate a focused plenoptic camera from its flats, white or scene, with nothing else given."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera.calibration import Calibration
from .images.mosaic import check_mosaic, equalise_mosaic, find_mosaic
from .lattice.stated import LatticeHint
from .runtime.errors import CalibrationError
from .runtime.image_formats import Mosaic

if TYPE_CHECKING:
    from .lattice.lattice import Lattice
    from .lattice_search import LatticeCandidate

__all__ = ["SURE_CONFIDENCE", "calibrate"]

#: A calibration of less confidence is doubtful: a dim microscope capture at 0.78 was a quarter of a pitch beside its
#: white image; most right captures have 0.84 and more.
SURE_CONFIDENCE = 0.8
# Confidence where nothing proves that microimages are what repeats on the flat.
_UNPROVEN = 0.4
# [pitch] RMS distance of the lattices of two halves of the microimages, from which on there is none.
_HALVES = 0.1
# Share of clipped pixels from which on a white image is over-exposed.
_CLIPPED = 0.02


def calibrate(
    image: ArrayLike | str | os.PathLike[str] | Sequence[ArrayLike | str | os.PathLike[str]],
    kind: Literal["auto", "white", "scene"] = "auto",
    mosaic: Mosaic | None = None,
    pitch: float | None = None,
    rotation: float | None = None,
) -> Calibration:
    """Find the microlens lattice on one or more flats of a camera.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array_like of any integer or float type, path-like, or a sequence of such
        Raw sensor picture: a white image or any scene; a path is read with `read_flat`. Several are combined: white
        images are added, weighted by their exposure and without clipped pixels; of scenes the edges between microimages
        are averaged. Flats without contrast, such as dark or saturated ones, are left out.
    kind : {"auto", "white", "scene"}
        What the flats show; `"auto"` decides by whether microimages are evenly lit inside. Where some of several are
        white images, only these are used.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"} or None
        Colour filters over the top left 2 x 2 pixels of a flat (h, w). With None they are found, if there are any;
        which of them are red and which blue is a guess then, with a warning.
    pitch : float or None [px]
        Hint where a lattice is hard to find: mean distance between neighbouring centres, right to a tenth. What
        repeats at that distance is taken for microimages without further proof.
    rotation : float or None [degrees]
        With `pitch`: rotation as `lfcal info` prints it, right to 2 degrees.

    Returns
    -------
    Calibration
        Flats of more than 48 megapixels are averaged in square blocks of pixels first, or, where their pitch is too
        short for that and they are white images, calibrated on parts of them and on the light of each lens: they
        list no defects of single pixels.
        `confidence` is the weakest of several independent tests; below 0.8 there is also a warning.

    Raises
    ------
    FlatError
        If an image cannot be a flat: wrong shape, NaN, too small, or of another size than the first.
    CalibrationError
        If no trustworthy lattice is on it.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:240, :300]
    >>> distance = np.hypot((x - 9) % 20 - 10, (y - 6) % 20 - 10)
    >>> white = 200 * np.clip(9.5 - distance, 0, 1) + np.random.default_rng(0).normal(20, 2, x.shape)
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
    from threadpoolctl import threadpool_limits

    from .images.stack import check_flats, estimate_white_level, measure_overexposure

    flats = check_flats(image)
    clipped = max(measure_overexposure(flat) for flat in flats)
    for flat in flats:
        check_mosaic(mosaic, flat)
    try:
        # The equations are too small for more threads to pay off.
        with threadpool_limits(1, "blas"):
            filtered = mosaic is not None or any(find_mosaic(flat) for flat in flats)
            camera = _calibrate(flats, kind, filtered and all(flat.ndim == 2 for flat in flats), hint)
    except CalibrationError as error:
        if clipped <= _CLIPPED:
            raise
        raise CalibrationError(f"{error} ({clipped:.0%} of the pixels are over-exposed: expose less)") from error
    if camera.source == "white" and clipped > _CLIPPED:
        warning = (
            f"the white image is over-exposed ({clipped:.0%} of its pixels are clipped): expose less, by a half or more"
        )
        camera = replace(camera, warnings=(*camera.warnings, warning))
    camera = replace(camera, white_level=estimate_white_level(flats), mosaic=mosaic)
    for flat in flats:
        camera = camera.with_mosaic_of(flat)
    if camera.source == "white" and camera.confidence >= SURE_CONFIDENCE:
        from .lens_blur.rims import measure_rims

        camera = replace(camera, lens_blur=measure_rims(flats[0], camera))
    return camera


def _calibrate(flats: list[NDArray[Any]], kind: str, filtered: bool, hint: LatticeHint | None) -> Calibration:
    from .detection.downscale import average_blocks, choose_block_size, upscale_calibration

    size = flats[0].shape[1], flats[0].shape[0]
    block = choose_block_size(flats[0])
    one = len(flats) == 1 and kind != "scene"
    found = _find_large(flats[0], kind, filtered, block) if one and hint is None else None
    if found is None and block > 1:
        small = hint and hint.scaled(block)
        camera = _calibrate([average_blocks(flat, block) for flat in flats], kind, False, small)
        return upscale_calibration(camera, block, size)
    measured = _measure_first(_find_candidates(found, flats, kind, filtered, hint))
    camera = measured.camera
    if kind == "auto" and measured.found.white and one and (measured.unexplained or _may_be_scene(camera)):
        with suppress(CalibrationError):
            scene = _measure_first(_find_candidates(None, flats, "scene", filtered, hint))
            more = scene.camera.confidence - camera.confidence
            if more > 0 or (measured.unexplained and more == 0):
                measured, camera = scene, scene.camera
        if camera.source == "white" and camera.confidence == 0:
            raise CalibrationError(
                "the lenses are lit too differently for a white image, and no lattice is proved if the flat is a scene;"
                " give a white image, or state what it shows (--kind white or scene)"
            )
    # 61 scenes have 0.19 and more, 26 crops of captures 0.25; pictures that are no flats -0.05 to -0.11.
    if camera.source == "scene" and measured.parallax and camera.circle_agreement < 0.1:
        # Neighbours that match by chance prove nothing.
        camera = replace(camera, confidence=min(camera.confidence, _UNPROVEN))
    elif camera.source == "scene" and not (measured.parallax and np.isfinite(camera.circle_agreement)):
        # Shaped as lenses, without parallax: 5 of 15 captures, and 4 of 218 pictures that are no flats.
        camera = replace(camera, confidence=min(camera.confidence, 0.85))
    types, warnings = camera.lens_types, list(camera.warnings)
    if camera.confidence < SURE_CONFIDENCE:
        warnings.append(
            f"the lattice is uncertain (confidence {camera.confidence:.2f}, halves of the flat differ by "
            f"{measured.found.fit.half_difference:.2f} px); check the circles on the flat or calibrate on a white image"
        )
    if types and not types.ordered:
        warnings.append(
            f"{types.count} lens types were found, but not which is focused at which depth; calibrate on a scene with "
            "detail at several depths"
        )
    return replace(camera, warnings=tuple(warnings))


def _may_be_scene(camera: Calibration) -> bool:
    """Whether what was calibrated as a white image is lit more unlike from lens to lens than by dust."""
    from .lattice_fit import FEWEST_PIXELS

    gain = np.zeros(0) if camera.gain_map is None else camera.gain_map.lens_gain
    lit = gain[gain > 0]
    # The light of a spot of few pixels depends on where it lies on them.
    if np.pi * camera.lattice.radius**2 < FEWEST_PIXELS:
        return False
    # Dust darkens fewer lenses.
    if len(lit) and _enclosed_share(gain <= 0, camera.lattice.indices()) > 0.03:
        return True
    unlike = len(lit) > 0 and float((np.abs(lit / np.median(lit) - 1) > 0.1).mean())
    # Where the lattice is uncertain, it may be because the flat is a scene. 25 dust specks on 1000 large lenses made
    # 0.09 of them unlike, a scene 0.16.
    return camera.confidence < 0.7 or unlike > 0.12


def _enclosed_share(dark: NDArray[np.bool_], index: NDArray[np.int64]) -> float:
    """Share of the lenses (n,) at indices (n, 2) that are dark between lit ones, in both lattice directions, and beside
    other dark ones: single lenses are missing on white images too."""
    i, j = (index - index.min(0) + 1).T
    lit, gone = np.zeros((2, i.max() + 2, j.max() + 2), np.bool_)
    lit[i, j], gone[i, j] = ~dark, dark
    beside = gone[i - 1, j] | gone[i + 1, j] | gone[i, j - 1] | gone[i, j + 1]
    enclosed = gone
    for axis in (0, 1):
        for turned in ((), (axis,)):
            enclosed = enclosed & np.flip(np.logical_or.accumulate(np.flip(lit, turned), axis), turned)
    return float((enclosed[i, j] & beside).mean())


def _find_large(flat: NDArray[Any], kind: str, filtered: bool, block: int) -> LatticeCandidate | None:
    from .detection import downscale
    from .lattice_search import find_lattice_in_crops, find_lattice_in_piece

    pixels = flat.shape[0] * flat.shape[1]
    found = find_lattice_in_crops(flat, kind, filtered) if pixels >= downscale.LARGE * block**2 else None
    if found is None and block == 1 and not filtered and pixels >= downscale.PIECES:
        found = find_lattice_in_piece(flat, kind)
    return found


def _find_candidates(
    found: LatticeCandidate | None, flats: list[NDArray[Any]], kind: str, filtered: bool, hint: LatticeHint | None
) -> Iterator[LatticeCandidate]:
    """Candidates of the lattice, the likeliest first; `found` is the first of a large white image, if there is one."""
    from .images.preprocessing import luminance
    from .lattice_search import find_lattices, find_lattices_without_glare

    def lights() -> list[NDArray[np.float32]]:
        return [equalise_mosaic(flat) if filtered else luminance(flat) for flat in flats]

    def search(kind: str) -> tuple[LatticeCandidate, Iterator[LatticeCandidate]]:
        candidates = find_lattices(lights(), kind, filtered, hint)
        return next(candidates), candidates

    others: Iterator[LatticeCandidate] = iter(())
    if found is None:
        try:
            found, others = search(kind)
        except CalibrationError:
            if kind != "auto" or len(flats) > 1:
                raise
            # Evenly lit, but no white image that can be fitted: it may be a scene.
            found, others = search("scene")
    if found.white and kind == "auto" and len(flats) == 1 and _shows_scene(found):
        found, others = search("scene")
    if not found.white and hint is None:
        found, others = find_lattices_without_glare(found, others, lights, filtered)
    yield found
    yield from others


def _shows_scene(found: LatticeCandidate) -> bool:
    from .detection.parallax_test import shows_scene

    return isinstance(found.picture, np.ndarray) and shows_scene(found.picture, found.fit.lattice)


class _Measured(NamedTuple):
    camera: Calibration
    found: LatticeCandidate
    unexplained: bool  # it is more likely that of a scene, if it was taken for a white image
    parallax: bool  # neighbours are seen to show the same, shifted


def _measure_first(candidates: Iterator[LatticeCandidate]) -> _Measured:
    """The first candidate that makes a calibration; CalibrationError if none does.

    Wrong ones are the period of scene detail that all lenses show, or several types of lenses taken as one.
    """
    error: CalibrationError | None = None
    for one in islice(candidates, 3):
        try:
            return _measure(one)
        except CalibrationError as failure:
            error = error or one.start.doubt or failure
            if one.white:
                break
    assert error is not None
    raise error


def _measure(found: LatticeCandidate) -> _Measured:
    """The calibration with illumination, defects and lens types.

    It is more likely that of a scene where more pixels differ from the gain map than defects explain, and the average
    microimage is doubtful.
    """
    from .illumination.measure import MOST_OFF_GAIN, measure_illumination
    from .lens_types.classify import find_lens_types

    fit, picture, white = found.fit, found.picture, found.white
    pitch = fit.lattice.pitch
    if not fit.half_difference < _HALVES * pitch:
        raise CalibrationError(
            f"two halves of the microimages of {pitch:.1f} px pitch disagree about the lattice; "
            "give a sharper flat or a white image"
        )
    light = measure_illumination(
        picture, fit.lattice, white, fit.cat_eye, found.read_crop,
        lambda lattice: find_lens_types(picture, lattice, white),
    )  # fmt: skip
    lattice = fit.lattice.with_radius(light.radius)
    parallax = False
    try:
        parallax, doubt = _find_doubt(found, lattice)
    except CalibrationError as failure:
        # What is stated needs no proof.
        if not found.stated:
            raise
        doubt = str(failure)
    unexplained = doubt is not None and light.outlier_share > MOST_OFF_GAIN
    doubt = None if found.stated else doubt
    agreement, beside = _compare_circles(found, lattice)
    dark = None if white or not isinstance(picture, np.ndarray) else _find_dark_rest(picture, pitch)
    # With a third of the pixels unlike the model there is no trust in its centres.
    confidence = min(
        found.start.repeatability,
        1 - max(fit.half_difference, fit.displacement) / (_HALVES * pitch),
        1 - 3 * light.outlier_share,
        _UNPROVEN if doubt or dark else 1,
    )
    warnings = (*light.warnings, *(text for text in (doubt, fit.doubt, beside, dark) if text is not None))
    camera = Calibration(
        lattice, light.vignetting, source="white" if white else "scene", residual_rms=fit.residual_rms,
        lenses_used=fit.lenses_used, confidence=float(np.clip(confidence, 0, 1)), warnings=warnings,
        lens_types=light.lens_types, gain_map=light.gain_map, defects=light.defects, errors=fit.errors,
        residuals=fit.residuals, circle_agreement=agreement,
    )  # fmt: skip
    return _Measured(camera, found, unexplained, parallax)


def _find_dark_rest(picture: NDArray[np.float32], pitch: float) -> str | None:
    """A warning where the convex hull of what is lit of a scene (h, w) leaves much of the flat out."""
    import cv2

    side = int(np.ceil(pitch))
    mean = cv2.blur(picture, (side, side))[side // 2 :: side, side // 2 :: side]
    # A fifth of the root of light: a twenty-fifth of the light.
    y, x = np.nonzero(mean > 0.2 * np.quantile(mean, 0.95))
    hull: Any = cv2.convexHull(np.column_stack([x, y]).astype(np.int32))
    share = cv2.contourArea(hull) / np.prod(np.maximum(np.array(mean.shape) - 1, 1))
    # Captures have 0.77 and more; one that was a quarter of a pitch beside its lattice 0.17.
    if share >= 0.5:
        return None
    where = f"light lies on {share:.0%} of the flat, and the lattice of all the rest follows from there"
    return f"{where}; calibrate on a white image or on a scene that fills the flat"


def _compare_circles(found: LatticeCandidate, lattice: Lattice) -> tuple[float, str | None]:
    """Agreement of circles found by Hough vote with the lattice, and a warning where they lie between its centres."""
    from .hough.circle_vote import find_circles, find_shifted

    picture = found.picture if isinstance(found.picture, np.ndarray) else found.picture.crop(0)
    circles = find_circles(picture, lattice.pitch)
    if not isinstance(found.picture, np.ndarray):
        circles = replace(circles, centres=circles.centres + found.picture.corners[0])
    own, shifted = circles.agreement(lattice), find_shifted(circles, lattice)
    there = f"agreement {shifted:.2f} there, {own:.2f} on it"
    doubt = f"circles on the flat lie between the centres of the lattice ({there}): gaps may have been taken for "
    doubt += "microimages; check the circles on the flat ('lfcal show')"
    return own, doubt if shifted > own + 0.3 else None


def _find_doubt(found: LatticeCandidate, lattice: Lattice) -> tuple[bool, str | None]:
    """Whether parallax proves microimages; else why what repeats may be none, None where its shape is that of lenses.

    CalibrationError if they cannot be microimages.
    """
    from .detection.cell_tests import find_shape_doubt
    from .detection.parallax_test import check_parallax

    picture = found.picture if found.softened is None else found.softened
    if isinstance(picture, np.ndarray) and check_parallax(picture, lattice, found.white, found.single is None):
        return True, None
    if found.start.doubt is not None:
        raise found.start.doubt
    doubt = find_shape_doubt(found.picture, lattice, found.white and found.start.clear_gaps)
    if doubt is not None and found.single is not None and check_parallax(found.single, lattice, False):
        return True, None
    return False, doubt and (
        f"nothing on the flat proves that microimages are what repeats on it: {doubt}, and no neighbours are seen to "
        "show the same, shifted; calibrate on a white image or on a scene with more detail"
    )
