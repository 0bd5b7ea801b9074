"""Places of pixels in the cell of a lattice, for sums over all cells of a flat."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["VECTOR_LENGTH", "compute_cell_bins"]

#: Pixels of a row handled by one vector loop of fixed length: rows of microimages are too short for
#: others.
VECTOR_LENGTH = 16


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
