"""Which pixels belong to a lens: those in its cell, nearer to its centre than to any other."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["cell_faces", "inner_radius", "outside", "rows_within"]


def cell_faces(lattice: Lattice) -> tuple[NDArray[np.float64], float]:
    """Normals (k, 2) such that `delta @ normal <= 0.5` inside the cell of a lens, and the cell's circumradius [px]."""
    steps = lattice.steps @ lattice.basis
    if len(steps) == 4:
        # Corners of an oblique cell are cut by the shorter diagonal.
        a1, a2 = lattice.basis
        diagonal = min(a1 + a2, a1 - a2, key=lambda d: float(d @ d))
        steps = np.vstack([steps, diagonal, -diagonal])
    faces = steps / (steps**2).sum(1, keepdims=True)
    corners = []
    for a in range(len(faces)):
        for b in range(a):
            pair = faces[[a, b]]
            if abs(np.linalg.det(pair)) > 1e-9:
                corner = np.linalg.solve(pair, [0.5, 0.5])
                if (faces @ corner <= 0.5 + 1e-9).all():
                    corners.append(float(np.hypot(*corner)))
    return faces, max(corners)


def inner_radius(faces: NDArray[np.float64]) -> float:
    """Radius of the circle inside a cell with these faces [px]."""
    return float(0.5 / np.hypot(*faces.T).max())


@njit(cache=True, nogil=True, error_model="numpy")
def outside(dx, dy, faces):
    """Whether a place lies outside of the cell with these faces (`cell_faces`)."""
    most = 0.0
    for k in range(faces.shape[0]):
        most = max(most, dx * faces[k, 0] + dy * faces[k, 1])
    return most > 0.5


@njit(cache=True, nogil=True, error_model="numpy")
def rows_within(centre, reach, corner, side):
    """First and last but one row of a window within reach of the centre."""
    return max(int(np.ceil(centre - reach)) - corner, 0), min(int(np.floor(centre + reach)) + 1 - corner, side)
