"""Which points of the scene are settled anew after an earlier frame: those of lenses with another answer."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from ...flat.distorted_lookup import nearest_index

__all__ = ["mark_changed_points"]

# Scene points of a lens are sought in a box so many times as large as a cell of the lattice.
_CELL = 1.2


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_place(i, j, centre_x, centre_y, half_x, half_y, origin, inverse, bend, bend_low, first, spacing, out):
    """Set `out` at the scene points that belong to the place (i, j) of the lattice, which reaches so far from there."""
    rows, columns = out.shape
    top, bottom = int(np.ceil((centre_y - half_y - first) / spacing)), int((centre_y + half_y - first) / spacing)
    left, right = int(np.ceil((centre_x - half_x - first) / spacing)), int((centre_x + half_x - first) / spacing)
    for v in range(max(top, 0), min(bottom, rows - 1) + 1):
        for u in range(max(left, 0), min(right, columns - 1) + 1):
            at_i, at_j = nearest_index(first + u * spacing, first + v * spacing, origin, inverse, bend, bend_low)
            if at_i == i and at_j == j:
                out[v, u] = True


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def mark_changed_points(
    settled, centres, indices, around, ring, origin, basis, inverse, bend, bend_low, first, spacing, out
):
    """Set `out` (rows, columns) to the scene points of lenses that are not `settled` (n,), and to those beyond the last
    lenses that have such a lens about them.

    `around` (n, k) are the rows of the lenses of `ring` about each.
    """
    for v in prange(len(out)):
        out[v] = False
    # A place of the lattice is as wide as one of its cells, and a little wider where it is bent.
    half_x = 0.5 * (abs(basis[0, 0]) + abs(basis[1, 0])) * _CELL
    half_y = 0.5 * (abs(basis[0, 1]) + abs(basis[1, 1])) * _CELL
    for lens in prange(len(settled)):
        if settled[lens]:
            continue
        i, j, x, y = indices[lens, 0], indices[lens, 1], centres[lens, 0], centres[lens, 1]
        _mark_place(i, j, x, y, half_x, half_y, origin, inverse, bend, bend_low, first, spacing, out)
        for r in range(len(ring)):
            if around[lens, r] < 0:
                away_i, away_j = ring[r, 0], ring[r, 1]
                _mark_place(
                    i + away_i, j + away_j, x + away_i * basis[0, 0] + away_j * basis[1, 0],
                    y + away_i * basis[0, 1] + away_j * basis[1, 1], half_x, half_y, origin, inverse, bend, bend_low,
                    first, spacing, out,
                )  # fmt: skip
