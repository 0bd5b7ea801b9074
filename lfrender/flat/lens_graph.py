"""Lenses by their place: counts of neighbours, and the lens nearest to a place, on a lattice that
may be bent.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST

__all__ = [
    "count_connected",
    "count_neighbours",
    "count_similar",
    "dilate_mask",
    "displacement_at",
    "lens_displacements",
    "lens_offsets",
    "nearest_first",
    "nearest_index",
    "nearest_lens",
]


def count_connected(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) number of neighbours, by `rows` (n, k), in `mask` (n,) of each lens in it; 0 for the
    other lenses.
    """
    return count_neighbours(mask, rows) * mask


def count_neighbours(mask: NDArray[np.bool_], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) number of neighbours, by `rows` (n, k), of each lens that are in `mask` (n,)."""
    # Where there is no neighbour, -1 is the row of the last value.
    return np.asarray(np.append(mask, False).take(rows.T).sum(0))


def count_similar(
    mask: NDArray[np.bool_], sizes: NDArray, rows: NDArray[np.int32], gap: float
) -> NDArray[np.int64]:
    """(n,) number of neighbours in `mask` (n,) whose patch size (n,) differs by at most `gap`."""
    similar = np.abs(sizes.take(rows.T) - sizes) <= gap
    return np.asarray((np.append(mask, False).take(rows.T) & similar).sum(0))


def dilate_mask(mask: NDArray[np.bool_], neighbours: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: `mask` and all lenses with a neighbour, by rows (n, k), in it."""
    return np.asarray(mask | np.append(mask, False).take(neighbours.T).any(0))


def nearest_lens(centres: NDArray[np.floating], points: ArrayLike) -> NDArray[np.int64]:
    """Row of the centre (n, 2) [px] that is nearest to each of the `points` (m, 2) [px]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(centres).query(points)[1], np.int64)


def lens_offsets(lattice: Lattice, reach: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """All lenses about one within `reach` and a pitch, the nearest first; of distorted lattices,
    some 500 tell.

    Returns offsets (k, 3) float32 [px]: `x, y` on the straight lattice, and the least distance on
    the flat; and the steps (k, 2) int32 in lattice indices.
    """
    limit = reach + lattice.pitch
    span = (
        np.arange(-1, 2)
        if limit <= 0
        else np.arange(-_span(lattice, limit), _span(lattice, limit) + 1)
    )
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    offsets = steps @ lattice.basis
    distance = np.linalg.norm(offsets, axis=1)
    if lattice.distortion is not None:
        ij = lattice.indices()
        some = ij[:: max(1, len(ij) // 500)]
        here = lattice.points(some)
        distance = np.array(
            [np.linalg.norm(lattice.points(some + step) - here, axis=1).min() for step in steps]
        )
    order = nearest_first(distance, lattice.pitch)
    order = order[distance[order] <= limit]
    return np.column_stack([offsets, distance])[order].astype(np.float32), steps[order].astype(
        np.int32
    )


def nearest_first(distance: NDArray[np.float64], pitch: float) -> NDArray[np.intp]:
    """Order of lenses by their distance [px], equal ones in the order given.

    In regular lattices many distances are equal. Rounding errors do not change their order, on
    which sums and choices between equal depths depend.
    """
    return np.argsort(np.rint(distance * (_FINEST / pitch)), kind="stable")


def _span(lattice: Lattice, limit: float) -> int:
    """Largest lattice index of a point within `limit` of the origin."""
    return int(np.ceil(limit * np.linalg.norm(np.linalg.inv(lattice.basis), axis=0).max()))


# Distances are equal within a pitch over this number.
_FINEST = 1e6
# [lattice steps] beyond the flat that are tabulated: the most that kernels ask for.
_MARGIN = 6
# Turns of the fixed-point iteration: enough for distortions that change the pitch by a tenth. A
# constant of its own: as a field of a tuple it changes how the compiler rounds in the kernels of
# rendering.
_TURNS = 6


def lens_displacements(lattice: Lattice) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Displacement (nj, ni, 2) [px] of lens `(i, j)` by the distortion, at `[j - low[1], i -
    low[0]]`, and `low`; (0, 0, 2) if the lattice is straight.
    """
    if lattice.distortion is None:
        return np.zeros((0, 0, 2), np.float32), np.zeros(2, np.int64)
    ij = lattice.indices()
    low = ij.min(0) - _MARGIN
    high = ij.max(0) + _MARGIN
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
    """Index i, j (whole floats) of the lens whose lattice cell holds a flat position, by
    fixed-point iteration.

    `inverse` is that of the basis. Each turn gains a factor of the gradient of the distortion.
    """
    ox = x - origin[0]
    oy = y - origin[1]
    i = np.rint(ox * inverse[0, 0] + oy * inverse[1, 0])
    j = np.rint(ox * inverse[0, 1] + oy * inverse[1, 1])
    if displacement.size > 0:
        for _ in range(_TURNS):
            bx, by = displacement_at(displacement, low, i, j)
            new_i = np.rint((ox - bx) * inverse[0, 0] + (oy - by) * inverse[1, 0])
            new_j = np.rint((ox - bx) * inverse[0, 1] + (oy - by) * inverse[1, 1])
            if new_i == i and new_j == j:
                break
            i = new_i
            j = new_j
    return i, j
