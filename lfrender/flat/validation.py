"""Check that a flat fits its calibration, and bring it into the form that kernels read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError, FlatError

__all__ = ["check_flat"]

# Largest float of a flat, where white is 1: noise and gain reach above white, but not beyond this. Set by hand.
_BRIGHTEST = 16.0


def check_flat(flat: NDArray, calibration: Calibration) -> NDArray:
    """The flat as an (H, W, C) array of uint8, uint16 or float32; in colour if the camera has a colour filter mosaic.

    Raises
    ------
    FlatError
        If it is not a gray or colour picture of finite numbers, or of floats that are far beyond 1 at white.
    CalibrationError
        If the calibration was made for another image size.
    """
    array = np.asarray(flat)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or not 1 <= array.shape[2] <= 4:
        raise FlatError(f"flat must be (H, W) or (H, W, 1 to 4), got shape {np.shape(flat)}")
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        if array.dtype.kind != "f":
            raise FlatError(f"flat must be uint8, uint16 or float, got {array.dtype}")
        array = array.astype(np.float32)
    size = (array.shape[1], array.shape[0])
    if size != calibration.image_size:
        was, now = ("{} x {}".format(*pair) for pair in (calibration.image_size, size))
        raise CalibrationError(f"calibration is for images of {was} px, the flat has {now}; calibrate on this flat")
    _check_floats(array)
    if calibration.mosaic is not None and array.shape[2] == 1:
        from .demosaicing import demosaic

        return demosaic(array[:, :, 0], calibration)
    return np.ascontiguousarray(array)


def _check_floats(array: NDArray) -> None:
    if array.dtype.kind != "f":
        return
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))[0]
        raise FlatError(f"flat has a NaN or infinite pixel at x={bad[1]}, y={bad[0]}; replace such pixels first")
    if array.size and float(array.max()) > _BRIGHTEST:
        raise FlatError(
            f"flat holds floats up to {array.max():.4g}, but floats are 1 at white; divide it by the largest value of "
            "its sensor, such as 255 or 4095"
        )
