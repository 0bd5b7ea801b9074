"""Assess an array from a white image, and a scene if there is one."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..display.camera_check import check_camera
from ..images.stack import check_flats
from ..lens_blur.microimages import measure_microimages
from ..pipeline import SURE_CONFIDENCE, calibrate
from ..runtime.arrays import evenly
from ..runtime.errors import FlatError
from .alignment import measure_alignment
from .findings import (
    Seen,
    find_apertures,
    find_distance,
    find_rotation,
    find_tilt,
    unmeasured,
)
from .light_findings import find_dirt, find_evenness, find_exposure, find_range, find_vignetting
from .result import Assessment, Finding

__all__ = ["assess"]

# What takes a white image and a calibration made from it: what finds each, its unit, whether it
# takes rims.
_FINDINGS: dict[str, tuple[Callable[[Seen], Finding], str, bool]] = {
    "tilt": (find_tilt, "degrees", True),
    "distance": (find_distance, "px", True),
    "apertures": (find_apertures, "px", True),
    "vignetting": (find_vignetting, "px", True),
    "exposure": (lambda seen: find_exposure(seen.flat, seen.top), "%", False),
    "evenness": (find_evenness, "%", True),
    "dirt": (find_dirt, "places", False),
}


def assess(
    white: ArrayLike | str | os.PathLike[str],
    scene: ArrayLike | str | os.PathLike[str] | None = None,
    *,
    calibration: Calibration | None = None,
    f_number: float | None = None,
    pupil: float | None = None,
    pixel: float | None = None,
    white_level: float | None = None,
) -> Assessment:
    """Tell how a microlens array is mounted on its sensor, and what to turn.

    Parameters
    ----------
    white : (h, w) or (h, w, 3) array_like, or path-like
        White image: an evenly lit surface. A scene shows nothing but the rotation.
    scene : array_like or path-like, optional
        A scene of the same camera.
    calibration : Calibration, optional
        Of the white image, so that it is not calibrated again.
    f_number : float, optional
        Of the main lens as the sensor sees it, distance of the exit pupil over its diameter: at
        infinity what is printed on it. Tells tilts in degrees.
    pupil : float, optional [mm]
        From the exit pupil of the main lens to the array; by default that of the optics of the
        calibration.
    pixel : float, optional [mm]
        Side of a pixel.
    white_level : float, optional
        Largest value that pixels can have, 4095 for a sensor of 12 bits; by default as far as the
        flats show it.

    Raises
    ------
    FlatError
        If an image cannot be a flat, or scene and calibration are of other sizes than the white
        image.
    CalibrationError
        If no lattice is on the white image.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> found = lfcal.assess(sample.white, f_number=4)
    >>> found.exposure.verdict
    'of the largest value, 255: well exposed'
    """
    for name, value in (
        ("f_number", f_number),
        ("pupil", pupil),
        ("pixel", pixel),
        ("white_level", white_level),
    ):
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} must be a positive number, got {value!r}")
    flat, *others = check_flats(white)
    if others:
        raise FlatError("several white images are given; give one")
    shown = None if scene is None else check_flats(scene)[0]
    camera = calibrate(flat) if calibration is None else calibration
    for name, one in (("the white image", flat), ("the scene", shown)):
        if one is not None and one.shape[1::-1] != camera.image_size:
            given, own = (
                "{} x {} px".format(*size) for size in (one.shape[1::-1], camera.image_size)
            )
            raise FlatError(f"{name} is {given}, the camera is for {own}; give flats of one camera")
    if calibration is not None:
        warnings = check_camera(flat, camera).warnings
        camera = replace(camera, warnings=(*camera.warnings, *warnings))
    if camera.optics is not None:
        pixel = pixel or camera.optics.pixel
        pupil = pupil or camera.optics.mla_distance
    top = find_range([flat] if shown is None else [flat, shown], white_level)
    alignment = measure_alignment(camera)
    field = None
    found = {"rotation": find_rotation(alignment, camera)}
    if camera.source == "white":
        field = measure_microimages(flat, camera)
    for name, (find, unit, takes_rims) in _FINDINGS.items():
        if camera.source != "white":
            found[name] = unmeasured(
                unit, "this takes a white image, and a calibration made from it"
            )
        elif field is None and takes_rims:
            found[name] = unmeasured(unit, "the microimages show no rims")
        else:
            distance = pupil / pixel if pupil and pixel else None
            found[name] = find(Seen(flat, camera, alignment, field, f_number, distance, pixel, top))
    told: dict[str, Any] = {name: _without_advice(one, camera) for name, one in found.items()}
    shown_range = (0, max(top or float(flat.max()), 1e-9))
    told["histogram"] = np.histogram(flat[evenly(len(flat), 1000)], 256, shown_range)[0]
    if shown is not None:
        from .scene import assess_scene

        told["scene"] = assess_scene(shown, camera, top)
    return Assessment(**told, calibration=camera, microimages=field)


def _without_advice(finding: Finding, camera: Calibration) -> Finding:
    if camera.confidence >= SURE_CONFIDENCE or not np.isfinite(finding.value):
        return finding
    doubt = (
        f"{finding.verdict}; no advice: the calibration is doubtful (confidence "
        f"{camera.confidence:.2f})"
    )
    return replace(finding, verdict=doubt, advice="")
