"""Calibrate a focused plenoptic camera from its flats, white or scene, with nothing else given."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .camera.calibration import Calibration
from .images.mosaic import Mosaic, check_mosaic, equalise_mosaic, has_mosaic, remove_mosaic
from .runtime.errors import CalibrationError

if TYPE_CHECKING:
    from .detection.first_lattice import FirstLattice
    from .lattice.lattice import Lattice
    from .lattice.lens_subset import ReadCrop, StackedCrops
    from .lattice_fit import FinalLattice

__all__ = ["calibrate"]

# Halves that put the lattice further apart than this share of the pitch have not found one.
_SCATTERED = 0.1
# Below this confidence a person should look.
_SURE = 0.7
# Confidence where nothing on the flat proves that microimages are what repeats on it.
_UNPROVEN = 0.4
# Lattices that are measured after the first before a flat is refused.
_TRIES = 2
_RAW = "give a raw flat from the sensor, of a camera with a microlens array"
# Relative spread of the tones of an image that shows nothing.
_EVEN = 1e-4
# Where tones of a scene spread by more than this, or its average microimage is less round, a few bright places may
# outdo all others: scenes in files with gamma spread by up to 0.46, linear ones by up to 0.9.
_GLARING, _ROUND = 0.5, 0.55


def calibrate(
    image: ArrayLike | Sequence[ArrayLike],
    kind: Literal["auto", "white", "scene"] = "auto",
    mosaic: Mosaic | None = None,
) -> Calibration:
    """Find the microlens lattice on one or more flats of a camera.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array_like, any integer or float type, or a sequence of such
        Raw sensor picture: a white image or any scene. Several are combined: white images add up, each weighted by
        its exposure and without its clipped pixels; of scenes the breaks between microimages are averaged. Flats
        that show nothing, such as dark or saturated ones, are left out.
    kind : {"auto", "white", "scene"}
        What the flats show; `"auto"` decides by whether microimages are evenly lit inside. Where some of several are
        white images, only these are used.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"} or None
        Colour filters over the top left 2 x 2 pixels of a flat (h, w). With None a mosaic is detected and taken out,
        but which colour is where cannot be told from it and is not kept.

    Returns
    -------
    Calibration
        Flats of more than 48 megapixels are averaged in square blocks of pixels first, or, where their pitch is too
        short for that and they are white images, calibrated on parts of them and a look at each lens: their defects
        name no single pixels.
        Its `confidence` is the weakest of several independent tests; below 0.7 there is also a warning.

    Raises
    ------
    FlatError
        If an image cannot be a flat: wrong shape, NaN, too small, or of another size than the first.
    CalibrationError
        If no trustworthy lattice is on it.
    """
    if kind not in ("auto", "white", "scene"):
        raise ValueError(f"kind must be 'auto', 'white' or 'scene', got {kind!r}")
    # Compiled code is loaded only when a flat is there to be calibrated.
    from threadpoolctl import threadpool_limits

    from .detection.capture_kind import check_flats, estimate_white_level

    flats = check_flats(image)
    for flat in flats:
        check_mosaic(mosaic, flat)
    # The equations are too small for more threads, which would only wait busily for each other.
    with threadpool_limits(1, "blas"):
        return replace(_calibrated(flats, kind, mosaic), white_level=estimate_white_level(flats))


def _calibrated(
    flats: list[NDArray[Any]], kind: Literal["auto", "white", "scene"], mosaic: Mosaic | None
) -> Calibration:
    from .detection.downscale import (
        average_blocks,
        choose_block_size,
        is_large_after_averaging,
        is_searched_in_pieces,
        upscale_calibration,
    )
    from .images.preprocessing import luminance

    filtered = mosaic is not None or all(flat.ndim == 2 and has_mosaic(flat) for flat in flats)
    size = flats[0].shape[1], flats[0].shape[0]
    found: _Found | None = None
    block = choose_block_size(flats[0])
    alone = len(flats) == 1 and kind != "scene"
    if alone and is_large_after_averaging(size, block):
        found = _found_in_parts(flats[0], kind, filtered)
    if found is None and block > 1:
        camera = _calibrated([average_blocks(flat, block) for flat in flats], kind, None)
        return replace(upscale_calibration(camera, block, size), mosaic=mosaic)
    if found is None and alone and not filtered and is_searched_in_pieces(size):
        found = _found_on_large(flats[0], kind)

    def lights() -> list[NDArray[np.float32]]:
        return [equalise_mosaic(flat) if filtered else luminance(flat) for flat in flats]

    others: Iterator[_Found] = iter(())
    if found is None:
        others = _found_on_all(lights(), kind, filtered)
        found = next(others)
    if found.white and kind == "auto" and len(flats) == 1 and _is_scene(found):
        others = _found_on_all(lights(), "scene", filtered)
        found = next(others)
    if not found.white and _may_be_misled(found):
        found, others = _without_glare(found, others, lights(), filtered)
    camera, found = _first_measured(found, others)
    warnings = (*camera.warnings, *_warnings(camera, found.fit.half_difference, filtered and mosaic is None))
    return replace(camera, mosaic=mosaic, warnings=warnings)


def _first_measured(found: _Found, others: Iterator[_Found]) -> tuple[Calibration, _Found]:
    """The camera of what has been found, or of the first of the others that is one; CalibrationError if none is.

    What has been found may be places of the scene that all lenses show, or several types of lenses taken as one.
    """
    error: CalibrationError | None = None
    for one in chain([found], islice(others, _TRIES)):
        try:
            return _measured(one), one
        except CalibrationError as failure:
            error = error or one.start.doubt or failure
            if one.white:
                break
    assert error is not None
    raise error


@dataclass(frozen=True)
class _Found:
    """The lattice of a camera, and what it was found on: the picture of a flat, or parts of it and a look at all.

    `single` is one of several scenes, where the picture is their mean. `softened` is the picture with less
    contrast, where that is what the lattice was found on.
    """

    picture: NDArray[np.float32] | StackedCrops
    white: bool
    start: FirstLattice
    fit: FinalLattice
    look: ReadCrop | None = None
    single: NDArray[np.float32] | None = None
    softened: NDArray[np.float32] | None = None


def _found_in_parts(flat: NDArray[Any], kind: str, filtered: bool) -> _Found | None:
    """The lattice of a white image from parts of it; None where it is none."""
    from .lattice_fit import fit_lattice_to_white_image
    from .white_fit.large import find_white_lattice, sample_parts, window_reader

    look = window_reader(flat, filtered)
    start = find_white_lattice(look, (flat.shape[1], flat.shape[0]), kind == "white", tries=9)
    if start is None:
        return None
    parts, look = sample_parts(look, start.lattice)
    return _Found(parts, True, start, fit_lattice_to_white_image(parts, start), look)


def _is_scene(found: _Found) -> bool:
    """Whether what was taken for a white image shows a scene: one that is nearly even within the microimages."""
    from .detection.parallax_test import shows_scene

    return isinstance(found.picture, np.ndarray) and shows_scene(found.picture, found.fit.lattice)


def _may_be_misled(found: _Found) -> bool:
    """Whether bright places of a scene may outdo the microimages."""
    return _glares(found) or found.start.roundness < _ROUND


def _glares(found: _Found) -> bool:
    # A ninth of the pixels tells as much.
    return float(np.asarray(found.picture)[::3, ::3].std()) > _GLARING


def _without_glare(
    found: _Found, others: Iterator[_Found], lights: list[NDArray[np.float32]], filtered: bool
) -> tuple[_Found, Iterator[_Found]]:
    """What is found on the root of the light of scenes, where that glares or its microimages are rounder."""
    softer = _softer(found, _found_on_all([np.sqrt(light) for light in lights], "scene", filtered))
    try:
        first = next(softer)
    except CalibrationError:
        return found, others
    wanted = _glares(found) or first.start.roundness > found.start.roundness
    return (first, softer) if wanted else (found, others)


def _softer(found: _Found, others: Iterator[_Found]) -> Iterator[_Found]:
    """The others, found on the root of the light that `found` was found on."""
    for one in others:
        assert isinstance(one.picture, np.ndarray)
        yield replace(one, picture=found.picture, softened=one.picture)


def _found_on_large(flat: NDArray[Any], kind: str) -> _Found | None:
    """The lattice of a large white image, followed outwards from its middle; None where it is none."""
    from .images.preprocessing import sqrt_luminance
    from .lattice_fit import fit_lattice_to_white_image
    from .white_fit.large import find_white_lattice_in_array

    picture = sqrt_luminance(flat)
    start = find_white_lattice_in_array(picture, kind == "white")
    return None if start is None else _Found(picture, True, start, fit_lattice_to_white_image(picture, start))


def _found_on_all(lights: list[NDArray[np.float32]], kind: str, filtered: bool) -> Iterator[_Found]:
    """The lattice from whole flats, the likeliest first; CalibrationError where there is none."""
    from .detection.capture_kind import choose_white_or_scene
    from .images.preprocessing import sqrt_luminance
    from .lattice_fit import fit_lattice_to_scenes, fit_lattice_to_white_image

    single = sqrt_luminance(lights[0]) if len(lights) == 1 else None
    if len(lights) > 1:
        lights = _telling(lights)
    error: CalibrationError | None = None
    none = True
    for start in _starts(lights, filtered, single):
        try:
            white, some = choose_white_or_scene(lights, start, kind)
            if white:
                picture = sqrt_luminance(_white_sum(some)) if single is None else single
                found = _Found(picture, True, start, fit_lattice_to_white_image(picture, start))
            else:
                some = [remove_mosaic(light) for light in some] if filtered else some
                picture = sqrt_luminance(_mean_scene(some)) if single is None or filtered else single
                one = None if len(some) == 1 else sqrt_luminance(some[0])
                found = _Found(picture, False, start, fit_lattice_to_scenes(some, picture, start), single=one)
        except CalibrationError as failure:
            error = error or start.doubt or failure
            continue
        except np.linalg.LinAlgError as failure:
            # Equations without a solution: nothing on the flat holds the lattice in one of the directions.
            text = f"what repeats on the image has no edges to place microimages by; {_RAW}"
            raise (error or CalibrationError(text)) from failure
        none = False
        yield found
    if none and error is not None:
        raise error


def _measured(found: _Found) -> Calibration:
    """The camera with what else its flat shows."""
    from .illumination.measure import measure_illumination
    from .lens_types.classify import find_lens_types

    fit, picture, white = found.fit, found.picture, found.white
    pitch = fit.lattice.pitch
    if not fit.half_difference < _SCATTERED * pitch:
        raise CalibrationError(
            f"two halves of the microimages of {pitch:.1f} px pitch disagree about the lattice; "
            "give a sharper flat or a white image"
        )
    seen = measure_illumination(picture, fit.lattice, white, fit.cat_eye, found.look)
    lattice = fit.lattice.with_radius(seen.radius)
    doubt = _doubt(found, lattice)
    # Half of the pixels beside the model leave no trust in where it puts the centres.
    confidence = min(
        found.start.repeatability,
        1 - max(fit.half_difference, fit.displacement) / (_SCATTERED * pitch),
        1 - 2 * seen.outlier_share,
        _UNPROVEN if doubt else 1,
    )
    return Calibration(
        lattice=lattice,
        vignetting=seen.vignetting,
        source="white" if white else "scene",
        residual_rms=fit.residual_rms,
        lenses_used=fit.lenses_used,
        confidence=float(np.clip(confidence, 0, 1)),
        warnings=seen.warnings if doubt is None else (*seen.warnings, doubt),
        lens_types=find_lens_types(picture, lattice, white),
        gain_map=seen.gain_map,
        defects=seen.defects,
        errors=fit.errors,
        residuals=fit.residuals,
    )


def _doubt(found: _Found, lattice: Lattice) -> str | None:
    """Why what repeats on the flat may be no microimages, None where it proves to be; CalibrationError if it cannot."""
    from .detection.cell_tests import find_shape_doubt
    from .detection.parallax_test import check_parallax

    picture, several = found.picture, found.single is not None
    compared = picture if found.softened is None else found.softened
    if isinstance(compared, np.ndarray) and check_parallax(compared, lattice, found.white, not several):
        return None
    if found.start.doubt is not None:
        raise found.start.doubt
    doubt = find_shape_doubt(picture, lattice)
    if doubt is not None and found.single is not None and check_parallax(found.single, lattice, False):
        return None
    return doubt and (
        f"nothing on the flat proves that microimages are what repeats on it: {doubt}, and no neighbours are seen to "
        "show the same, shifted; calibrate on a white image or on a scene with more detail"
    )


def _warnings(camera: Calibration, differ: float, unknown_mosaic: bool) -> list[str]:
    """What a user should know before trusting the camera."""
    warnings = []
    confidence, types = camera.confidence, camera.lens_types
    if confidence < _SURE:
        warnings.append(
            f"the lattice is uncertain (confidence {confidence:.2f}, halves of the flat differ by {differ:.2f} px); "
            "check the circles on the flat or calibrate on a white image"
        )
    if types is not None and not types.ordered:
        warnings.append(
            f"{types.count} lens types were told apart, but not which is focused at which depth; "
            "calibrate on a scene with detail at several depths"
        )
    if unknown_mosaic:
        warnings.append(
            "the flat has a colour filter mosaic, taken out here; say which one (--mosaic RGGB, BGGR, GRBG or GBRG) "
            "to have it kept in the camera file"
        )
    return warnings


def _telling(lights: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """The lights that show something."""
    from .images.stack import select_contrasted

    return [lights[k] for k in select_contrasted(lights)]


def _white_sum(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .images.stack import combine_whites

    return combine_whites(lights)


def _mean_scene(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .images.stack import average_scenes

    return average_scenes(lights) if len(lights) > 1 else lights[0]


def _starts(
    lights: list[NDArray[np.float32]], filtered: bool, single: NDArray[np.float32] | None
) -> Iterator[FirstLattice]:
    """First lattices on the mean of the lights, or on the first of them that shows one by itself.

    `single` is the sqrt_luminance of the only one.
    """
    import cv2

    from .detection.downscale import is_searched_at_half_size
    from .detection.first_lattice import NO_MICROIMAGES, find_first_lattices, find_first_lattices_at_half_size
    from .detection.settings import DEFAULT
    from .images.preprocessing import sqrt_luminance

    error: CalibrationError | None = None
    found = False
    tries = [lambda: _mean_scene(lights)] + [lambda light=light: light for light in lights] * (len(lights) > 1)
    for light in tries:
        picture = (
            sqrt_luminance(remove_mosaic(light()) if filtered else light()) if single is None or filtered else single
        )
        try:
            mean, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(picture))
            if mean == 0 or deviation < _EVEN * mean:
                raise CalibrationError(
                    "the image is one even grey; give a flat with light on it and without saturation"
                )
            large = is_searched_at_half_size((picture.shape[1], picture.shape[0]))
            for start in (find_first_lattices_at_half_size if large else find_first_lattices)(picture):
                # Two halves of a flat with microimages show the same average one.
                if start.repeatability < DEFAULT.first_lattice.repeatability:
                    raise CalibrationError(NO_MICROIMAGES)
                found = True
                yield start
        except CalibrationError as failure:
            error = error or failure
        if found:
            return
    assert error is not None
    raise error
