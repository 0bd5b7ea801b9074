"""Calibrate a focused plenoptic camera from its flats, white or scene, with nothing else given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .bayer import Mosaic, check_mosaic, equalise, has_mosaic, without_mosaic
from .calibration import Calibration
from .errors import CalibrationError

if TYPE_CHECKING:
    from .lens_types import LensTypes
    from .search import FirstLattice

__all__ = ["calibrate"]

# Two halves of a flat must show average microimages that correlate at least so much.
_REPEATS = 0.8
# Halves that put the lattice further apart than this share of the pitch have not found one.
_SCATTERED = 0.1
# Below this confidence a person should look.
_SURE = 0.7
_RAW = "give a raw flat from the sensor, of a camera with a microlens array"
# Relative spread of the tones of an image that shows nothing.
_EVEN = 1e-4


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
        Flats of more than 48 megapixels with pitches above 18 px are averaged in square blocks of pixels first: their
        defects name no single pixels.
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
    from .captures import checked_flats, white_or_scene
    from .features import luminance, tone
    from .illumination import measure_illumination
    from .lattice_fit import fit_on_scenes, fit_on_white
    from .reduction import block_size, enlarged, reduced
    from .type_search import find_lens_types

    flats = checked_flats(image)
    for flat in flats:
        check_mosaic(mosaic, flat)
    block = block_size(flats[0])
    if block > 1:
        height, width = flats[0].shape[:2]
        camera = calibrate([reduced(flat, block) for flat in flats], kind)
        return replace(enlarged(camera, block, (width, height)), mosaic=mosaic)
    filtered = mosaic is not None or all(flat.ndim == 2 and has_mosaic(flat) for flat in flats)
    lights = [equalise(flat) if filtered else luminance(flat) for flat in flats]
    if len(lights) > 1:
        lights = _telling(lights)
    try:
        start = _first(lights, filtered)
        white, lights = white_or_scene(lights, start, kind)
        if white:
            picture = tone(_white_sum(lights))
            fit = fit_on_white(picture, start)
        else:
            lights = [without_mosaic(light) for light in lights] if filtered else lights
            picture = tone(_mean_scene(lights))
            fit = fit_on_scenes(lights, picture, start)
    except np.linalg.LinAlgError as error:
        # Equations without a solution: nothing on the flat holds the lattice in one of the directions.
        raise CalibrationError(f"what repeats on the image has no edges to place microimages by; {_RAW}") from error
    pitch = fit.lattice.pitch
    if not fit.halves_differ < _SCATTERED * pitch:
        raise CalibrationError(
            f"two halves of the microimages of {pitch:.1f} px pitch disagree about the lattice; "
            "give a sharper flat or a white image"
        )
    seen = measure_illumination(picture, fit.lattice, white, fit.cat_eye)
    lattice = replace(fit.lattice, radius=seen.radius)
    types = find_lens_types(picture, lattice, white)
    confidence = float(np.clip(min(start.repeatability, 1 - fit.halves_differ / (_SCATTERED * pitch)), 0, 1))
    return Calibration(
        lattice=lattice,
        vignetting=seen.vignetting,
        source="white" if white else "scene",
        residual_rms=fit.residual_rms,
        lenses_used=fit.lenses_used,
        confidence=confidence,
        warnings=(*seen.warnings, *_warnings(confidence, fit.halves_differ, types, filtered and mosaic is None)),
        lens_types=types,
        mosaic=mosaic,
        gain_map=seen.gain_map,
        defects=seen.defects,
        errors=fit.errors,
    )


def _warnings(confidence: float, differ: float, types: LensTypes | None, unknown_mosaic: bool) -> list[str]:
    """What a user should know before trusting the camera."""
    warnings = []
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
    from .combine import telling

    return [lights[k] for k in telling(lights)]


def _white_sum(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .combine import white_sum

    return white_sum(lights)


def _mean_scene(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .combine import mean_scene

    return mean_scene(lights) if len(lights) > 1 else lights[0]


def _first(lights: list[NDArray[np.float32]], filtered: bool) -> FirstLattice:
    """First lattice on the mean of the lights, or on the first of them that shows one by itself."""
    from .features import tone
    from .search import NO_MICROIMAGES, first_lattice

    error: CalibrationError | None = None
    tries = [lambda: _mean_scene(lights)] + [lambda light=light: light for light in lights] * (len(lights) > 1)
    for light in tries:
        picture = tone(without_mosaic(light()) if filtered else light())
        try:
            if float(picture.max()) == 0 or float(picture.std()) < _EVEN * float(picture.mean()):
                raise CalibrationError(
                    "the image is one even grey; give a flat with light on it and without saturation"
                )
            start = first_lattice(picture)
            # Two halves of a flat with microimages show the same average one.
            if start.repeatability < _REPEATS:
                raise CalibrationError(NO_MICROIMAGES)
            return start
        except CalibrationError as failure:
            error = error or failure
    assert error is not None
    raise error
