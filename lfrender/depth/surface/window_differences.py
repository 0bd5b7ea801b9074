"""By how much a microimage differs from another at a patch size, pixel by pixel, over windows of 3 x 3 pixels."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ...flat.microimages import copy_box

__all__ = ["BORDER", "FEWEST", "copy_windows", "count_views", "inner_columns", "new_windows", "set_limits"]

#: [px] that windows reach beyond their middle.
BORDER = np.float32(1.0)
#: Fewer pixels hardly tell a depth.
FEWEST = 4

# A microimage with what lies about it, `stride` rows and columns, and its comparison with others. `corner` (2,) is its
# first pixel x, y; `light` (stride^2,) its brightness. Of every window there are the `limits` up to which a sum of
# squared differences is none, how many views show it, and how many confirm it. The others are work memory.
Windows = namedtuple("Windows", "stride corner light other squares lines differences limits showing confirming")


@njit
def new_windows(radius):
    half = int(np.ceil(radius)) + 1
    stride = 2 * half + 2
    size = stride * stride
    return Windows(
        stride, np.zeros(2, np.int64), np.empty(size, np.float32), np.zeros(size + 2 * stride, np.float32),
        np.empty(size, np.float32), np.zeros(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32),
        np.empty(size, np.float32), np.empty(size, np.float32),
    )  # fmt: skip


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def copy_windows(flat, x, y, windows):
    """Copy the microimage centred at (x, y)."""
    stride = windows.stride
    half = (stride - 2) // 2
    left, top = int(x) - half, int(y) - half
    windows.corner[0], windows.corner[1] = left, top
    copy_box(flat.pixels, flat.width, left, top, stride, stride, windows.light)


# Python's error model checks every division for zero, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _square_differences(own, there, stride, count, w00, w01, w10, w11, out):
    """Squared difference of a microimage, `stride` pixels a row, from the bilinear interpolation of another."""
    down = np.uint64(stride)
    right, below = np.uint64(1), np.uint64(stride + 1)
    for k in range(np.uint64(count)):
        e = own[k] - (w00 * there[k] + w01 * there[k + right] + w10 * there[k + down] + w11 * there[k + below])
        out[k] = e * e


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
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


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def set_limits(windows, begin_row, row_step, floor):
    """Let windows that differ by less than their own variance and a `floor` be alike: every `row_step`-th row."""
    stride, light, apart, squares = windows.stride, windows.light, windows.other, windows.squares
    sums, limits, ninth = windows.differences, windows.limits, np.float32(1 / 9)
    # Relative to one of them, squares of similar values keep their digits.
    middle = light[stride * stride // 2]
    for k in range(np.uint64(stride * stride)):
        apart[k] = light[k] - middle
        squares[k] = apart[k] * apart[k]
    row = 0
    for v in range(begin_row, stride - 1, row_step):
        _sum_windows(apart, v, stride, 0, stride, windows.lines, sums, row)
        _sum_windows(squares, v, stride, 0, stride, windows.lines, limits, row)
        at = np.uint64(row)
        for k in range(np.uint64(stride)):
            limits[at + k] += 9 * floor - ninth * sums[at + k] * sums[at + k]
        row += stride


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _compare_windows(flat, windows, a, b, radius, s, pitch, begin_row, row_step):
    """Sums of squared differences over 3 x 3 pixels of one lens from another, by their centres; infinite where that one
    does not show the pixels."""
    (ax, ay), (bx, by) = a, b
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
    row = 0
    for v in range(begin_row, stride - 1, row_step):
        half = r2 - (top + v - qy) * (top + v - qy)
        begin, end = stride, -1
        if half > 0 and above <= top + v <= below:
            half = np.sqrt(half)
            begin = max(int(np.ceil(qx - half)), first) - left
            end = min(int(np.floor(qx + half)), last) - left
        _sum_windows(windows.squares, v, stride, begin, end, windows.lines, windows.differences, row)
        row += stride


@njit(fastmath=FAST, error_model="numpy")
def count_views(flat, windows, centres, lens, radius, s, pitch, rows, begin_row, row_step):
    """Count in `windows` the neighbours, by `rows`, that show each window of a lens at patch size `s`, and those that
    differ by no more than its limit; returns the number of neighbours.

    Every `row_step`-th row of windows from `begin_row` on, except the last, one after the other.
    """
    differences, limits = windows.differences, windows.limits
    showing, confirming = windows.showing, windows.confirming
    one, none, far = np.float32(1), np.float32(0), np.float32(np.inf)
    number = ((windows.stride - 2 - begin_row) // row_step + 1) * windows.stride
    showing[:number] = confirming[:number] = 0
    neighbours = 0
    for k in range(rows.shape[1]):
        other = rows[lens, k]
        if other < 0:
            continue
        a, b = (centres[lens, 0], centres[lens, 1]), (centres[other, 0], centres[other, 1])
        _compare_windows(flat, windows, a, b, radius, s, pitch, begin_row, row_step)
        for n in range(np.uint64(number)):
            showing[n] += one if differences[n] < far else none
            confirming[n] += one if differences[n] <= limits[n] else none
        neighbours += 1
    return neighbours


@njit(fastmath=FAST, inline="always")
def inner_columns(y, ax, ay, radius, height, width):
    """First and last column of row `y` inside a microimage, and a pixel off the border; last < first if none."""
    half = radius * radius - (y - ay) * (y - ay)
    if half < 0 or y < 1 or y >= height - 1:
        return 0, -1
    half = np.sqrt(half)
    return max(1, int(np.ceil(ax - half))), min(width - 2, int(np.floor(ax + half)))
