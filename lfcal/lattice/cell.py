"""Which pixels belong to a lens: those in its cell, nearer to its centre than to any other."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = [
    "cell_circumradius",
    "cell_inradius",
    "cell_normals",
    "cell_row_bounds",
    "clip_rows",
    "is_outside_cell",
    "row_interval",
]


def cell_normals(lattice: Lattice) -> tuple[NDArray[np.float64], float]:
    """Normals (k, 2) such that `delta @ normal <= 0.5` inside the cell of a lens, and the cell's circumradius [px]."""
    steps = lattice.steps @ lattice.basis
    if len(steps) == 4:
        # Corners of an oblique cell are cut by the shorter diagonal.
        a1, a2 = lattice.basis
        diagonal = min(a1 + a2, a1 - a2, key=lambda d: float(d @ d))
        steps = np.vstack([steps, diagonal, -diagonal])
    faces = steps / (steps**2).sum(1, keepdims=True)
    return faces, cell_circumradius(faces)


def cell_circumradius(faces: NDArray[np.float64]) -> float:
    """Radius of the circle around a cell with these faces [px]."""
    one, two = (faces[rows].T for rows in np.triu_indices(len(faces), 1))
    area = one[0] * two[1] - one[1] * two[0]
    met = np.abs(area) > 1e-9
    # Where two sides meet, by Cramer's rule.
    corners = 0.5 * np.column_stack([two[1] - one[1], one[0] - two[0]])[met] / area[met, None]
    return float(np.hypot(*corners[(corners @ faces.T <= 0.5 + 1e-9).all(1)].T).max())


def cell_inradius(faces: NDArray[np.float64]) -> float:
    """Radius of the circle inside a cell with these faces [px]."""
    return float(0.5 / np.hypot(*faces.T).max())


def cell_row_bounds(faces: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sides of a cell with these faces (k, 2), for `row_interval`.

    Returns
    -------
    (7, 2) float64 [px]
        Place, from the centre, and lean of three sides to the right and three to the left, where there are so many;
        then first and last row.
    """
    sides = np.array([[np.inf, 0.0]] * 3 + [[-np.inf, 0.0]] * 3 + [[-np.inf, np.inf]])
    level = 1e-9 * np.abs(faces).max()
    right = left = 0
    for x, y in faces.tolist():
        if x > level:
            sides[right] = 0.5 / x, y / x
            right += 1
        elif x < -level:
            sides[3 + left] = 0.5 / x, y / x
            left += 1
        else:
            sides[6, int(y > 0)] = 0.5 / y
    reach = cell_circumradius(faces)
    sides[6] = max(sides[6, 0], -reach), min(sides[6, 1], reach)
    return sides


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def row_interval(dy, sides):
    """First and last place of a row in a cell (`cell_row_bounds`), both from its centre [px]."""
    high = min(min(sides[0, 0] - dy * sides[0, 1], sides[1, 0] - dy * sides[1, 1]), sides[2, 0] - dy * sides[2, 1])
    low = max(max(sides[3, 0] - dy * sides[3, 1], sides[4, 0] - dy * sides[4, 1]), sides[5, 0] - dy * sides[5, 1])
    return low, high


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def is_outside_cell(dx, dy, faces):
    """Whether a place lies outside of the cell with these faces (`cell_normals`)."""
    most = 0.0
    for k in range(faces.shape[0]):
        most = max(most, dx * faces[k, 0] + dy * faces[k, 1])
    return most > 0.5


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False)
def clip_rows(centre, reach, corner, side):
    """First and last but one row of a window within reach of the centre."""
    return max(int(np.ceil(centre - reach)) - corner, 0), min(int(np.floor(centre + reach)) + 1 - corner, side)
