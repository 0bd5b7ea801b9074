"""The pixels of a pair of microimages, one cut out, smoothed and with its slopes, the other laid over it at a shift."""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ...flat.microimages import copy_box

__all__ = [
    "NO_STEP",
    "SPLINE_MARGIN",
    "bspline_weights",
    "cut_smoothed",
    "first_pixel",
    "pixel_raster",
    "resample_shifted",
]

# Vector loops take up to so many pixels at a time. Places are unsigned: signed ones are looked at for being counted
# from the end.
_WHOLE = 64
#: Between columns, three more pixels are read than there are places.
SPLINE_MARGIN = 3
# Slopes are taken between the pixels on both sides, and smoothing reads one further [px].
_BEYOND = 2
#: No whole step between two microimages.
NO_STEP = 2**40


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def bspline_weights(f):
    """Weights of the four pixels at -1, 0, 1, 2 in the cubic B-spline at `f`.

    It smooths equally at every fraction; at 0 its weights are those of `cut_smoothed`. Compared with a picture smoothed
    that way it shifts a detail of w radians per pixel by less than w^5 / 1000 px; linear interpolation and Keys's cubic
    shift it by up to w^2 / 60 px, by the same amount over the whole flat.
    """
    one, sixth, half = np.float32(1.0), np.float32(1 / 6), np.float32(0.5)
    g = one - f
    return (
        sixth * g * g * g,
        np.float32(2 / 3) - half * f * f * (one + g),
        np.float32(2 / 3) - half * g * g * (one + f),
        sixth * f * f * f,
    )


@njit(cache=True, nogil=True, inline="always")
def _whole(count):
    """The next whole number of what vector loops take at a time."""
    return (count + _WHOLE - 1) // _WHOLE * _WHOLE


@njit(cache=True, nogil=True)
def pixel_raster(radius):
    """Side of the square that holds a microimage, pixels from row to row of one that is cut out, how many they are with
    what vector loops read beyond, and the column and line of each."""
    side = int(2 * radius) + 1
    wide = side + SPLINE_MARGIN
    size = max((side + SPLINE_MARGIN) * (wide + SPLINE_MARGIN), (side + 2 * _BEYOND) ** 2) + 2 * _WHOLE
    columns, lines = np.empty(size, np.float32), np.empty(size, np.float32)
    for k in range(size):
        columns[k], lines[k] = k % wide, k // wide
    return side, wide, size, columns, lines


@njit(cache=True, nogil=True, inline="always")
def first_pixel(centre, radius, side, size):
    """First of `side` pixels that hold a microimage, so that these and those beside them lie on the flat."""
    return min(max(int(np.ceil(centre - radius)), 1), size - side - 1)


# Without fast math: sums whose order it is free to choose would have other bits where the kernel is compiled than where
# it is loaded.
@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cut_smoothed(pixels, height, width, left, top, side, wide, box, smooth, own, slope_x, slope_y, bend):
    """A microimage smoothed by 1, 4, 1 over 6 in both directions, its slopes, and its Laplacian where there is room for
    it in `bend`, row after row.

    `box` and `smooth` are memory to work in.
    """
    across, half, one, two = side + 2 * _BEYOND, np.float32(0.5), np.uint64(1), np.uint64(2)
    first = left - _BEYOND
    for row in range(across):
        at, into = min(max(top - _BEYOND + row, 0), height - 1) * width, np.uint64(row * across)
        if first < 0 or first + across > width:
            for k in range(across):
                box[into + np.uint64(k)] = pixels[np.uint64(at + min(max(first + k, 0), width - 1))]
        else:
            for k in range(np.uint64(across)):
                box[into + k] = pixels[np.uint64(at + first) + k]
    line, four, weight = np.uint64(across), np.float32(4.0), np.float32(1 / 36)
    for k in range(np.uint64(across * (across - 2))):
        smooth[k] = box[k] + four * box[k + line] + box[k + line + line]
    # What lies between the end of one row and the beginning of the next is of no use.
    for k in range(np.uint64(across * (across - 2) - 2)):
        box[k] = weight * (smooth[k] + four * smooth[k + one] + smooth[k + two])
    for row in range(side):
        middle, into = np.uint64((row + 1) * across + 1), np.uint64(row * wide)
        for k in range(np.uint64(side)):
            own[into + k] = box[middle + k]
            slope_x[into + k] = half * (box[middle + one + k] - box[middle - one + k])
            slope_y[into + k] = half * (box[middle + line + k] - box[middle - line + k])
        if len(bend) > 0:
            for k in range(np.uint64(side)):
                beside = (box[middle + one + k] + box[middle - one + k]) + (
                    box[middle + line + k] + box[middle - line + k]
                )
                bend[into + k] = beside - four * box[middle + k]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _mean_of_four(values, start, apart, count, c0, c1, c2, c3, out):
    """Weighted sums of four values so far `apart`, for `count` places from `start` on."""
    first, second = np.uint64(start), np.uint64(start + apart)
    third, fourth = np.uint64(start + 2 * apart), np.uint64(start + 3 * apart)
    for k in range(np.uint64(count)):
        out[first + k] = (c0 * values[first + k] + c1 * values[second + k]) + (
            c2 * values[third + k] + c3 * values[fourth + k]
        )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def resample_shifted(
    pixels, height, width, ax, ay, bx, by, radius, s, pitch, left, top, side, wide, at, there, lines, other
):  # fmt: skip
    """What the second of two microimages shows at the pixels of the first, which is cut out from (left, top) on.

    Fills `other`, and returns from which place on and how many values that are, 0 if none; the direction of the step
    between both; and, relative to the first pixel that is cut out, both centres, the middle between them, the squared
    radius and the first and last column and row that both show.
    """
    ux, uy = (bx - ax) / pitch, (by - ay) / pitch
    tx, ty = bx - ax + s * ux, by - ay + s * uy
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    cx0, cx1, cx2, cx3 = bspline_weights(np.float32(tx - x0))
    cy0, cy1, cy2, cy3 = bspline_weights(np.float32(ty - y0))
    qx, qy = bx - tx, by - ty
    begin = max(int(np.ceil(max(ay, qy) - radius)), max(1, 1 - y0), top)
    end = min(int(np.floor(min(ay, qy) + radius)), min(height - 2, height - 3 - y0), top + side - 1)
    start, count = (begin - top) * wide, 0
    if end >= begin:
        # Most steps stay between the same pixels.
        if at[0] != x0 or at[1] != y0:
            copy_box(pixels, width, left + x0 - 1, top + y0 - 1, side + SPLINE_MARGIN, wide, there)
            at[0], at[1] = x0, y0
        count = _whole((end + 1 - begin) * wide)
        _mean_of_four(there, start, 1, _whole((end + 4 - begin) * wide), cx0, cx1, cx2, cx3, lines)
        _mean_of_four(lines, start, wide, count, cy0, cy1, cy2, cy3, other)
    # Relative to the first pixel that is cut out.
    x, y = np.float32(left), np.float32(top)
    return (
        start, count, ux, uy, ax - x, ay - y, qx - x, qy - y, np.float32(0.5) * (ax + qx) - x,
        np.float32(0.5) * (ay + qy) - y, radius * radius, np.float32(max(1, 1 - x0) - left),
        np.float32(min(width - 2 - left, width - 3 - x0 - left, side - 1)), np.float32(begin - top),
        np.float32(end - top),
    )  # fmt: skip
