"""Lenses of a distorted lattice, for kernels that look them up by place: how far each lies from the straight one."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST

__all__ = ["displacement_at", "lens_displacements", "nearest_index"]

# Index steps beyond the flat that kernels may ask for.
_MARGIN = 6
# Each turn of the search for the nearest lens gains a factor of the gradient of the distortion.
_TURNS = 6


def lens_displacements(lattice: Lattice) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Displacement of every lens by the distortion of the lattice.

    Returns
    -------
    bend : (nj, ni, 2) float32 [px]
        Of lens `(i, j)`, also beyond the flat, at `bend[j - low[1], i - low[0]]`; (0, 0, 2) for a straight lattice.
    low : (2,) int64
        Smallest `i` and `j`.
    """
    if lattice.distortion is None:
        return np.zeros((0, 0, 2), np.float32), np.zeros(2, np.int64)
    ij = lattice.indices()
    low, high = ij.min(0) - _MARGIN, ij.max(0) + _MARGIN
    i, j = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    index = np.stack([i, j], -1).reshape(-1, 2)
    bend = lattice.points(index) - (lattice.origin + index @ lattice.basis)
    return bend.reshape(*i.shape, 2).astype(np.float32), low


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def displacement_at(bend, low, i, j):
    """Displacement x, y of lens (i, j)."""
    row = min(max(int(j) - low[1], 0), bend.shape[0] - 1)
    column = min(max(int(i) - low[0], 0), bend.shape[1] - 1)
    return bend[row, column, 0], bend[row, column, 1]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def nearest_index(x, y, origin, inverse, bend, low):
    """Index i, j (whole floats) of the lens at whose place on the straight lattice a flat position comes to lie."""
    ox, oy = x - origin[0], y - origin[1]
    i = np.rint(ox * inverse[0, 0] + oy * inverse[1, 0])
    j = np.rint(ox * inverse[0, 1] + oy * inverse[1, 1])
    if bend.size > 0:
        for _ in range(_TURNS):
            bx, by = displacement_at(bend, low, i, j)
            new_i = np.rint((ox - bx) * inverse[0, 0] + (oy - by) * inverse[1, 0])
            new_j = np.rint((ox - bx) * inverse[0, 1] + (oy - by) * inverse[1, 1])
            if new_i == i and new_j == j:
                break
            i, j = new_i, new_j
    return i, j
