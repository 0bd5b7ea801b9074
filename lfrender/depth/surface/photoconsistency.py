"""Mismatch of the views of a small patch of the scene, at some depth, through the lenses around it.

The most central lenses are compared on 3 x 3 samples, each normalised by contrast; the mean over the better part of the
views is robust against occlusion.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

__all__ = ["MAX_VIEWS", "UNKNOWN", "view_mismatch"]

#: Only so many lenses, the most central ones, are compared.
MAX_VIEWS = 6
#: Mismatch of places that too few lenses show, or of noise alone.
UNKNOWN = 0.5


@njit(error_model="numpy", fastmath=FAST)
def _sample(pixels, width, px, py, out):
    """Fill `out` with 3 x 3 samples about (px, py), a pixel apart, their mean and their variance."""
    i, j = int(px), int(py)
    fx, fy = px - np.float32(i), py - np.float32(j)
    mean = squares = p = q = r = np.float32(0)
    for v in range(4):
        at, above, between, below = np.uint64((j - 1 + v) * width + i - 1), p, q, r
        a, b = pixels[at], pixels[at + np.uint64(1)]
        c, d = pixels[at + np.uint64(2)], pixels[at + np.uint64(3)]
        p, q, r = a + fx * (b - a), b + fx * (c - b), c + fx * (d - c)
        if v > 0:
            left, middle, right = above + fy * (p - above), between + fy * (q - between), below + fy * (r - below)
            out[3 * v - 3], out[3 * v - 2], out[3 * v - 1] = left, middle, right
            mean += left + middle + right
            squares += left * left + middle * middle + right * right
    mean /= 9
    out[9], out[10] = mean, max(squares / 9 - mean * mean, np.float32(0))


@njit(error_model="numpy", fastmath=FAST)
def _compare(own, other, half, floor):
    """Mismatch of two views."""
    squares, apart = np.float32(0), own[9] - other[9]
    for k in range(9):
        squares += (own[k] - other[k]) * (own[k] - other[k])
    return (squares / 9 + half) / (own[10] + other[10] + floor + apart * apart)


@njit(error_model="numpy")
def view_mismatch(image, near_x, near_y, count, x, y, slope, radius, floor, samples, costs):
    """Mean mismatch of the better part of the views of scene point (x, y) with one of the most central, and their
    number.

    0 for equal views, about 1 for unrelated ones, `UNKNOWN` where there is one. The first `count` lenses have their
    centres at `near_x`, `near_y`, the nearest first; the depth is `slope` = s / D; a mismatch of `floor` is noise.
    """
    height, width = image.shape
    pixels, one, unknown = image.reshape(-1), np.float32(1.0), np.float32(UNKNOWN)
    right, bottom = np.float32(width) - np.float32(2.001), np.float32(height) - np.float32(2.001)
    seen = 0
    for m in range(count):
        dx, dy = -(x - near_x[m]) * slope, -(y - near_y[m]) * slope
        # Those after it are farther. The first counts in any case.
        if m > 0 and dx * dx + dy * dy > radius * radius:
            break
        px, py = min(max(near_x[m] + dx, one), right), min(max(near_y[m] + dy, one), bottom)
        _sample(pixels, width, px, py, samples[m])
        seen += 1
    if seen < 2:
        return unknown, seen
    # Half of the others: an occluder may hide the rest.
    better, least = seen // 2, np.float32(np.inf)
    # The first view may be occluded.
    for r in range(2):
        found = 0
        for m in range(seen):
            if m == r:
                continue
            cost, at = _compare(samples[r], samples[m], unknown * floor, floor), found
            while at > 0 and costs[at - 1] > cost:
                costs[at] = costs[at - 1]
                at -= 1
            costs[at] = cost
            found += 1
        least = min(least, costs[:better].sum() / np.float32(better))
    return least, seen
