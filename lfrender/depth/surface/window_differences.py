"""By how much a microimage differs from another at a patch size, pixel by pixel, over windows of 3 x 3 pixels."""

from __future__ import annotations

from collections import namedtuple

import numpy as np

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

from ...flat.microimages import copy_box

__all__ = [
    "BORDER", "add_where_within", "copy_windows", "inner_columns", "new_windows", "window_differences",
    "window_variance",
]  # fmt: skip

#: [px] that windows reach beyond their middle.
BORDER = np.float32(1.0)

# A microimage with what lies about it, `stride` rows and columns, and memory for its comparison with others. `corner`
# (2,) is its first pixel x, y; `light` (stride^2,) its brightness; the others are work memory.
Windows = namedtuple("Windows", "stride corner light other squares lines")


@njit(cache=True, nogil=True)
def new_windows(radius):
    half = int(np.ceil(radius)) + 1
    stride = 2 * half + 2
    size = stride * stride
    return Windows(
        stride, np.zeros(2, np.int64), np.empty(size, np.float32), np.zeros(size + 2 * stride, np.float32),
        np.empty(size, np.float32), np.zeros(size, np.float32),
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def copy_windows(flat, x, y, windows):
    """Copy the microimage centred at (x, y)."""
    stride = windows.stride
    half = (stride - 2) // 2
    left, top = int(x) - half, int(y) - half
    windows.corner[0], windows.corner[1] = left, top
    copy_box(flat.pixels, flat.width, left, top, stride, stride, windows.light)


# Python's error model checks every division for zero, which prevents vector loops.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _square_differences(own, there, stride, count, w00, w01, w10, w11, out):
    """Squared difference of a microimage, `stride` pixels a row, from the bilinear interpolation of another."""
    down = np.uint64(stride)
    right, below = np.uint64(1), np.uint64(stride + 1)
    for k in range(np.uint64(count)):
        e = own[k] - (w00 * there[k] + w01 * there[k + right] + w10 * there[k + down] + w11 * there[k + below])
        out[k] = e * e


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_windows(squares, v, stride, begin, end, lines, out, at):
    """Sums over 3 x 3 pixels about each pixel of row `v`, infinite but for `begin` to `end`; from place `at` on."""
    above, here, below = np.uint64((v - 1) * stride), np.uint64(v * stride), np.uint64((v + 1) * stride)
    into, one, two = np.uint64(at), np.uint64(1), np.uint64(2)
    for k in range(np.uint64(stride)):
        lines[one + k] = squares[above + k] + squares[here + k] + squares[below + k]
    first, last, far = np.int32(begin), np.int32(end), np.float32(np.inf)
    for k in range(np.uint64(stride)):
        u = np.int32(k)
        out[into + k] = lines[k] + lines[k + one] + lines[k + two] if (u >= first) & (u <= last) else far


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def window_differences(flat, windows, ax, ay, bx, by, radius, s, pitch, begin_row, row_step, out, at):
    """Sums of squared differences over 3 x 3 pixels of lens a from lens b; infinite where b does not show the pixels.

    `windows` holds lens a, centred at (ax, ay). Every `row_step`-th of its rows from `begin_row` on, except the last,
    is written to `out`, from place `at` on.
    """
    stride, left, top = windows.stride, windows.corner[0], windows.corner[1]
    tx, ty = (bx - ax) * (1 + s / pitch), (by - ay) * (1 + s / pitch)
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    copy_box(flat.pixels, flat.width, left + x0, top + y0, stride + 1, stride, windows.other)
    _square_differences(
        windows.light, windows.other, stride, stride * stride, (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy,
        fx * fy, windows.squares,
    )  # fmt: skip
    qx, qy, r2 = bx - tx, by - ty, radius * radius
    first, last = max(1, 1 - x0), min(flat.width - 2, flat.width - 3 - x0)
    above, below = max(1, 1 - y0), min(flat.height - 2, flat.height - 3 - y0)
    row = at
    for v in range(begin_row, stride - 1, row_step):
        half = r2 - (top + v - qy) * (top + v - qy)
        begin, end = stride, -1
        if half > 0 and above <= top + v <= below:
            half = np.sqrt(half)
            begin = max(int(np.ceil(qx - half)), first) - left
            end = min(int(np.floor(qx + half)), last) - left
        _sum_windows(windows.squares, v, stride, begin, end, windows.lines, out, row)
        row += stride


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def add_where_within(differences, first, limits, number, out):
    """Add one to `out` at each of so many places where the differences from `first` on are within the limits."""
    one, none, begin = np.float32(1), np.float32(0), np.uint64(first)
    for k in range(np.uint64(number)):
        out[k] += one if differences[begin + k] <= limits[k] else none


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def inner_columns(y, ax, ay, radius, height, width):
    """First and last column of row `y` inside a microimage, and a pixel off the border; last < first if none."""
    half = radius * radius - (y - ay) * (y - ay)
    if half < 0 or y < 1 or y >= height - 1:
        return 0, -1
    half = np.sqrt(half)
    return max(1, int(np.ceil(ax - half))), min(width - 2, int(np.floor(ax + half)))


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
