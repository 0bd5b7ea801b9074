"""Voronoi cells of a lattice: the pixels nearer to the centre of a lens than to any other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = [
    "Cell", "bin_offsets", "cell_circumradius", "cell_distances", "cell_normals", "cell_row_bounds", "clip_rows",
    "is_outside_cell", "nearest_offsets", "row_interval",
]  # fmt: skip

_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


class Cell(NamedTuple):
    """Cell of a lens, for kernels: normals (k, 2) as of `cell_normals`, inradius and circumradius [px]."""

    normals: NDArray[np.float64]
    inradius: float
    circumradius: float

    @classmethod
    def of(cls, lattice: Lattice) -> Cell:
        """That of the lenses of a lattice."""
        normals, circumradius = cell_normals(lattice)
        return cls(normals, float(0.5 / np.hypot(*normals.T).max()), circumradius)


def nearest_offsets(index: NDArray[np.float64], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) offsets [px] of places at fractional lattice coordinates (n, 2) from the lattice point nearest to each."""
    offsets = ((index - np.rint(index))[:, None] - _AROUND) @ basis
    nearest = np.hypot(offsets[..., 0], offsets[..., 1]).argmin(1)
    return offsets[np.arange(len(offsets)), nearest]


def bin_offsets(basis: NDArray[np.float64], bins: int, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(bins, bins, 2) offsets [px] of the bins of a cell from the nearest lattice point.

    One is at `centre` (2,), in fractional lattice coordinates; bin `k` covers `[k, k + 1) / bins`.
    """
    column, row = np.meshgrid(*[(np.arange(bins) + 0.5) / bins] * 2)
    return nearest_offsets(np.column_stack([column.ravel(), row.ravel()]) - centre, basis).reshape(bins, bins, 2)


def cell_distances(
    basis: NDArray[np.float64], offset: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) distances [px] of places, `offset` (n, 2) [px] from the centre, to it and to the border of the cell."""
    steps = _AROUND[np.abs(_AROUND).sum(1) > 0] @ basis
    length = np.hypot(*steps.T)
    return np.hypot(*offset.T), (0.5 * length - offset @ steps.T / length).min(1)


def cell_normals(lattice: Lattice) -> tuple[NDArray[np.float64], float]:
    """Normals (k, 2) with `delta @ normal <= 0.5` inside the cell of a lens, and its circumradius [px]."""
    a1, a2 = lattice.basis
    # The shorter diagonal cuts the corners of an oblique cell.
    half = np.array([a1, a2, min(a1 + a2, a1 - a2, key=lambda d: float(d @ d))])
    steps = np.vstack([half, -half])
    normals = steps / (steps**2).sum(1, keepdims=True)
    return normals, cell_circumradius(normals)


def cell_circumradius(normals: NDArray[np.float64]) -> float:
    """Circumradius of the cell with these normals [px]."""
    one, two = (normals[rows].T for rows in np.triu_indices(len(normals), 1))
    area = one[0] * two[1] - one[1] * two[0]
    met = np.abs(area) > 1e-9
    # Intersections of two sides, by Cramer's rule.
    corners = 0.5 * np.column_stack([two[1] - one[1], one[0] - two[0]])[met] / area[met, None]
    return float(np.hypot(*corners[(corners @ normals.T <= 0.5 + 1e-9).all(1)].T).max())


def cell_row_bounds(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sides (7, 2) of the cell with these normals (k, 2), for `row_interval`.

    Offset from the centre [px] and slope of at most three sides to the right and three to the left; then first and
    last row [px].
    """
    sides = np.array([[np.inf, 0.0]] * 3 + [[-np.inf, 0.0]] * 3 + [[-np.inf, np.inf]])
    level = 1e-9 * np.abs(normals).max()
    right = left = 0
    for x, y in normals.tolist():
        if x > level:
            sides[right] = 0.5 / x, y / x
            right += 1
        elif x < -level:
            sides[3 + left] = 0.5 / x, y / x
            left += 1
        else:
            sides[6, int(y > 0)] = 0.5 / y
    reach = cell_circumradius(normals)
    sides[6] = max(sides[6, 0], -reach), min(sides[6, 1], reach)
    return sides


@njit(error_model="numpy", inline="always")
def row_interval(dy, sides):
    """First and last x in row `dy` of a cell, all relative to its centre [px]; `sides` from `cell_row_bounds`."""
    high = min(min(sides[0, 0] - dy * sides[0, 1], sides[1, 0] - dy * sides[1, 1]), sides[2, 0] - dy * sides[2, 1])
    low = max(max(sides[3, 0] - dy * sides[3, 1], sides[4, 0] - dy * sides[4, 1]), sides[5, 0] - dy * sides[5, 1])
    return low, high


@njit(error_model="numpy", fastmath=False)
def is_outside_cell(dx, dy, normals):
    """Whether an offset from the centre lies outside of the cell with these normals."""
    most = 0.0
    for k in range(normals.shape[0]):
        most = max(most, dx * normals[k, 0] + dy * normals[k, 1])
    return most > 0.5


@njit(error_model="numpy", fastmath=False)
def clip_rows(centre, reach, corner, side):
    """First row of a window (`side` rows from `corner`) within `reach` of `centre`, and one after the last such row."""
    return max(int(np.ceil(centre - reach)) - corner, 0), min(int(np.floor(centre + reach)) + 1 - corner, side)
