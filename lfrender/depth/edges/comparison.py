"""How well the pixels of a microimage match those of other lenses, at one depth each.

Work is done on boxes of pixels, one line each with `stride` pixels a row, in vector loops.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from ..same_surface import depth_order

__all__ = ["allow_mismatch", "compare_depth"]

# Other lenses that a pixel is compared with, at most; 10 gain 0.1 dB.
_VIEWS = 5
# [px] below this pitch, a mismatch is allowed in proportion to it. With 0.25 instead of 0.4 of the
# squares at all pitches, AntLeg (70 px) has 87 instead of 79 specks a megapixel in outer views.
_FULL_PITCH = np.float32(25)


@njit(error_model="numpy", fastmath=FAST)
def allow_mismatch(light, stride, number, noise2, pitch, allowed):
    """Fill `allowed` with the mismatch of each pixel with the four beside it that noise, blur,
    resampling and errors of depth explain.

    A depth that is wrong by a share of the pitch shifts small microimages less.
    """
    down = np.uint64(stride)
    one = np.uint64(1)
    fifth = np.float32(0.2)
    share = np.float32(0.4) * min(np.float32(1), np.float32(pitch) / _FULL_PITCH)
    for n in range(np.uint64(number - 2 * stride)):
        p = n + down
        a = light[p - down]
        b = light[p - one]
        d = light[p]
        e = light[p + one]
        f = light[p + down]
        mean = fifth * (a + b + d + e + f)
        a = a - mean
        b = b - mean
        d = d - mean
        e = e - mean
        f = f - mean
        allowed[p] = share * (a * a + b * b + d * d + e * e + f * f) + noise2


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _square_differences(
    light, pixels, there, width, x, y, shift_x, fx, fy, radius, at, count, apart, seen
):
    """Squared differences of `count` pixels from place `at` on from those `there`, a fraction of a
    pixel on, and which of them lie in the microimage, `y` below its middle and `shift_x` more than
    `x` beside it; none 2 px beyond its `radius`.
    """
    w11 = fx * fy
    w01 = fx - w11
    w10 = fy - w11
    w00 = np.float32(1.0) - fx - w10
    inner = np.float32(radius * radius - y * y)
    outer = np.float32((radius + 2) * (radius + 2) - y * y)
    one = np.uint64(1)
    down = np.uint64(width)
    beside = np.uint64(width + 1)
    none = np.float32(0)
    some = np.float32(1)
    first = np.uint64(there)
    for n in range(np.uint64(count)):
        p = at + n
        q = first + n
        e = (
            w00 * pixels[q]
            + w01 * pixels[q + one]
            + w10 * pixels[q + down]
            + w11 * pixels[q + beside]
            - light[p]
        )
        dx = x[n] + shift_x
        away = dx * dx
        apart[p] = e * e if away <= outer else none
        seen[p] = some if away <= inner else none


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _leave_out_occluded(before, there, nearest, pitch, at, count, seen):
    """Unset `seen` where pixels `there` showed something beyond `nearest` in order of depth."""
    none = np.float32(0)
    two = np.float32(2 * pitch)
    first = np.uint64(there)
    for n in range(np.uint64(count)):
        s = before[first + n]
        order = s if s > none else s + two
        seen[at + n] = none if order > nearest else seen[at + n]


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _add_lens(apart, seen, allowed, begin, number, stride, total, count, mismatch):
    """Add the mismatch of patches with another lens for those of `number` pixels from place `begin`
    on that have been compared with fewer than `_VIEWS`.

    The pixel itself counts half in a patch, the four beside it the other half.
    """
    one = np.uint64(1)
    down = np.uint64(stride)
    half = np.float32(0.5)
    eighth = np.float32(0.125)
    none = np.float32(0)
    enough = np.float32(_VIEWS)
    for n in range(number):
        p = begin + n
        beside = apart[p - one] + apart[p + one] + apart[p - down] + apart[p + down]
        e = half * apart[p] + eighth * beside
        mismatch[p] = seen[p] * e / (e + allowed[p]) if count[p] < enough else none
    for n in range(number):
        total[begin + n] += mismatch[begin + n]
    for n in range(number):
        count[begin + n] += seen[begin + n] if count[begin + n] < enough else none


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _is_complete(count, row, stride):
    """Whether all pixels of a row have been compared with enough lenses."""
    first = np.uint64(row * stride)
    least = np.float32(_VIEWS)
    for n in range(np.uint64(stride)):
        least = min(least, count[first + n])
    return least >= np.float32(_VIEWS)


@njit(error_model="numpy")
def _start_depth(k, size, stride, pitch, work):
    """Find the pixels that may show depth k, which have a `count` of 0, and their mean patch size
    [pitch] in each row, of all rows where there are none; returns the first row and the end of
    them, and the mean [pitch].
    """
    among = work.among
    present = work.present
    count = work.count
    value = work.value
    slopes = work.slopes
    left = work.left
    right = work.right
    first = size
    last = 0
    every = 0
    amount = 0.0
    count[:] = _VIEWS
    for row in range(size):
        number = 0
        total = 0.0
        for p in range(row * stride + left[row], row * stride + right[row]):
            if among[p] > 1 and present[k, p] > 0:
                count[p] = 0
                number = number + 1
                total = total + value[k, p]
        slopes[row] = total / (number * pitch) if number else np.nan
        if number:
            every = every + number
            amount = amount + total
            first = min(first, row)
            last = row + 1
    mean = amount / (max(every, 1) * pitch)
    for row in range(size):
        slopes[row] = mean if np.isnan(slopes[row]) else slopes[row]
    return first, last, mean


@njit(error_model="numpy")
def _finish_depth(k, first, last, stride, work):
    """Add the mean mismatch of each pixel to its cost; half of the largest one if it is unseen."""
    among = work.among
    present = work.present
    cost = work.cost
    number = work.count
    total = work.sum
    left = work.left
    right = work.right
    for row in range(first, last):
        for p in range(row * stride + left[row], row * stride + right[row]):
            if among[p] > 1 and present[k, p] > 0:
                seen = number[p]
                cost[k, p] += total[p] / seen if seen > 0 else np.float32(0.5)


@njit(error_model="numpy")
def compare_depth(pixels, shape, lens, k, left, top, size, stride, lenses, before, work):
    """Add the mismatch with other lenses to the costs of depth k, for the pixels that may show it.

    In the second round lenses are left out that the first one, `before`, finds occluded.
    """
    first, last, slope = _start_depth(k, size, stride, lenses.pitch, work)
    if last == 0:
        return
    # Arrays are taken out of tuples once: each access counts references.
    rows = lenses.rows
    low = lenses.low
    ring = lenses.ring
    centres = lenses.centres
    light = work.light
    x = work.x
    apart = work.apart
    seen = work.seen
    slopes = work.slopes
    allowed = work.allowed
    total = work.sum
    count = work.count
    mismatch = work.mismatch
    total[:] = 0
    height, width = shape
    pitch = lenses.pitch
    radius = lenses.radius
    gap = lenses.gap
    own_x = centres[lens, 0]
    own_y = centres[lens, 1]
    at_i = lenses.indices[lens, 0] - low[0]
    at_j = lenses.indices[lens, 1] - low[1]
    first = max(first, 1)
    last = min(last, size - 1)
    upper = first
    lower = last
    for r in range(1, len(ring)):
        ci = at_i + ring[r, 0]
        cj = at_j + ring[r, 1]
        if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1] or rows[cj, ci] < 0:
            continue
        other = rows[cj, ci]
        to_x = centres[other, 0] - own_x
        to_y = centres[other, 1] - own_y
        if (to_x * to_x + to_y * to_y) * slope * slope > 4 * radius * radius:
            continue
        # Rows that both microimages show, and that want further lenses.
        middle = own_y - to_y * slope - top
        begin = max(upper, int(middle - radius))
        end = min(lower, int(middle + radius) + 2)
        if begin >= end:
            continue
        # Patches reach a row further.
        for row in range(begin - 1, end + 1):
            # All pixels of a row are shifted alike.
            at = row * stride
            shift_x = to_x * slopes[row]
            shift_y = to_y * slopes[row]
            at_x = left + to_x + shift_x
            at_y = top + row + to_y + shift_y
            i = int(np.floor(at_x))
            j = int(np.floor(at_y))
            there = j * width + i
            if j < 2 or j >= height - 3 or there < 0 or there + stride + width + 1 >= len(pixels):
                for n in range(at, at + stride):
                    apart[n] = seen[n] = 0
                continue
            _square_differences(
                light,
                pixels,
                there,
                width,
                x,
                np.float32(top + row - own_y) + shift_y,
                np.float32(shift_x),
                np.float32(at_x - i),
                np.float32(at_y - j),
                radius,
                np.uint64(at),
                stride,
                apart,
                seen,
            )
            if i < 2 or i + stride >= width - 3:
                for n in range(stride):
                    if i + n < 2 or i + n >= width - 3:
                        seen[at + n] = 0
            if before.size > 1:
                there = int(at_y + 0.5) * width + int(np.floor(at_x + 0.5))
                nearest = np.float32(depth_order(slopes[row] * pitch, pitch) + gap)
                _leave_out_occluded(before, there, nearest, pitch, np.uint64(at), stride, seen)
        _add_lens(
            apart,
            seen,
            allowed,
            np.uint64(begin * stride),
            np.uint64((end - begin) * stride),
            stride,
            total,
            count,
            mismatch,
        )
        while upper < lower and _is_complete(count, upper, stride):
            upper += 1
        while upper < lower and _is_complete(count, lower - 1, stride):
            lower -= 1
        if upper >= lower:
            break
    _finish_depth(k, first, last, stride, work)
