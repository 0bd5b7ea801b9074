"""Sums over the pixels that two microimages share at a shift, from which their correlation follows.

Three ways to the same sums: from the flat itself, from strips with a mask, and from strips pixel by pixel at the rim.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

__all__ = ["Overlap", "in_both", "pair_moments", "rim_moments", "strip_moments"]


class Overlap(NamedTuple):
    """Two discs, at `ax, ay` and `bx, by` from the middle of a strip, and the least `x, y` inside the second strip."""

    ax: np.float32
    ay: np.float32
    bx: np.float32
    by: np.float32
    low_x: np.float32
    low_y: np.float32
    radius2: np.float32


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _row_moments(row, upper, lower, w00, w01, w10, w11, mean):
    """Sums over one row of pixels and the interpolated row of another lens, between `upper` and `lower`."""
    sa = sb = saa = sbb = sab = np.float32(0.0)
    for k in range(len(row)):
        a = row[k] - mean
        b = w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1] - mean
        sa += a
        sb += b
        saa += a * a
        sbb += b * b
        sab += a * b
    return sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def pair_moments(image, ax, ay, bx, by, radius, tx, ty, mean, row_step):
    """Sums over all pixels of lens a whose partner, `(tx, ty)` away, lies in lens b."""
    height, width = image.shape
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = saa = sbb = sab = np.float32(0.0)
    count = 0
    r2 = radius * radius
    # Centre of the disc of lens b, seen from the pixels of lens a.
    qx, qy = bx - tx, by - ty
    top = max(int(np.ceil(max(ay, qy) - radius)), max(0, -y0))
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 1, height - 2 - y0))
    for y in range(top, bottom + 1, row_step):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(0, -x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 1, width - 2 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        row = image[y, left : right + 1]
        upper = image[y + y0, left + x0 : right + x0 + 2]
        lower = image[y + y0 + 1, left + x0 : right + x0 + 2]
        count += n
        ra, rb, raa, rbb, rab = _row_moments(row, upper, lower, w00, w01, w10, w11, mean)
        sa += ra
        sb += rb
        saa += raa
        sbb += rbb
        sab += rab
    return count, sa, sb, saa, sbb, sab


# The error model of NumPy, because Python's checks every division, which prevents vector loops. Indices are unsigned,
# because signed ones are checked for counting from the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def strip_moments(strips, own, other, upper, lower, masks, mask, count, weights):
    """Sums over the masked pixels of one strip and the interpolated ones of another, `upper` and `lower` values on."""
    one = np.uint64(1)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, m = np.uint64(own), np.uint64(mask)
    w00, w01, w10, w11 = weights
    sa = sb = saa = sbb = sab = np.float32(0.0)
    for k in range(np.uint64(count)):
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b *= masks[m + k]
        c = masks[m + k] * strips[a + k]
        sa += c
        sb += b
        saa += c * c
        sbb += b * b
        sab += c * b
    return sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def in_both(x, y, both):
    """Whether a pixel, counted from the middle of a strip, lies in both discs of an `Overlap`."""
    a2 = (x - both.ax) * (x - both.ax) + (y - both.ay) * (y - both.ay)
    b2 = (x - both.bx) * (x - both.bx) + (y - both.by) * (y - both.by)
    return (max(a2, b2) <= both.radius2) & (x >= both.low_x) & (y >= both.low_y)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def rim_moments(strips, columns, lines, own, other, upper, lower, start, count, both, weights):
    """As `strip_moments`, with the number of pixels, over those of a small overlap, each tested by itself."""
    one, zero, unit = np.uint64(1), np.float32(0.0), np.float32(1.0)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, first = np.uint64(own), np.uint64(start)
    w00, w01, w10, w11 = weights
    number = sa = sb = saa = sbb = sab = zero
    for k in range(np.uint64(count)):
        inside = in_both(columns[first + k], lines[first + k], both)
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b, c = b if inside else zero, strips[a + k] if inside else zero
        number += unit if inside else zero
        sa += c
        sb += b
        saa += c * c
        sbb += b * b
        sab += c * b
    return number, sa, sb, saa, sbb, sab
