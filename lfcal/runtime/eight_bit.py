"""Conversion of pictures of any type to 8 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["to_eight_bits"]


def to_eight_bits(pixels: NDArray, white: float | None = None) -> NDArray[np.uint8]:
    """Pixels of any shape as uint8, in which 255 is white.

    Parameters
    ----------
    pixels : array
        uint8, which stay as they are, other integers, or floats with 1 for white and NaN for black.
    white : float, optional
        Integer that is white, as `Calibration.white_level`; by default the largest of the type.
    """
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype.kind == "f":
        white = 1.0
    elif white is None:
        white = float(np.iinfo(pixels.dtype).max)
    scaled: NDArray[np.uint8] = np.rint(np.clip(np.nan_to_num(pixels) / white, 0, 1) * 255).astype(np.uint8)
    return scaled
