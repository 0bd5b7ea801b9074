"""Nearest lens to a place on a flat whose lattice may be distorted, for kernels: from a table of lens displacements."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST

__all__ = ["displacement_at", "lens_displacements", "nearest_index"]

# [lattice steps] beyond the flat that are tabulated: the most that kernels ask for.
_MARGIN = 6
# Turns of the fixed-point iteration: enough for distortions that change the pitch by a tenth. A constant of its own: as
# a field of a tuple it changes how the compiler rounds in the kernels of rendering.
_TURNS = 6


def lens_displacements(lattice: Lattice) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Displacement (nj, ni, 2) [px] of lens `(i, j)` by the distortion, at `[j - low[1], i - low[0]]`, and `low`; (0,
    0, 2) if the lattice is straight."""
    if lattice.distortion is None:
        return np.zeros((0, 0, 2), np.float32), np.zeros(2, np.int64)
    ij = lattice.indices()
    low, high = ij.min(0) - _MARGIN, ij.max(0) + _MARGIN
    i, j = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    index = np.stack([i, j], -1).reshape(-1, 2)
    displacement = lattice.points(index) - (lattice.origin + index @ lattice.basis)
    return displacement.reshape(*i.shape, 2).astype(np.float32), low


@njit(fastmath=FAST, inline="always")
def displacement_at(displacement, low, i, j):
    """Displacement x, y of lens (i, j), or of the nearest lens in the table."""
    row = min(max(int(j) - low[1], 0), displacement.shape[0] - 1)
    column = min(max(int(i) - low[0], 0), displacement.shape[1] - 1)
    return displacement[row, column, 0], displacement[row, column, 1]


@njit(fastmath=FAST, inline="always")
def nearest_index(x, y, origin, inverse, displacement, low):
    """Index i, j (whole floats) of the lens whose lattice cell holds a flat position, by fixed-point iteration.

    `inverse` is that of the basis. Each turn gains a factor of the gradient of the distortion.
    """
    ox, oy = x - origin[0], y - origin[1]
    i = np.rint(ox * inverse[0, 0] + oy * inverse[1, 0])
    j = np.rint(ox * inverse[0, 1] + oy * inverse[1, 1])
    if displacement.size > 0:
        for _ in range(_TURNS):
            bx, by = displacement_at(displacement, low, i, j)
            new_i = np.rint((ox - bx) * inverse[0, 0] + (oy - by) * inverse[1, 0])
            new_j = np.rint((ox - bx) * inverse[0, 1] + (oy - by) * inverse[1, 1])
            if new_i == i and new_j == j:
                break
            i, j = new_i, new_j
    return i, j
