"""Voronoi cells of a lattice: the pixels nearer to the centre of a lens than to any other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from ..runtime.arrays import Floats, Integers
from .lattice import Lattice

__all__ = [
    "Cell",
    "bin_offsets",
    "cell_distances",
    "cell_side",
    "is_outside_cell",
    "nearest_lenses",
    "nearest_offsets",
    "row_interval",
]

_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


class Cell(NamedTuple):
    """Cell of a lens, for kernels."""

    normals: Floats  # (k, 2) [1/px] with `delta @ normal <= 0.5` inside
    inradius: float  # [px]
    circumradius: float  # [px]

    @classmethod
    def of(cls, lattice: Lattice) -> Cell:
        """That of the lenses of a lattice."""
        a1, a2 = lattice.basis
        # The shorter diagonal cuts the corners of an oblique cell.
        half = np.array([a1, a2, min(a1 + a2, a1 - a2, key=lambda d: float(d @ d))])
        steps = np.vstack([half, -half])
        normals = steps / (steps**2).sum(1, keepdims=True)
        one, two = (normals[rows].T for rows in np.triu_indices(len(normals), 1))
        area = one[0] * two[1] - one[1] * two[0]
        met = np.abs(area) > 1e-9
        # Intersections of two sides, by Cramer's rule.
        corners = 0.5 * np.column_stack([two[1] - one[1], one[0] - two[0]])[met] / area[met, None]
        reach = float(np.hypot(*corners[(corners @ normals.T <= 0.5 + 1e-9).all(1)].T).max())
        return cls(normals, float(0.5 / np.hypot(*normals.T).max()), reach)

    def row_bounds(self) -> Floats:
        """Sides (7, 2) for `row_interval`.

        Offset from the centre [px] and slope of at most three sides to the right and three to the
        left; then first and last row [px].
        """
        sides = np.array(
            [[np.inf, 0.0]] * 3 + [[-np.inf, 0.0]] * 3 + [[-self.circumradius, self.circumradius]]
        )
        level = 1e-9 * np.abs(self.normals).max()
        right = left = 0
        for x, y in self.normals.tolist():
            if x > level:
                sides[right] = 0.5 / x, y / x
                right += 1
            elif x < -level:
                sides[3 + left] = 0.5 / x, y / x
                left += 1
            elif y > 0:
                sides[6, 1] = min(sides[6, 1], 0.5 / y)
            else:
                sides[6, 0] = max(sides[6, 0], 0.5 / y)
        return sides


def cell_side(basis: Floats) -> float:
    """Side [px] of the square that is as large as a cell of a basis (2, 2) [px]."""
    return float(np.sqrt(abs(np.linalg.det(basis))))


def nearest_offsets(index: Floats, basis: Floats) -> Floats:
    """(n, 2) offsets [px] of places at fractional lattice coordinates (n, 2) from the lattice point
    nearest to each.
    """
    offsets = ((index - np.rint(index))[:, None] - _AROUND) @ basis
    nearest = np.hypot(offsets[..., 0], offsets[..., 1]).argmin(1)
    return offsets[np.arange(len(offsets)), nearest]


def nearest_lenses(lattice: Lattice, places: Floats) -> Integers:
    """(n, 2) lattice indices of the lenses nearest to places (n, 2) [px] of a flat."""
    around = np.rint(lattice.to_index(places)).astype(np.int64)[:, None] + _AROUND
    away = lattice.points(around) - places[:, None]
    nearest = np.hypot(away[..., 0], away[..., 1]).argmin(1)
    return around[np.arange(len(around)), nearest]


def bin_offsets(basis: Floats, bins: int, centre: Floats) -> Floats:
    """(bins, bins, 2) offsets [px] of the bins of a cell from the nearest lattice point.

    One is at `centre` (2,), in fractional lattice coordinates; bin `k` covers `[k, k + 1) / bins`.
    """
    column, row = np.meshgrid(*[(np.arange(bins) + 0.5) / bins] * 2)
    return nearest_offsets(np.column_stack([column.ravel(), row.ravel()]) - centre, basis).reshape(
        bins, bins, 2
    )


def cell_distances(basis: Floats, offset: Floats) -> tuple[Floats, Floats]:
    """(n,) distances [px] of places, `offset` (n, 2) [px] from the centre, to it and to the border
    of the cell.
    """
    steps = _AROUND[np.abs(_AROUND).sum(1) > 0] @ basis
    length = np.hypot(*steps.T)
    return np.hypot(*offset.T), (0.5 * length - offset @ steps.T / length).min(1)


@njit(error_model="numpy", inline="always")
def row_interval(dy, sides):
    """First and last x in row `dy` of a cell, all relative to its centre [px]; `sides` from
    `Cell.row_bounds`.
    """
    high = min(
        min(sides[0, 0] - dy * sides[0, 1], sides[1, 0] - dy * sides[1, 1]),
        sides[2, 0] - dy * sides[2, 1],
    )
    low = max(
        max(sides[3, 0] - dy * sides[3, 1], sides[4, 0] - dy * sides[4, 1]),
        sides[5, 0] - dy * sides[5, 1],
    )
    return low, high


@njit(error_model="numpy", fastmath=False)
def is_outside_cell(dx, dy, normals):
    """Whether an offset from the centre lies outside of the cell with these normals."""
    most = 0.0
    for k in range(normals.shape[0]):
        most = max(most, dx * normals[k, 0] + dy * normals[k, 1])
    return most > 0.5
