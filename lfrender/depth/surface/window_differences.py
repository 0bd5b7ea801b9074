"""By how much other microimages differ from one at a patch size, place by place."""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ...flat.microimages import copy_box

__all__ = ["window_differences", "window_variance"]


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _squares(own, there, wide, count, w00, w01, w10, w11, out):
    """Squared difference of a microimage, `wide` pixels a row, from what another shows between its pixels."""
    down = np.uint64(wide)
    right, below = np.uint64(1), np.uint64(wide + 1)
    for k in range(np.uint64(count)):
        e = own[k] - (w00 * there[k] + w01 * there[k + right] + w10 * there[k + down] + w11 * there[k + below])
        out[k] = e * e


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums_of_squares(squares, v, wide, begin, end, lines, out, at):
    """Sums of the 3 x 3 squares about each place of row `v`, infinite but for `begin` to `end`; from place `at` on."""
    above, here, below = np.uint64((v - 1) * wide), np.uint64(v * wide), np.uint64((v + 1) * wide)
    into, one, two = np.uint64(at), np.uint64(1), np.uint64(2)
    for k in range(np.uint64(wide)):
        lines[one + k] = squares[above + k] + squares[here + k] + squares[below + k]
    first, last, far = np.int32(begin), np.int32(end), np.float32(np.inf)
    for k in range(np.uint64(wide)):
        u = np.int32(k)
        out[into + k] = lines[k] + lines[k + one] + lines[k + two] if (u >= first) & (u <= last) else far


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def window_differences(
    pixels, height, width, ax, ay, bx, by, radius, s, pitch, left, top, wide, begin_row, row_step, own, there, squares,
    lines, out, at,
):  # fmt: skip
    """Squared difference over 3 x 3 pixels of lens a from what lens b shows there; infinite where that is nothing.

    `own` is lens a with what lies about it, from the pixel (left, top) on, as many rows as each is `wide`. In `out`,
    from place `at` on, are the answers of every `row_step`-th of these rows from `begin_row` on, but for the last.
    """
    tx, ty = (bx - ax) * (1 + s / pitch), (by - ay) * (1 + s / pitch)
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    count = wide * wide
    copy_box(pixels, width, left + x0, top + y0, wide + 1, wide, there)
    _squares(own, there, wide, count, (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy, squares)
    qx, qy, r2 = bx - tx, by - ty, radius * radius
    first, last = max(1, 1 - x0), min(width - 2, width - 3 - x0)
    above, below = max(1, 1 - y0), min(height - 2, height - 3 - y0)
    row = at
    for v in range(begin_row, wide - 1, row_step):
        half = r2 - (top + v - qy) * (top + v - qy)
        begin, end = wide, -1
        if half > 0 and above <= top + v <= below:
            half = np.sqrt(half)
            begin = max(int(np.ceil(qx - half)), first) - left
            end = min(int(np.floor(qx + half)), last) - left
        _sums_of_squares(squares, v, wide, begin, end, lines, out, row)
        row += wide


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def window_variance(image, x, y):
    """Variance of the 3 x 3 pixels about (x, y)."""
    mean = squares = np.float32(0.0)
    for v in range(-1, 2):
        for u in range(-1, 2):
            value = image[y + v, x + u] - image[y, x]
            mean += value
            squares += value * value
    return squares / 9 - mean * mean / 81
