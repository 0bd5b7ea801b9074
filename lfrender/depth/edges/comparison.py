"""How well the pixels of a microimage match those of other lenses, at one depth each.

Work is done on boxes of pixels, one line each with `stride` pixels a row, in vector loops.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from ..same_surface import depth_order
from .microimage import LEFT_OUT

__all__ = ["allow_mismatch", "compare_depth"]

# Other lenses that a pixel is compared with, at most; 10 gain 0.1 dB.
_VIEWS = 5


@njit(error_model="numpy", fastmath=FAST)
def allow_mismatch(light, stride, number, noise2, allowed):
    """Fill `allowed` with the mismatch of each pixel with the four beside it that noise, blur and resampling
    explain."""
    down, one, fifth, share = np.uint64(stride), np.uint64(1), np.float32(0.2), np.float32(0.4)
    for n in range(np.uint64(number - 2 * stride)):
        p = n + down
        a, b, d, e, f = light[p - down], light[p - one], light[p], light[p + one], light[p + down]
        mean = fifth * (a + b + d + e + f)
        a, b, d, e, f = a - mean, b - mean, d - mean, e - mean, f - mean
        allowed[p] = share * (a * a + b * b + d * d + e * e + f * f) + noise2


@njit(error_model="numpy", fastmath=FAST)
def _square_differences(light, pixels, there, width, x, y, shift_x, fx, fy, radius, at, count, apart, seen):
    """Squared differences of `count` pixels from place `at` on from those `there`, a fraction of a pixel on, and which
    of them lie in the microimage, `y` below its middle and `shift_x` more than `x` beside it; none 2 px beyond its
    `radius`."""
    w11 = fx * fy
    w01, w10 = fx - w11, fy - w11
    w00 = np.float32(1.0) - fx - w10
    inner, outer = np.float32(radius * radius - y * y), np.float32((radius + 2) * (radius + 2) - y * y)
    one, down, beside = np.uint64(1), np.uint64(width), np.uint64(width + 1)
    none, some, first = np.float32(0), np.float32(1), np.uint64(there)
    for n in range(np.uint64(count)):
        p, q = at + n, first + n
        e = w00 * pixels[q] + w01 * pixels[q + one] + w10 * pixels[q + down] + w11 * pixels[q + beside] - light[p]
        dx = x[n] + shift_x
        away = dx * dx
        apart[p] = e * e if away <= outer else none
        seen[p] = some if away <= inner else none


@njit(error_model="numpy", fastmath=FAST)
def _leave_out_occluded(before, there, nearest, pitch, at, count, seen):
    """Unset `seen` where pixels `there` showed something beyond `nearest` in the order of depths."""
    none, two, first = np.float32(0), np.float32(2 * pitch), np.uint64(there)
    for n in range(np.uint64(count)):
        s = before[first + n]
        order = s if s > none else s + two
        seen[at + n] = none if order > nearest else seen[at + n]


@njit(error_model="numpy")
def _look(pixels, shape, before, left, top, y, first, last, stride, to_x, to_y, lenses, work):
    """Fill `apart` and `seen` in rows `first` to `last` for another lens, (to_x, to_y) from this one, in row `y`."""
    height, width, pitch, apart, seen = shape[0], shape[1], lenses.pitch, work.apart, work.seen
    for row in range(first, last):
        # All pixels of a row are shifted alike.
        at, slope = np.uint64(row * stride), work.slopes[row]
        shift_x, shift_y = to_x * slope, to_y * slope
        at_x, at_y = left + to_x + shift_x, top + row + to_y + shift_y
        i, j = int(np.floor(at_x)), int(np.floor(at_y))
        there = j * width + i
        if j < 2 or j >= height - 3 or there < 0 or there + stride + width + 1 >= len(pixels):
            apart[row * stride : (row + 1) * stride] = 0
            seen[row * stride : (row + 1) * stride] = 0
            continue
        down = np.float32(top + row - y) + shift_y
        _square_differences(work.light, pixels, there, width, work.x, down, np.float32(shift_x), np.float32(at_x - i),
                            np.float32(at_y - j), lenses.radius, at, stride, apart, seen)  # fmt: skip
        if i < 2 or i + stride >= width - 3:
            for n in range(stride):
                if i + n < 2 or i + n >= width - 3:
                    seen[row * stride + n] = 0
        if before.size > 1:
            there = int(at_y + 0.5) * width + int(np.floor(at_x + 0.5))
            nearest = np.float32(depth_order(slope * pitch, pitch) + lenses.gap)
            _leave_out_occluded(before, there, nearest, pitch, at, stride, seen)


@njit(error_model="numpy", fastmath=FAST)
def _add_lens(apart, seen, allowed, first, last, stride, leave_out, wanted, total, count, worst, mismatch):
    """Add the mismatch of patches with another lens; pixels that have enough views want no further one."""
    begin, number = np.uint64(first * stride), np.uint64((last - first) * stride)
    one, down, fifth = np.uint64(1), np.uint64(stride), np.float32(0.2)
    for n in range(number):
        p = begin + n
        e = fifth * (apart[p] + apart[p - one] + apart[p + one] + apart[p - down] + apart[p + down])
        mismatch[p] = seen[p] * wanted[p] * e / (e + allowed[p])
    for n in range(number):
        total[begin + n] += mismatch[begin + n]
    for n in range(number):
        count[begin + n] += seen[begin + n] * wanted[begin + n]
    for m in range(leave_out):
        at = np.uint64(m * len(total)) + begin
        for n in range(number):
            w, e = worst[at + n], mismatch[begin + n]
            worst[at + n], mismatch[begin + n] = max(w, e), min(w, e)
    for n in range(number):
        p = begin + n
        wanted[p] = wanted[p] if count[p] < _VIEWS else np.float32(0)


@njit(error_model="numpy")
def _start_depth(k, size, stride, pitch, work):
    """Find the pixels that may show depth k, and their mean patch size [pitch] in each row, of all rows where there are
    none; returns the first row and the end of them, and the mean [pitch]."""
    among, present, wanted, value, slopes = work.among, work.present, work.wanted, work.value, work.slopes
    first, last, every, amount = size, 0, 0, 0.0
    for row in range(size):
        number, total = 0, 0.0
        for p in range(row * stride + work.left[row], row * stride + work.right[row]):
            if among[p] > 1 and present[k, p] > 0:
                wanted[p] = 1
                number, total = number + 1, total + value[k, p]
        slopes[row] = total / (number * pitch) if number else np.nan
        if number:
            every, amount, first, last = every + number, amount + total, min(first, row), row + 1
    mean = amount / (max(every, 1) * pitch)
    for row in range(size):
        slopes[row] = mean if np.isnan(slopes[row]) else slopes[row]
    return first, last, mean


@njit(error_model="numpy")
def _finish_depth(k, first, last, stride, leave_out, work):
    """Add the mean mismatch of each pixel, but for up to `leave_out` lenses, to its cost; half of the largest if
    unseen."""
    among, present, cost, number, total, worst = (
        work.among, work.present, work.cost, work.count, work.sum, work.worst
    )  # fmt: skip
    for row in range(first, last):
        for p in range(row * stride + work.left[row], row * stride + work.right[row]):
            if among[p] > 1 and present[k, p] > 0:
                count, mismatch = int(number[p]), np.float32(0.5)
                if count > 0:
                    left_out, mismatch = min(leave_out, count // 2), total[p]
                    for m in range(left_out):
                        mismatch -= worst[m * len(total) + p]
                    mismatch = max(mismatch, np.float32(0.0)) / np.float32(count - left_out)
                cost[k, p] += mismatch


@njit(error_model="numpy")
def compare_depth(pixels, shape, lens, k, left, top, size, stride, lenses, before, work):
    """Add the mismatch with other lenses to the costs of depth k, for the pixels that may show it.

    In the first round lenses that differ most may be occluded; later those that it, `before`, finds occluded are.
    """
    rows, low, ring, centres = lenses.rows, lenses.low, lenses.ring, lenses.centres
    wanted = work.wanted
    wanted[:] = 0
    first, last, slope = _start_depth(k, size, stride, lenses.pitch, work)
    if last == 0:
        return
    work.sum[:], work.count[:], work.worst[:] = 0, 0, 0
    at_i, at_j = lenses.indices[lens, 0] - low[0], lenses.indices[lens, 1] - low[1]
    leave_out = 0 if before.size > 1 else LEFT_OUT
    first, last = max(first, 1), min(last, size - 1)
    upper, lower = first, last
    for r in range(1, len(ring)):
        ci, cj = at_i + ring[r, 0], at_j + ring[r, 1]
        if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1] or rows[cj, ci] < 0:
            continue
        other = rows[cj, ci]
        to_x, to_y = centres[other, 0] - centres[lens, 0], centres[other, 1] - centres[lens, 1]
        if (to_x * to_x + to_y * to_y) * slope * slope > 4 * lenses.radius * lenses.radius:
            continue
        # Rows that both microimages show, and that want further lenses.
        middle = centres[lens, 1] - to_y * slope - top
        begin, end = max(upper, int(middle - lenses.radius)), min(lower, int(middle + lenses.radius) + 2)
        if begin >= end:
            continue
        # Patches reach a row further.
        _look(pixels, shape, before, left, top, centres[lens, 1], begin - 1, end + 1, stride, to_x, to_y, lenses, work)
        _add_lens(work.apart, work.seen, work.allowed, begin, end, stride, leave_out, wanted, work.sum, work.count,
                  work.worst, work.mismatch)  # fmt: skip
        while upper < lower and wanted[upper * stride : (upper + 1) * stride].max() == 0:
            upper += 1
        while upper < lower and wanted[(lower - 1) * stride : lower * stride].max() == 0:
            lower -= 1
        if upper >= lower:
            break
    _finish_depth(k, first, last, stride, leave_out, work)
