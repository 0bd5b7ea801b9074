"""Surroundings of chosen microimages, cut out of a flat: all that a fit has to hold of it."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["cut_windows"]


@njit(cache=True, nogil=True, parallel=True)
def _cut(tones, corners, out):
    side = out.shape[1]
    height, width = tones.shape
    for lens in prange(len(corners)):
        left, top = corners[lens, 0], corners[lens, 1]
        if left >= 0 and top >= 0 and left + side <= width and top + side <= height:
            # Indices without a sign need no look at it, so that several pixels are moved at once.
            first = np.uintp(left)
            for y in range(side):
                row, line = tones[top + y], out[lens, y]
                for x in range(np.uintp(side)):
                    value = row[first + x]
                    line[x] = value * value
            continue
        for y in range(side):
            row = min(max(top + y, 0), height - 1)
            for x in range(side):
                value = tones[row, min(max(left + x, 0), width - 1)]
                out[lens, y, x] = value * value


def cut_windows(
    tones: NDArray[np.float32], centres: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Squares of light around microimages.

    Parameters
    ----------
    tones : (h, w) float32
        Square root of the light (`features.tone`).
    centres : (n, 2) float64 [px]
    reach : float [px]
        Least distance from the centre to the sides of its square.

    Returns
    -------
    light : (n, k, k) float32
        Pixels beyond the flat repeat its border.
    corners : (n, 2) int64 [px]
        Flat coordinates x, y of the first pixel of each square.
    """
    half = int(np.ceil(reach)) + 1
    corners = np.rint(centres).astype(np.int64) - half
    light = np.empty((len(centres), 2 * half + 1, 2 * half + 1), np.float32)
    _cut(tones, corners, light)
    return light, corners
