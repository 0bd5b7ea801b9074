"""Places of pixels in the cell of a lattice, for sums over all cells of a flat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ..lattice.cell import Cell, row_interval
from ..lattice.lattice import Lattice
from ..runtime.arrays import Array, Floats

__all__ = ["CHUNKS", "VECTOR_LENGTH", "CellGrid", "compute_cell_bins", "gather_pixels"]

#: Pixels of a row handled by one vector loop of fixed length: rows of microimages are too short for
#: others.
VECTOR_LENGTH = 16
#: Parts of the lenses that are summed in parallel: a fixed number, so that sums do not depend on
#: that of the threads.
CHUNKS = 16


@njit(error_model="numpy", forceinline=True)
def compute_cell_bins(u, v, step_u, step_v, bins, begin, count, out):
    """Set `out` from `begin` on to the bins, row by row, of `count` pixels of a line from lattice
    coordinates (u, v).

    Bins are set in whole runs of `VECTOR_LENGTH`: `out` needs room for as many more.
    """
    # A cell is 2**32 units each way, so that unsigned places in it wrap around by themselves.
    whole = 4294967296.0
    half = np.uint32(16)
    many = np.uint32(bins)
    across = np.uint32(np.int64(step_u * whole))
    down = np.uint32(np.int64(step_v * whole))
    first = np.uint32(np.int64(u * whole))
    upper = np.uint32(np.int64(v * whole))
    for start in range(np.uint32(0), np.uint32(count), np.uint32(VECTOR_LENGTH)):
        begun = np.uint64(begin) + np.uint64(start)
        for lane in range(VECTOR_LENGTH):
            k = np.uint32(start + np.uint32(lane))
            a = np.uint32(first + np.uint32(across * k))
            b = np.uint32(upper + np.uint32(down * k))
            column = np.uint32(np.uint32(a >> half) * many) >> half
            row = np.uint32(np.uint32(b >> half) * many) >> half
            out[begun + np.uint64(lane)] = np.uint32(row * many) + column


@njit(error_model="numpy", forceinline=True)
def gather_pixels(picture, cx, cy, lens, sides, inverse, stride, bins, place, values):
    """Write bins and values of the pixels of a cell; return their number.

    Some more may be overwritten.
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


class CellGrid(NamedTuple):
    """The cells of a lattice, as kernels over their pixels take them."""

    sides: Floats  # (7, 2) `Cell.row_bounds`
    room: int  # for the pixels of a cell, and for whole vectors beyond them
    inverse: Floats  # (2, 2) [1/px] of the basis
    stride: int
    bins: int  # of the mean microimage, each way

    @classmethod
    def of(cls, lattice: Lattice, cell: Cell, stride: int, bins: int) -> CellGrid:
        room = (int(2 * cell.circumradius) // stride + 3) ** 2 + 2 * VECTOR_LENGTH
        inverse: Array = np.linalg.inv(lattice.basis)
        return cls(cell.row_bounds(), room, inverse, stride, bins)
