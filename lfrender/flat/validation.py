"""Check that a flat fits its calibration, and bring it into the form that kernels read."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import (
    Calibration,
    CalibrationError,
    CameraError,
    FlatError,
    check_camera,
    check_pixels,
)
from lfcal.runtime.errors import CAMERA_ADVICE, check_type

__all__ = ["check_flat", "exposure_rows", "match_exposure", "verify_camera"]

# Largest float of a flat, where white is 1: noise and gain reach above white, but not beyond this.
# Set by hand.
_BRIGHTEST = 16.0


def check_flat(flat: NDArray, calibration: Calibration) -> NDArray:
    """The flat as (H, W, C) uint8, uint16 or float32, in colour if the camera has a mosaic;
    FlatError or CalibrationError.
    """
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    if isinstance(flat, (str, os.PathLike)):
        raise FlatError(f"flat is a path; give its pixels, lfcal.read_flat({os.fspath(flat)!r})")
    try:
        array = check_pixels(flat)
    except FlatError as error:
        raise FlatError(f"flat: {error}") from error
    size = (array.shape[1], array.shape[0])
    if size != calibration.image_size:
        was, now = ("{} x {}".format(*pair) for pair in (calibration.image_size, size))
        raise CalibrationError(
            f"calibration is for images of {was} px, the flat has {now}; calibrate on this flat"
        )
    if array.dtype.kind == "f" and float(array.max()) > _BRIGHTEST:
        raise FlatError(
            f"flat holds floats up to {array.max():.4g}, but floats are 1 at white; divide it by "
            "the largest value of its sensor, such as 255 or 4095"
        )
    if array.ndim == 3:
        return array
    if calibration.mosaic is not None:
        from .demosaicing import demosaic

        return demosaic(array, calibration)
    return array[:, :, None]


def verify_camera(flat: NDArray, calibration: Calibration) -> None:
    """CameraError if a flat of `check_flat` shows another lattice than that of its camera, or shows
    it beside; a warning if the pitch, the angle or the corners are slightly off.
    """
    colours = 1 if flat.shape[2] < 3 else 3
    check = check_camera(flat[..., :colours].squeeze(), calibration, lens_types=False)
    if check.usable and check.adjusted is None:
        if check.problem is not None:
            warnings.warn(check.problem, stacklevel=3)
        return
    remedy = "check=False uses the camera all the same"
    if check.adjusted is not None:
        remedy = f"lfcal.check_camera(...).adjusted is moved onto the microimages; {remedy}"
    raise CameraError(f"{check.problem} ({remedy})")


def exposure_rows(height: int) -> NDArray[np.int64]:
    """Sixteen rows (n,) of a flat from which its exposure is measured."""
    return np.unique((np.arange(16) + 0.5) / 16 * height).astype(np.int64)


def match_exposure(rows: NDArray, calibration: Calibration) -> Calibration:
    """The camera with a white level that a dim flat comes near to, by its `exposure_rows`; as it is
    for others.

    Noise, texture and tolerances are then measured against the light of the flat. The level is
    lowered in steps, four for each factor of two, so that the frames of a sequence have the same.
    Flats of 8 bits are never dim.
    """
    if rows.dtype == np.uint8 or rows.size == 0:
        return calibration
    highest = 1.0 if rows.dtype.kind == "f" else float(np.iinfo(rows.dtype).max)
    white = min(highest, calibration.white_level or highest)
    gray = rows if rows.ndim == 2 else rows.mean(-1)
    top = max(1.1 * float(np.quantile(gray, 0.99)), 1e-6 * white)
    power = np.floor(4 * np.log2(max(white / top, 1.0))) / 4
    if power < 1:
        return calibration
    return calibration.derived(_with_white_level, float(white / 2**power))


def _with_white_level(calibration: Calibration, level: float) -> Calibration:
    return replace(calibration, white_level=level)
