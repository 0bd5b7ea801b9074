"""The grid of scene points on which a surface is computed, and the lens nearest to each point, for kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice

from ...flat.distorted_lookup import lens_displacements
from ...flat.lens_graph import lens_grid

__all__ = ["SceneGrid", "grid_shape", "lens_at", "scene_grid"]


class SceneGrid(NamedTuple):
    """Scene points at `first + spacing * (u, v)` [px], and the lattice for looking up lenses.

    Parameters
    ----------
    first, spacing : float [px]
    rows : (nj, ni) int32
        Row of lens (i, j) at `rows[j - low[1], i - low[0]]`, -1 where there is none.
    low : (2,) int64
    origin, basis, inverse : (2,), (2, 2), (2, 2) float64
        Of the lattice, and the inverse of its basis.
    bend, bend_low : (nj, ni, 2) float32, (2,) int64
        As `lens_displacements`.
    """

    first: float
    spacing: float
    rows: NDArray[np.int32]
    low: NDArray[np.int64]
    origin: NDArray[np.float64]
    basis: NDArray[np.float64]
    inverse: NDArray[np.float64]
    bend: NDArray[np.float32]
    bend_low: NDArray[np.int64]


def grid_shape(lattice: Lattice, cells: int) -> tuple[tuple[int, int], tuple[float, float], float]:
    """Rows and columns of the grid of scene points, `cells` per pitch, the first of them, and their spacing [px]."""
    width, height = lattice.image_size
    spacing = lattice.pitch / cells
    return (int(np.ceil(height / spacing)) + 1, int(np.ceil(width / spacing)) + 1), (-0.5, -0.5), spacing


def scene_grid(lattice: Lattice, first: float, spacing: float) -> SceneGrid:
    return SceneGrid(
        first, spacing, *lens_grid(lattice), np.asarray(lattice.origin), np.asarray(lattice.basis),
        np.linalg.inv(lattice.basis).astype(np.float64), *lens_displacements(lattice),
    )  # fmt: skip


@njit(inline="always")
def lens_at(rows, low, i, j):
    """Row of lens (i, j) by `rows` and `low` of a `SceneGrid`, -1 where there is none."""
    ci, cj = i - low[0], j - low[1]
    if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1]:
        return -1
    return rows[cj, ci]
