"""Shifts of single microimages against the mean microimage of a flat (`mean_cell`)."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..runtime.arrays import Floats, Singles
from ..runtime.kernels import FAST, kernel
from .cell_bins import CHUNKS, CellGrid, gather_pixels

__all__ = ["build_lens_equations"]

# Most contrast of a lens over that of the mean microimage.
_MOST_CONTRAST = 2.0


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
            number = gather_pixels(
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
    grid = CellGrid.of(lattice, cell, stride, round(np.sqrt(len(mean))))
    normal = np.zeros((len(centres), 2, 2))
    right = np.zeros((len(centres), 2))
    noise = np.zeros(len(centres))
    cutoff = np.float32(1 / TUKEY_CUTOFF**2)
    _accumulate(picture, centres, *grid, CHUNKS, mean, cutoff, _MOST_CONTRAST, normal, right, noise)
    return normal, right, noise
