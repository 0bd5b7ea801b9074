"""Lenses as kernels look them up by their place, and the grid of scene points on which a surface is
computed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal import Lattice

from ...flat.lens_graph import lens_displacements, nearest_first
from ...flat.neighbours import neighbours_of

__all__ = ["LensArray", "PointGrid", "grid_shape", "lens_array", "lens_at"]


class LensArray(NamedTuple):
    """Lenses, for kernels."""

    centres: Any  # (n, 2) float64 [px]
    indices: Any  # (n, 2) int64
    rows: Any  # (nj, ni) int32, this and the next as `Neighbours.grid` and `low`
    low: Any  # (2,) int64
    # (k, 2) int64 steps to the lenses within 2.2 pitches of one, the nearest first, itself
    # included: they see a point
    ring: Any
    origin: Any  # (2,) float64 of the lattice, and the inverse of its basis
    inverse: Any  # (2, 2) float64
    bend: Any  # (nj, ni, 2) float32, this and the next as `lens_displacements`
    bend_low: Any  # (2,) int64
    pitch: Any  # [px]
    radius: Any  # [px] of a microimage
    gap: Any  # [px] difference of patch sizes between two surfaces


class PointGrid(NamedTuple):
    """Scene points `first + spacing * (u, v)` [px] of a surface."""

    first: Any
    spacing: Any


def lens_array(lattice: Lattice, gap: float, radius: float) -> LensArray:
    """The lenses of a lattice, with microimages of this radius [px]."""
    span = np.arange(-3, 4)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    order = nearest_first(distance, lattice.pitch)
    ring = np.ascontiguousarray(steps[order][distance[order] < 2.2 * lattice.pitch])
    neighbours = neighbours_of(lattice)
    return LensArray(
        lattice.centres(),
        lattice.indices().astype(np.int64),
        neighbours.grid,
        neighbours.low,
        ring,
        np.asarray(lattice.origin, float),
        np.linalg.inv(lattice.basis).astype(float),
        *lens_displacements(lattice),
        float(lattice.pitch),
        float(radius),
        float(gap),
    )


def grid_shape(lattice: Lattice, cells: int) -> tuple[tuple[int, int], tuple[float, float], float]:
    """Rows and columns of the grid of scene points, `cells` per pitch, the first of them, and their
    spacing [px].
    """
    width, height = lattice.image_size
    spacing = lattice.pitch / cells
    # Rounding errors of the pitch add no row.
    columns, rows = np.ceil(np.round(np.array([width, height]) / spacing, 6)).astype(int).tolist()
    return (rows + 1, columns + 1), (-0.5, -0.5), spacing


@njit(inline="always")
def lens_at(rows, low, i, j):
    """Row of lens (i, j) by `rows` and `low` of a `LensArray`, -1 where there is none."""
    ci = i - low[0]
    cj = j - low[1]
    if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1]:
        return -1
    return rows[cj, ci]
