"""Microimages smoothed by the cubic B-spline at whole pixels."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .radiance import GrayFlat
from .scratch import recycled

__all__ = ["smoothed"]

# Slopes are taken between the pixels on both sides, and the smoothing itself reads one further [px].
_BEYOND = 2
# Where lenses cover more than this share of the flat, all its pixels are smoothed.
_MOST = 0.3


# Lenses share pixels: exact rules of rounding let it make no difference which of them comes last.
@njit(cache=True, nogil=True, parallel=True)
def _smooth(image, centres, wanted, radius, out):
    height, width = image.shape
    four, weight = np.float32(4.0), np.float32(1 / 36)
    for lens in prange(len(centres)):
        if not wanted[lens]:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        top, bottom = max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius)))
        left, right = max(0, int(np.ceil(cx - radius))), min(width - 1, int(np.floor(cx + radius)))
        n = right - left + 1
        if n <= 0:
            continue
        line = np.empty(n + 2, np.float32)
        for y in range(top, bottom + 1):
            above = image[max(y - 1, 0), left : right + 1]
            here = image[y, left : right + 1]
            below = image[min(y + 1, height - 1), left : right + 1]
            inner = line[1 : n + 1]
            for k in range(n):
                inner[k] = above[k] + four * here[k] + below[k]
            for k, x in ((0, max(left - 1, 0)), (n + 1, min(right + 1, width - 1))):
                line[k] = image[max(y - 1, 0), x] + four * image[y, x] + image[min(y + 1, height - 1), x]
            into = out[y, left : right + 1]
            # One view for each offset: an index like k + 1 may wrap round, which no vector loop can.
            line0, line1, line2 = line[:n], line[1 : n + 1], line[2 : n + 2]
            for k in range(n):
                into[k] = weight * (line0[k] + four * line1[k] + line2[k])


@njit(cache=True, nogil=True, parallel=True)
def _smooth_rows(image, out):
    """As `_smooth` for all pixels, in long rows."""
    height, width = image.shape
    four, weight = np.float32(4.0), np.float32(1 / 36)
    for y in prange(height):
        above, here, below = image[max(y - 1, 0)], image[y], image[min(y + 1, height - 1)]
        line = np.empty(width + 2, np.float32)
        inner, into = line[1 : width + 1], out[y]
        for k in range(width):
            inner[k] = above[k] + four * here[k] + below[k]
        line[0], line[width + 1] = inner[0], inner[width - 1]
        line0, line1, line2 = line[:width], line[1 : width + 1], line[2 : width + 2]
        for k in range(width):
            into[k] = weight * (line0[k] + four * line1[k] + line2[k])


def smoothed(gray: GrayFlat, wanted: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W) float32: the microimages of the lenses `wanted` (n,), weighted 1, 4, 1 over 6 in both directions.

    Only pixels that those microimages need are set, two pixels beyond their radius included.
    """
    out = recycled(gray.image.shape, np.float32)
    # Microimages with what lies about them overlap: all pixels are fewer than those of most lenses.
    if wanted.sum() * gray.pitch**2 > _MOST * gray.image.size:
        _smooth_rows(gray.image, out)
    else:
        _smooth(gray.image, gray.centres, wanted, np.float32(gray.radius + _BEYOND), out)
    return out
