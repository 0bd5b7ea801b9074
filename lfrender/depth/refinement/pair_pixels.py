"""The pixels of a pair of microimages: one cut out and smoothed, the other interpolated at a shift
to the same pixels.

Both are smoothed by a cubic B-spline: the first at whole pixels, the second at the fraction of the
shift.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from ...flat.microimages import copy_box

__all__ = [
    "NO_STEP",
    "SPLINE_MARGIN",
    "cut_smoothed",
    "first_pixel",
    "pixel_raster",
    "resample_shifted",
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

# Pixels of a cut-out microimage, row after row: `side` of `stride` pixels in each row are used.
# `size` is the length of arrays that vector loops may overrun; `columns` and `rows` (size,) are
# float32.
Raster = namedtuple("Raster", "side stride size columns rows")

# The part of a cutout that both microimages show. It lies within `number` places from `start` on.
# `ux, uy` is the step between the lenses [pitches] and `r2` the squared radius. Places are relative
# to the first pixel of the cutout: the centre of the first microimage (`ax, ay`) and of the second
# one at its shift (`qx, qy`), the middle between them (`mx, my`), and the first and last column and
# row.
Overlap = namedtuple("Overlap", "start number ux uy ax ay qx qy mx my r2 low_x high_x low_y high_y")


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
    side = int(2 * radius) + 1
    stride = side + SPLINE_MARGIN
    size = (
        max((side + SPLINE_MARGIN) * (stride + SPLINE_MARGIN), (side + 2 * _BEYOND) ** 2)
        + 2 * _WHOLE
    )
    columns = np.empty(size, np.float32)
    rows = np.empty(size, np.float32)
    for k in range(size):
        columns[k], rows[k] = k % stride, k // stride
    return Raster(side, stride, size, columns, rows)


@njit(inline="always")
def first_pixel(centre, radius, side, size):
    """First of the `side` pixels of a microimage along one axis; these pixels and one more on each
    side lie on the flat.
    """
    return min(max(int(np.ceil(centre - radius)), 1), size - side - 1)


# Without fast math: sums whose order it is free to choose would have other bits where the kernel is
# compiled than where it is loaded.
@njit(error_model="numpy", forceinline=True)
def cut_smoothed(
    pixels, height, width, side, stride, left, top, box, smooth, light, slope_x, slope_y, laplacian
):
    """Cut out a microimage from pixel (left, top) on, smoothed by (1, 4, 1) / 6 in both directions,
    with slopes.
    """
    across = side + 2 * _BEYOND
    half = np.float32(0.5)
    one = np.uint64(1)
    two = np.uint64(2)
    first = left - _BEYOND
    for row in range(across):
        at = min(max(top - _BEYOND + row, 0), height - 1) * width
        into = np.uint64(row * across)
        if first < 0 or first + across > width:
            for k in range(across):
                box[into + np.uint64(k)] = pixels[np.uint64(at + min(max(first + k, 0), width - 1))]
        else:
            for k in range(np.uint64(across)):
                box[into + k] = pixels[np.uint64(at + first) + k]
    line = np.uint64(across)
    four = np.float32(4.0)
    weight = np.float32(1 / 36)
    for k in range(np.uint64(across * (across - 2))):
        smooth[k] = box[k] + four * box[k + line] + box[k + line + line]
    # Values between the end of one row and the beginning of the next are not used.
    for k in range(np.uint64(across * (across - 2) - 2)):
        box[k] = weight * (smooth[k] + four * smooth[k + one] + smooth[k + two])
    for row in range(side):
        middle = np.uint64((row + 1) * across + 1)
        into = np.uint64(row * stride)
        for k in range(np.uint64(side)):
            light[into + k] = box[middle + k]
            slope_x[into + k] = half * (box[middle + one + k] - box[middle - one + k])
            slope_y[into + k] = half * (box[middle + line + k] - box[middle - line + k])
        if laplacian is not None:
            for k in range(np.uint64(side)):
                beside = (box[middle + one + k] + box[middle - one + k]) + (
                    box[middle + line + k] + box[middle - line + k]
                )
                laplacian[into + k] = beside - four * box[middle + k]


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _mean_of_four(values, start, apart, count, c0, c1, c2, c3, out):
    """Weighted sums of four values that lie `apart` from each other, for `count` places."""
    first = np.uint64(start)
    second = np.uint64(start + apart)
    third = np.uint64(start + 2 * apart)
    fourth = np.uint64(start + 3 * apart)
    for k in range(np.uint64(count)):
        out[first + k] = (c0 * values[first + k] + c1 * values[second + k]) + (
            c2 * values[third + k] + c3 * values[fourth + k]
        )


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def resample_shifted(
    pixels, size, shape, corner, centres, radius, s, pitch, box, lines, shifted, step
):
    """Fill `shifted` with the second of two microimages at the pixels of the first, and return the
    `Overlap`.

    The lenses have their `centres` at (ax, ay, bx, by), and the scene between them has the patch
    size `s`; the first is cut out from pixel `corner` on. Work memory: the other one in a `box`,
    its rows interpolated in `lines`, and the whole `step` (2,) for which the box was copied.
    """
    (height, width), (side, stride), (left, top), (ax, ay, bx, by) = size, shape, corner, centres
    ux = (bx - ax) / pitch
    uy = (by - ay) / pitch
    tx = bx - ax + s * ux
    ty = by - ay + s * uy
    x0 = int(np.floor(tx))
    y0 = int(np.floor(ty))
    cx0, cx1, cx2, cx3 = _bspline_weights(np.float32(tx - x0))
    cy0, cy1, cy2, cy3 = _bspline_weights(np.float32(ty - y0))
    qx = bx - tx
    qy = by - ty
    begin = max(int(np.ceil(max(ay, qy) - radius)), max(1, 1 - y0), top)
    end = min(int(np.floor(min(ay, qy) + radius)), min(height - 2, height - 3 - y0), top + side - 1)
    start = (begin - top) * stride
    count = 0
    if end >= begin:
        # Most iterations stay between the same pixels.
        if step[0] != x0 or step[1] != y0:
            copy_box(pixels, width, left + x0 - 1, top + y0 - 1, side + SPLINE_MARGIN, stride, box)
            step[0], step[1] = x0, y0
        count = ((end + 1 - begin) * stride + _WHOLE - 1) // _WHOLE * _WHOLE
        _mean_of_four(
            box,
            start,
            1,
            count + (3 * stride + _WHOLE - 1) // _WHOLE * _WHOLE,
            cx0,
            cx1,
            cx2,
            cx3,
            lines,
        )
        _mean_of_four(lines, start, stride, count, cy0, cy1, cy2, cy3, shifted)
    x = np.float32(left)
    y = np.float32(top)
    return Overlap(
        start,
        count,
        ux,
        uy,
        ax - x,
        ay - y,
        qx - x,
        qy - y,
        np.float32(0.5) * (ax + qx) - x,
        np.float32(0.5) * (ay + qy) - y,
        radius * radius,
        np.float32(max(1, 1 - x0) - left),
        np.float32(min(width - 2 - left, width - 3 - x0 - left, side - 1)),
        np.float32(begin - top),
        np.float32(end - top),
    )
