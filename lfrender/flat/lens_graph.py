"""Who is next to whom: lens rows by lattice index and the neighbours of every lens."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from ..runtime.cache import remembered

__all__ = [
    "alike", "around", "beside", "both_ways", "grown", "lens_grid", "lens_halves", "nearest_of", "neighbour_rows",
    "rows_among",
]  # fmt: skip

# Lattices with no more lenses than this keep what tells who is beside whom.
_MOST_KEPT = 1 << 18


def lens_grid(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Row of each lens by its lattice index.

    Returns
    -------
    grid : (nj, ni) int32
        Row in `lattice.centres()` of lens `(i, j)` at `grid[j - low[1], i - low[0]]`, -1 where there is none.
    low : (2,) int64
        Smallest `i` and `j`. Shared by all who ask: nobody may write into either.
    """
    return (
        remembered(lattice, "grid", lambda: _lens_grid(lattice)) if len(lattice) <= _MOST_KEPT else _lens_grid(lattice)
    )


def _lens_grid(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    ij = lattice.indices()
    low = ij.min(0)
    size = ij.max(0) - low + 1
    grid = np.full((size[1], size[0]), -1, np.int32)
    grid[ij[:, 1] - low[1], ij[:, 0] - low[0]] = np.arange(len(ij), dtype=np.int32)
    return grid, low


def neighbour_rows(lattice: Lattice, steps: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n, k) rows of the lenses `steps` (k, 2) index steps away from each lens, -1 where there is none.

    Shared by all who ask: nobody may write into them.
    """
    if len(lattice) <= _MOST_KEPT:
        key = ("neighbours", steps.tobytes())
        return remembered(lattice, key, lambda: _neighbour_rows(lattice, steps))
    return _neighbour_rows(lattice, steps)


def _neighbour_rows(lattice: Lattice, steps: NDArray[np.int64]) -> NDArray[np.int32]:
    grid, low = lens_grid(lattice)
    ij = lattice.indices() - low
    # A border of -1 as wide as the longest step makes every look-up a valid one.
    border = int(np.abs(steps).max(initial=0))
    grid = np.pad(grid, border, constant_values=-1)
    width = grid.shape[1]
    here = ((ij[:, 1] + border) * width + ij[:, 0] + border).astype(np.int64)
    return grid.ravel()[here[:, None] + (steps[:, 1] * width + steps[:, 0])]


def lens_halves(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Neighbour rows in every lattice direction, and in the opposite ones; shared, as `neighbour_rows`."""
    return remembered(lattice, "halves", lambda: _halves(lattice)) if len(lattice) <= _MOST_KEPT else _halves(lattice)


def _halves(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    neighbours = neighbour_rows(lattice, lattice.steps)
    half = neighbours.shape[1] // 2
    return np.ascontiguousarray(neighbours[:, :half]), np.ascontiguousarray(neighbours[:, half:])


def both_ways(forward: NDArray[np.int32], backward: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, 2 d) neighbour rows in all directions, of those in `d` of them and in the opposite ones; shared."""
    first, both = remembered(forward, "both ways", lambda: (backward, np.hstack([forward, backward])))
    return both if first is backward else np.hstack([forward, backward])


@njit(cache=True, nogil=True, parallel=True)
def _count_beside(mask, rows, own, out):
    for lens in prange(len(rows)):
        count = 0
        if mask[lens] or not own:
            for k in range(rows.shape[1]):
                other = rows[lens, k]
                if other >= 0 and mask[other]:
                    count += 1
        out[lens] = count


@njit(cache=True, nogil=True, parallel=True)
def _count_like(mask, sizes, rows, gap, out):
    for lens in prange(len(rows)):
        count = 0
        for k in range(rows.shape[1]):
            other = rows[lens, k]
            if other >= 0 and mask[other] and abs(sizes[other] - sizes[lens]) <= gap:
                count += 1
        out[lens] = count


def beside(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens of `mask` (n,) are of it too; 0 for the other lenses."""
    count = np.empty(len(rows), np.int64)
    _count_beside(mask, rows, True, count)
    return count


def around(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens are of `mask` (n,)."""
    count = np.empty(len(rows), np.int64)
    _count_beside(mask, rows, False, count)
    return count


def alike(mask: NDArray[np.bool_], sizes: NDArray, rows: NDArray[np.int32], gap: float) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens are of `mask` (n,) and have its patch size (n,), within `gap`."""
    count = np.empty(len(rows), np.int64)
    _count_like(mask, sizes, rows, sizes.dtype.type(gap), count)
    return count


def grown(mask: NDArray[np.bool_], neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: `mask` and all lenses beside it, by neighbour rows (n, k)."""
    return mask | (around(mask, neighbours) > 0)


def rows_among(rows: NDArray[np.int64], neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """(m, k) neighbour rows of some lenses, by their `rows` (m,), counted among these; -1 for all others."""
    # The last place is that of no lens.
    place = np.full(len(neighbours) + 1, -1, np.int32)
    place[rows] = np.arange(len(rows), dtype=np.int32)
    return place[neighbours[rows]]


def nearest_of(lattice: Lattice, chosen: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(n,) row of the lens nearest to each, in steps on the lattice, of those that are `chosen` (n,), at least one."""
    from scipy.ndimage import distance_transform_edt

    grid, low = lens_grid(lattice)
    away = np.ones(grid.shape, bool)
    i, j = (lattice.indices() - low).T
    away[j, i] = ~chosen
    v, u = distance_transform_edt(away, return_distances=False, return_indices=True)[:, j, i]
    return grid[v, u]
