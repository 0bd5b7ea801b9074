"""The pixels of a pair of microimages: one cut out and smoothed, the other interpolated at a shift
to the same pixels.

Both are smoothed by a cubic B-spline: the first at whole pixels, the second at the fraction of the
shift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from ...flat.microimages import copy_box

__all__ = [
    "COLUMN",
    "LAPLACIAN",
    "LIGHT",
    "NO_STEP",
    "ROW",
    "SHIFTED",
    "SLOPE_X",
    "SLOPE_Y",
    "SPLINE_MARGIN",
    "Overlap",
    "Pair",
    "Raster",
    "cut_smoothed",
    "first_pixel",
    "pixel_raster",
    "resample_shifted",
    "work_memory",
]

# Vector loops run over whole multiples of this many pixels. Array places are unsigned integers:
# signed ones are checked for being negative, which prevents vector loops.
_WHOLE = 64
#: A row or column of interpolated pixels needs three more pixels than it has places.
SPLINE_MARGIN = 3
# Slopes read a pixel to either side, and smoothing one further [px].
_BEYOND = 2
#: Step of a box that holds no microimage yet: no shift is this long [px].
NO_STEP = 2**40

#: Rows of the work memory: place of each pixel in the cutout, brightness of the first microimage,
#: its slopes, its Laplacian, brightness of the second microimage at the shift.
COLUMN, ROW, LIGHT, SLOPE_X, SLOPE_Y, LAPLACIAN, SHIFTED = range(7)
# A box with margin, and the same with its rows or columns smoothed.
_BOX, _LINES = 7, 8


class Raster(NamedTuple):
    """Pixels of a microimage that is cut out, row after row."""

    side: int  # pixels of each row that are used, and rows
    stride: int  # pixels of each row
    size: int  # length of arrays that vector loops may overrun


class Pair(NamedTuple):
    """Two microimages [px]."""

    ax: np.float32  # centre of the first one
    ay: np.float32
    bx: np.float32  # centre of the second one
    by: np.float32
    radius: np.float32
    pitch: np.float32


class Overlap(NamedTuple):
    """The part of a cutout that both microimages show; places are relative to its first pixel."""

    start: int  # first place
    places: int  # number of places from there on, a multiple of the length of vector loops
    ux: np.float32  # step from lens to lens [pitch]
    uy: np.float32
    ax: np.float32  # centre of the first microimage
    ay: np.float32
    qx: np.float32  # centre of the second one at its shift
    qy: np.float32
    radius2: np.float32
    low_x: np.float32  # first and last column and row
    high_x: np.float32
    low_y: np.float32
    high_y: np.float32


@njit(fastmath=FAST, inline="always")
def _bspline_weights(f):
    """Weights of the four pixels at -1, 0, 1, 2 in the cubic B-spline at `f`, which smooths equally
    at every fraction.

    Linear interpolation and Keys's cubic would shift detail of w radians per pixel by up to w^2 /
    60 px.
    """
    one = np.float32(1.0)
    sixth = np.float32(1 / 6)
    half = np.float32(0.5)
    g = one - f
    return (
        sixth * g * g * g,
        np.float32(2 / 3) - half * f * f * (one + g),
        np.float32(2 / 3) - half * g * g * (one + f),
        sixth * f * f * f,
    )


@njit
def pixel_raster(radius):
    """The raster of microimages of a radius [px]."""
    side = int(2 * radius) + 1
    stride = side + 2 * _BEYOND
    return Raster(side, stride, (stride + SPLINE_MARGIN) ** 2 + 2 * _WHOLE)


@njit
def work_memory(raster):
    """Work memory (rows, size) for a pair; vector loops read values that have not been set, which
    must be numbers.
    """
    work = np.zeros((_LINES + 1, raster.size), np.float32)
    for k in range(raster.size):
        work[COLUMN, k] = k % raster.stride
        work[ROW, k] = k // raster.stride
    return work


@njit(inline="always")
def first_pixel(centre, radius, side, size):
    """First of the `side` pixels of a microimage along one axis; these pixels and one more on each
    side lie on the flat.
    """
    return min(max(int(np.ceil(centre - radius)), 1), size - side - 1)


# Without fast math: sums whose order it is free to choose would have other bits where the kernel is
# compiled than where it is loaded.
@njit(error_model="numpy", forceinline=True)
def cut_smoothed(pixels, width, raster, corner, types, work):
    """Cut out a microimage from pixel `corner` on, smoothed by (1, 4, 1) / 6 in both directions,
    with its slopes, and its Laplacian unless `types` is None.
    """
    stride = raster.stride
    box = work[_BOX]
    smooth = work[_LINES]
    copy_box(pixels, width, corner[0] - _BEYOND, corner[1] - _BEYOND, stride, stride, box)
    half = np.float32(0.5)
    four = np.float32(4.0)
    weight = np.float32(1 / 36)
    one = np.uint64(1)
    two = np.uint64(2)
    line = np.uint64(stride)
    rows = stride * (raster.side + 2)
    for k in range(np.uint64(rows)):
        smooth[k] = box[k] + four * box[k + line] + box[k + line + line]
    # Values between the end of one row and the beginning of the next are not used.
    for k in range(np.uint64(rows - 2)):
        box[k] = weight * (smooth[k] + four * smooth[k + one] + smooth[k + two])
    middle = line + one
    count = np.uint64(raster.side * stride)
    # Each loop writes one row: the compiler checks few arrays for being others.
    for k in range(count):
        work[LIGHT, k] = box[middle + k]
    for k in range(count):
        work[SLOPE_X, k] = half * (box[middle + one + k] - box[middle - one + k])
    for k in range(count):
        work[SLOPE_Y, k] = half * (box[middle + line + k] - box[middle - line + k])
    if types is not None:
        for k in range(count):
            beside = box[middle + one + k] + box[middle - one + k]
            beside += box[middle + line + k] + box[middle - line + k]
            work[LAPLACIAN, k] = beside - four * box[middle + k]


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _mean_of_four(work, source, target, start, apart, count, weights):
    """Weighted sums of four values that lie `apart` from each other, for `count` places."""
    c0, c1, c2, c3 = weights
    first = np.uint64(start)
    second = np.uint64(start + apart)
    third = np.uint64(start + 2 * apart)
    fourth = np.uint64(start + 3 * apart)
    for k in range(np.uint64(count)):
        work[target, first + k] = (c0 * work[source, first + k] + c1 * work[source, second + k]) + (
            c2 * work[source, third + k] + c3 * work[source, fourth + k]
        )


@njit(inline="always")
def _whole(count):
    """The multiple of the length of vector loops from a count on."""
    return (count + _WHOLE - 1) // _WHOLE * _WHOLE


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def resample_shifted(pixels, shape, raster, corner, pair, s, work, step):
    """Interpolate the second of two microimages at the pixels of the first, which is cut out from
    pixel `corner` on, and return their `Overlap`.

    The scene between both lenses has the patch size `s` [px]. `step` (2,) is the whole shift of the
    box that the work memory holds.
    """
    height, width = shape
    left, top = corner
    side, stride, _ = raster
    ux = (pair.bx - pair.ax) / pair.pitch
    uy = (pair.by - pair.ay) / pair.pitch
    tx = pair.bx - pair.ax + s * ux
    ty = pair.by - pair.ay + s * uy
    x0 = int(np.floor(tx))
    y0 = int(np.floor(ty))
    qx = pair.bx - tx
    qy = pair.by - ty
    first_row = int(np.ceil(max(pair.ay, qy) - pair.radius))
    last_row = int(np.floor(min(pair.ay, qy) + pair.radius))
    begin = max(first_row, max(1, 1 - y0), top)
    end = min(last_row, min(height - 2, height - 3 - y0), top + side - 1)
    start = (begin - top) * stride
    count = 0
    if end >= begin:
        # Most iterations stay between the same pixels.
        if step[0] != x0 or step[1] != y0:
            rows = side + SPLINE_MARGIN
            copy_box(pixels, width, left + x0 - 1, top + y0 - 1, rows, stride, work[_BOX])
            step[0] = x0
            step[1] = y0
        count = _whole((end + 1 - begin) * stride)
        across = _bspline_weights(np.float32(tx - x0))
        down = _bspline_weights(np.float32(ty - y0))
        further = count + _whole(SPLINE_MARGIN * stride)
        _mean_of_four(work, _BOX, _LINES, start, 1, further, across)
        _mean_of_four(work, _LINES, SHIFTED, start, stride, count, down)
    x = np.float32(left)
    y = np.float32(top)
    return Overlap(
        start,
        count,
        ux,
        uy,
        pair.ax - x,
        pair.ay - y,
        qx - x,
        qy - y,
        pair.radius * pair.radius,
        np.float32(max(1, 1 - x0) - left),
        np.float32(min(width - 2 - left, width - 3 - x0 - left, side - 1)),
        np.float32(begin - top),
        np.float32(end - top),
    )
