"""Mean microimage of a flat, and shifts of single microimages against it.

The mean microimage is a picture of one cell of the lattice: rims and gaps follow the outline of the
cell, whatever its shape. It is made symmetric under a half turn about its centre, which cancels what
a wrong centre would add to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ..lattice.cell import Cell, row_interval
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..runtime.arrays import Array, Floats, Singles
from ..runtime.kernels import FAST, kernel
from .cell_bins import VECTOR_LENGTH, compute_cell_bins

__all__ = ["average_cells", "build_lens_equations"]

# Parts of the lenses that are summed in parallel: a fixed number, so that sums do not depend on
# that of the threads.
_CHUNKS = 16
# Most contrast of a lens over that of the mean microimage.
_MOST_CONTRAST = 2.0


@njit(error_model="numpy", forceinline=True)
def _gather_pixels(picture, cx, cy, lens, sides, inverse, stride, bins, place, values):
    """Write bins and values of the pixels of a cell; return their number. Some more may be
    overwritten.
    """
    height, width = picture.shape
    number = np.uint64(0)
    for y in range(
        int(np.ceil(cy + sides[6, 0])) + lens % stride, int(np.floor(cy + sides[6, 1])) + 1, stride
    ):
        dy = y - cy
        low, high = row_interval(dy, sides)
        first = int(np.ceil(cx + low))
        last = int(np.floor(cx + high))
        first += (lens // stride - first) % stride
        if first > last:
            continue
        dx = first - cx
        count = (last - first) // stride + 1
        u = dx * inverse[0, 0] + dy * inverse[1, 0] + 0.5 / bins
        v = dx * inverse[0, 1] + dy * inverse[1, 1] + 0.5 / bins
        compute_cell_bins(
            u, v, inverse[0, 0] * stride, inverse[0, 1] * stride, bins, number, count, place
        )
        pixels = picture[y]
        # Memory beyond the last row must not be read.
        if stride == 1 and (y + 1 < height or first + count + VECTOR_LENGTH <= width):
            for start in range(0, count, VECTOR_LENGTH):
                for lane in range(VECTOR_LENGTH):
                    at = np.uint64(start) + np.uint64(lane)
                    values[number + at] = pixels[np.uint64(first) + at]
        else:
            for k in range(np.uint64(count)):
                values[number + k] = pixels[np.uint64(first) + k * np.uint64(stride)]
        number += np.uint64(count)
    return number


@kernel(share=lambda picture, centres, sides, room, inverse, stride, bins, chunks, *_: chunks)
def _fold(begin, end, picture, centres, sides, room, inverse, stride, bins, chunks, sums):
    """Sum pixels, their squares and their number in the bins of the cell, for chunks of lenses."""
    lenses = centres.shape[0]
    one = np.float32(1)
    for chunk in range(begin, end):
        cells = sums[chunk]
        place = np.empty(room, np.uint32)
        values = np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx = centres[lens, 0]
            cy = centres[lens, 1]
            number = _gather_pixels(
                picture, cx, cy, lens, sides, inverse, stride, bins, place, values
            )
            for k in range(number):
                value = values[k]
                n = np.uint64(place[k])
                # Four values read and written together are one vector instruction.
                a = cells[n, 0]
                b = cells[n, 1]
                c = cells[n, 2]
                d = cells[n, 3]
                a = a + value
                b = b + value * value
                c = c + one
                d = d + one
                cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3] = a, b, c, d


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_for_contrast(values, level, weight, number):
    """Sums for the contrast and the offset of a lens."""
    zero = np.float32(0)
    one = sum_level = square = value = product = zero
    for k in range(number):
        w = weight[k]
        wl = w * level[k]
        one += w
        sum_level += wl
        square += wl * level[k]
        value += w * values[k]
        product += wl * values[k]
    return one, sum_level, square, value, product


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_for_shift(values, level, weight, slope_x, slope_y, number, contrast, offset, cutoff):
    """Sums for the shift of a lens, with robust weights."""
    one = np.float32(1)
    zero = np.float32(0)
    xx = xy = yy = bx = by = squares = weights = zero
    for k in range(number):
        w = weight[k]
        residual = values[k] - offset - contrast * level[k]
        near = max(one - residual * residual * w * cutoff, zero)
        near *= near
        weights += near
        w *= near
        squares += w * residual * residual
        wx = w * slope_x[k]
        wy = w * slope_y[k]
        xx += wx * slope_x[k]
        xy += wx * slope_y[k]
        yy += wy * slope_y[k]
        bx -= wx * residual
        by -= wy * residual
    return xx, xy, yy, bx, by, squares, weights


@kernel(share=lambda picture, centres, sides, room, inverse, stride, bins, chunks, *_: chunks)
def _accumulate(
    begin,
    end,
    picture,
    centres,
    sides,
    room,
    inverse,
    stride,
    bins,
    chunks,
    maps,
    cutoff,
    most,
    normal,
    right,
    noise,
):
    lenses = centres.shape[0]
    for chunk in range(begin, end):
        place = np.empty(room, np.uint32)
        values = np.empty(room, np.float32)
        level = np.empty(room, np.float32)
        weight = np.empty(room, np.float32)
        slope_x = np.empty(room, np.float32)
        slope_y = np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx = centres[lens, 0]
            cy = centres[lens, 1]
            number = _gather_pixels(
                picture, cx, cy, lens, sides, inverse, stride, bins, place, values
            )
            for k in range(number):
                at = np.uint64(place[k])
                level[k], weight[k] = maps[at, 0], maps[at, 1]
                slope_x[k], slope_y[k] = maps[at, 2], maps[at, 3]
            one, mean, square, value, product = _sum_for_contrast(values, level, weight, number)
            contrast = np.float32(1)
            offset = np.float32(0)
            determinant = one * square - mean * mean
            if determinant > 1e-9 * one * square:
                contrast = np.float32(
                    min(max((one * product - mean * value) / determinant, 0.0), most)
                )
                offset = np.float32((value - contrast * mean) / one)
            xx, xy, yy, bx, by, squares, weights = _sum_for_shift(
                values, level, weight, slope_x, slope_y, number, contrast, offset, cutoff
            )
            normal[lens, 0, 0] = contrast * contrast * xx
            normal[lens, 0, 1] = contrast * contrast * xy
            normal[lens, 1, 0] = contrast * contrast * xy
            normal[lens, 1, 1] = contrast * contrast * yy
            right[lens, 0] = contrast * bx
            right[lens, 1] = contrast * by
            noise[lens] = squares / max(weights, 1e-9)


class _Grid(NamedTuple):
    """What both kernels need to know of the cells of a lattice."""

    sides: Floats  # (7, 2) `Cell.row_bounds`
    room: int  # for the pixels of a cell, and for whole vectors beyond them
    inverse: Floats  # (2, 2) [1/px] of the basis
    stride: int
    bins: int  # of the mean microimage, each way

    @classmethod
    def of(cls, lattice: Lattice, cell: Cell, stride: int, bins: int) -> _Grid:
        room = (int(2 * cell.circumradius) // stride + 3) ** 2 + 2 * VECTOR_LENGTH
        inverse: Array = np.linalg.inv(lattice.basis)
        return cls(cell.row_bounds(), room, inverse, stride, bins)


def average_cells(
    picture: Singles, lattice: Lattice, centres: Floats, cell: Cell, bins: int, stride: int = 1
) -> Singles:
    """Mean microimage (bins * bins, 4) over some of the lenses at `centres` (n, 2) [px].

    Level, inverse variance of a pixel, slopes of the level in x and y [1/px]. The centre of the
    lens is bin 0; columns run along `a1`, rows along `a2`, periodic. It is made symmetric by adding
    the same turned by half a turn.
    """
    grid = _Grid.of(lattice, cell, stride, bins)
    few = np.ascontiguousarray(centres[:: max(1, len(centres) // 1500)])
    sums = np.zeros((_CHUNKS, bins * bins, 4), np.float32)
    _fold(picture, few, *grid, _CHUNKS, sums)
    planes = sums.sum(0, dtype=np.float64).T[:3].reshape(3, bins, bins)
    blur = 0.5 * bins / lattice.pitch
    total, square, count = (
        _blur(plane + np.roll(plane[::-1, ::-1], (1, 1), axis=(0, 1)), blur) for plane in planes
    )
    count = np.maximum(count, 1e-9)
    level = total / count
    variance = np.maximum(square / count - level**2, 1e-4 * float(np.var(level)) + 1e-12)
    along = [(np.roll(level, -1, axis) - np.roll(level, 1, axis)) * (bins / 2) for axis in (1, 0)]
    slope = np.stack(along, axis=-1) @ grid.inverse.T
    return np.dstack([level, 1 / variance, slope]).astype(np.float32).reshape(bins * bins, -1)


def build_lens_equations(
    picture: Singles, lattice: Lattice, centres: Floats, cell: Cell, mean: Singles, stride: int = 1
) -> tuple[Floats, Floats, Floats]:
    """Least squares of the shifts of lenses at `centres` (n, 2) [px], over the pixels of their
    whole cells.

    Normal matrices (n, 2, 2), right sides (n, 2), and variance (n,) of a pixel about the `mean`
    microimage, over that of all lenses. Each lens has its own contrast and offset: blank or dark
    ones carry no information. Of large microimages every `stride`-th pixel each way is enough, as
    neighbouring ones are alike.
    """
    grid = _Grid.of(lattice, cell, stride, round(np.sqrt(len(mean))))
    normal = np.zeros((len(centres), 2, 2))
    right = np.zeros((len(centres), 2))
    noise = np.zeros(len(centres))
    cutoff = np.float32(1 / TUKEY_CUTOFF**2)
    _accumulate(
        picture, centres, *grid, _CHUNKS, mean, cutoff, _MOST_CONTRAST, normal, right, noise
    )
    return normal, right, noise


def _blur(values: Floats, width: float) -> Floats:
    """A periodic square picture blurred by a Gaussian of standard deviation `width` [samples]."""
    count = len(values)
    passed = np.exp(-2 * (np.pi * width * np.fft.fftfreq(count)) ** 2)
    place = np.arange(count)
    # A product with so small a matrix takes a tenth of the time of Fourier transforms.
    blur = np.fft.ifft(passed).real[place[:, None] - place]
    return np.asarray(blur @ values @ blur.T)
