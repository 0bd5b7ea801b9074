"""Which scene points of a surface to compute anew after some lenses have changed: those nearest to these lenses."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import kernel

from .scene_grid import SceneGrid, nearest_lens

__all__ = ["mark_changed_points"]

# Points of a lens are searched in a box this much larger than a cell of the lattice: cells of a distorted one are bent.
_CELL = 1.2


@njit(error_model="numpy")
def _mark_cell(grid, i, j, centre_x, centre_y, half_x, half_y, out):
    """Set `out` at the scene points nearest to lens (i, j), within a box about its centre."""
    rows, columns = out.shape
    first, spacing = grid.first, grid.spacing
    top, bottom = int(np.ceil((centre_y - half_y - first) / spacing)), int((centre_y + half_y - first) / spacing)
    left, right = int(np.ceil((centre_x - half_x - first) / spacing)), int((centre_x + half_x - first) / spacing)
    for v in range(max(top, 0), min(bottom, rows - 1) + 1):
        for u in range(max(left, 0), min(right, columns - 1) + 1):
            at_i, at_j = nearest_lens(grid, u, v)
            if at_i == i and at_j == j:
                out[v, u] = True


def mark_changed_points(
    unchanged: NDArray[np.bool_],
    centres: NDArray[np.floating],
    indices: NDArray[np.integer],
    around: NDArray[np.integer],
    ring: NDArray[np.integer],
    grid: SceneGrid,
    out: NDArray[np.bool_],
) -> None:
    """Set `out` (rows, columns) to the scene points of lenses that are not `unchanged` (n,), and to those beyond the
    border of the lattice that have such a lens about them.

    `around` (n, k) are the rows of the lenses of `ring` about each.
    """
    out.fill(False)
    _mark_cells(unchanged, centres, indices, around, ring, grid, out)


@kernel(error_model="numpy", share=lambda unchanged, *_: len(unchanged))
def _mark_cells(begin, end, unchanged, centres, indices, around, ring, grid: SceneGrid, out):
    basis = grid.basis
    half_x = 0.5 * (abs(basis[0, 0]) + abs(basis[1, 0])) * _CELL
    half_y = 0.5 * (abs(basis[0, 1]) + abs(basis[1, 1])) * _CELL
    for lens in range(begin, end):
        if unchanged[lens]:
            continue
        i, j, x, y = indices[lens, 0], indices[lens, 1], centres[lens, 0], centres[lens, 1]
        _mark_cell(grid, i, j, x, y, half_x, half_y, out)
        for r in range(len(ring)):
            if around[lens, r] < 0:
                away_i, away_j = ring[r, 0], ring[r, 1]
                centre_x = x + away_i * basis[0, 0] + away_j * basis[1, 0]
                centre_y = y + away_i * basis[0, 1] + away_j * basis[1, 1]
                _mark_cell(grid, i + away_i, j + away_j, centre_x, centre_y, half_x, half_y, out)
