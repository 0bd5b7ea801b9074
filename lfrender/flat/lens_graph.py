"""Who is next to whom: lens rows by lattice index and the neighbours of every lens."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice

from ..runtime.cache import cached

__all__ = [
    "count_connected",
    "count_neighbours",
    "count_similar",
    "dilate_mask",
    "distant_rings",
    "join_opposite",
    "lens_grid",
    "nearest_chosen",
    "nearest_lens",
    "neighbour_rows",
    "opposite_neighbours",
    "restrict_neighbours",
    "two_rings",
]  # fmt: skip

# Lattices with no more lenses than this keep what tells who is beside whom.
_MOST_KEPT = 1 << 18
# Two rings hold so many times the lenses of the first: of a lattice, the second has twice as many.
_BOTH_RINGS = 3
# Rings afar are so many steps apart: what lenses tell with two rings about them, others there hardly tell again.
_STEPS = 3


def lens_grid(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Row of each lens by its lattice index.

    Returns
    -------
    grid : (nj, ni) int32
        Row in `lattice.centres()` of lens `(i, j)` at `grid[j - low[1], i - low[0]]`, -1 where there is none.
    low : (2,) int64
        Smallest `i` and `j`. Shared by all who ask: nobody may write into either.
    """
    return cached(lattice, "grid", lambda: _lens_grid(lattice)) if len(lattice) <= _MOST_KEPT else _lens_grid(lattice)


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
        return cached(lattice, key, lambda: _neighbour_rows(lattice, steps))
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


def opposite_neighbours(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Neighbour rows in every lattice direction, and in the opposite ones; shared, as `neighbour_rows`."""
    return cached(lattice, "halves", lambda: _halves(lattice)) if len(lattice) <= _MOST_KEPT else _halves(lattice)


def _halves(lattice: Lattice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    neighbours = neighbour_rows(lattice, lattice.steps)
    half = neighbours.shape[1] // 2
    return np.ascontiguousarray(neighbours[:, :half]), np.ascontiguousarray(neighbours[:, half:])


def join_opposite(forward: NDArray[np.int32], backward: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, 2 d) neighbour rows in all directions, of those in `d` of them and in the opposite ones; shared."""
    first, both = cached(forward, "both ways", lambda: (backward, np.hstack([forward, backward])))
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


def count_connected(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens of `mask` (n,) are of it too; 0 for the other lenses."""
    count = np.empty(len(rows), np.int64)
    _count_beside(mask, rows, True, count)
    return count


def count_neighbours(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens are of `mask` (n,)."""
    count = np.empty(len(rows), np.int64)
    _count_beside(mask, rows, False, count)
    return count


def count_similar(mask: NDArray[np.bool_], sizes: NDArray, rows: NDArray[np.int32], gap: float) -> NDArray[np.int64]:
    """(n,) how many neighbours (n, k) of each lens are of `mask` (n,) and have its patch size (n,), within `gap`."""
    count = np.empty(len(rows), np.int64)
    _count_like(mask, sizes, rows, sizes.dtype.type(gap), count)
    return count


def dilate_mask(mask: NDArray[np.bool_], neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: `mask` and all lenses beside it, by neighbour rows (n, k)."""
    return mask | (count_neighbours(mask, neighbours) > 0)


def restrict_neighbours(rows: NDArray[np.int64], neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """(m, k) neighbour rows of some lenses, by their `rows` (m,), counted among these; -1 for all others."""
    # The last place is that of no lens.
    place = np.full(len(neighbours) + 1, -1, np.int32)
    place[rows] = np.arange(len(rows), dtype=np.int32)
    return place[neighbours[rows]]


def nearest_chosen(lattice: Lattice, chosen: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(n,) row of the lens nearest to each, in steps on the lattice, of those that are `chosen` (n,), at least one."""
    from scipy.ndimage import distance_transform_edt

    grid, low = lens_grid(lattice)
    away = np.ones(grid.shape, bool)
    i, j = (lattice.indices() - low).T
    away[j, i] = ~chosen
    v, u = distance_transform_edt(away, return_distances=False, return_indices=True)[:, j, i]
    return grid[v, u]


@njit(cache=True, nogil=True)
def _find_one(neighbours, lens, ways, out):
    """Put the neighbours of a lens and their neighbours in `out`, each once, then -1, and the `ways` there, by which
    neighbour of which neighbour, in the first two columns; returns how many there are."""
    count = 0
    for k in range(neighbours.shape[1]):
        near = neighbours[lens, k]
        if near >= 0:
            out[count] = near
            count += 1
    for k in range(neighbours.shape[1]):
        near = neighbours[lens, k]
        if near < 0:
            continue
        for m in range(neighbours.shape[1]):
            other = neighbours[near, m]
            new = other >= 0 and other != lens
            for seen in range(count):
                new &= out[seen] != other
            if new and count < len(out):
                out[count], ways[count, 0], ways[count, 1] = other, k, m
                count += 1
    out[count:] = -1
    return count


@njit(cache=True, nogil=True, parallel=True)
def _find_around(neighbours, out):
    """As `_find_one` for each lens. On a lattice the ways are the same for all lenses that have all their neighbours;
    others that they do not lead to are left out."""
    most, near = out.shape[1], neighbours.shape[1]
    ways, known = np.empty((most, 2), np.int64), False
    for lens in range(len(out)):
        if (neighbours[lens] >= 0).all() and _find_one(neighbours, lens, ways, out[lens]) == most:
            known = True
            break
    for lens in prange(len(out)):
        whole = known
        for k in range(near):
            whole &= neighbours[lens, k] >= 0
        if not whole:
            _find_one(neighbours, lens, np.empty((most, 2), np.int64), out[lens])
            continue
        out[lens, :near] = neighbours[lens]
        count = near
        for n in range(near, most):
            other = neighbours[neighbours[lens, ways[n, 0]], ways[n, 1]]
            if other >= 0:
                out[lens, count] = other
                count += 1
        out[lens, count:] = -1


@njit(cache=True, nogil=True, parallel=True)
def _go_on(neighbours, steps, out):
    """The lenses so many steps from each in the directions of its neighbours, -1 where the way there is broken."""
    for lens in prange(len(out)):
        for k in range(neighbours.shape[1]):
            at = np.int32(lens)
            for _ in range(steps):
                at = neighbours[at, k] if at >= 0 else at
            out[lens, k] = at


def two_rings(neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, 3 k) int32 rows of the lenses in two rings about each, -1 where there is none."""

    def find() -> NDArray[np.int32]:
        out = np.empty((len(neighbours), _BOTH_RINGS * neighbours.shape[1]), np.int32)
        _find_around(neighbours, out)
        return out

    return cached(neighbours, "two rings", find)


def distant_rings(neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """As `two_rings`, of rings three steps apart: the lenses three and six steps off."""

    def find() -> NDArray[np.int32]:
        far = np.empty_like(neighbours)
        _go_on(neighbours, _STEPS, far)
        return two_rings(far)

    return cached(neighbours, "two rings afar", find)


def nearest_lens(lattice: Lattice, points: ArrayLike) -> NDArray[np.int64]:
    """Row in `lattice.centres()` of the centre nearest to each of the `points` (n, 2) [px]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(lattice.centres()).query(np.asarray(points, dtype=float))[1], dtype=np.int64)
