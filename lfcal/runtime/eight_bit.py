"""Pictures of any type as screens show them: with 8 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["to_eight_bits"]


def to_eight_bits(pixels: NDArray, white: float | None = None) -> NDArray[np.uint8]:
    """Pixels of any shape as uint8, in which 255 is white.

    Parameters
    ----------
    pixels : array
        uint8, which stay as they are, other whole numbers, or floats, in which 1 is white and NaN black.
    white : float, optional
        What is white in whole numbers, as `Calibration.white_level`; by default the largest that their type holds.
    """
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype.kind == "f":
        white = 1.0
    elif white is None:
        white = float(np.iinfo(pixels.dtype).max)
    scaled: NDArray[np.uint8] = np.rint(np.clip(np.nan_to_num(pixels) / white, 0, 1) * 255).astype(np.uint8)
    return scaled
