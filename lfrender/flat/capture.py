"""A flat and its camera, from what somebody has of them."""

from __future__ import annotations

import os

from numpy.typing import NDArray

from lfcal import Calibration, calibrate, read_flat

from .demosaicing import demosaic

__all__ = ["complete_capture"]


def complete_capture(
    flat: NDArray | str | os.PathLike[str], calibration: Calibration | None
) -> tuple[NDArray, Calibration]:
    """The pixels of a flat, in colour if its file holds a raw mosaic, and the camera, from the flat
    if none is given.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, _ = lfrender.data.example()
    >>> complete_capture(flat, camera)[1] is camera
    True
    """
    pixels = read_flat(flat) if isinstance(flat, (str, os.PathLike)) else flat
    camera = calibrate(pixels) if calibration is None else calibration
    is_raw = calibration is None or pixels is not flat
    if is_raw and camera.mosaic is not None and pixels.ndim == 2:
        pixels = demosaic(pixels, camera)
    return pixels, camera
