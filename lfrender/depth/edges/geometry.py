"""What the kernels of this room share: where lenses are, the grid values of a surface, and levels of patch sizes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice

from ...flat.lens_graph import lens_grid

__all__ = ["LEVELS", "LensArray", "PointGrid", "lens_array", "level_of", "mark_levels"]

#: Patch sizes are told apart in so many levels of equal width, one bit each.
LEVELS = 64
# [pitch] range of these levels, either way.
_RANGE = 0.8


class LensArray(NamedTuple):
    """Lenses, for kernels.

    Parameters
    ----------
    centres : (n, 2) float64 [px]
    indices : (n, 2) int64
    rows, low : (nj, ni) int32, (2,) int64
        As `lens_grid`.
    ring : (k, 2) int64
        Steps to the lenses around one, the nearest first, itself included.
    origin, inverse : (2,), (2, 2) float64
        Of the lattice, and the inverse of its basis.
    pitch, radius, gap : float [px]
        Pitch; radius of a microimage; difference of patch sizes between two surfaces.
    """

    centres: Any
    indices: Any
    rows: Any
    low: Any
    ring: Any
    origin: Any
    inverse: Any
    pitch: Any
    radius: Any
    gap: Any


class PointGrid(NamedTuple):
    """Scene points `first + spacing * (u, v)` [px] of a surface."""

    first: Any
    spacing: Any


def lens_array(lattice: Lattice, gap: float, radius: float) -> LensArray:
    """The lenses of a lattice, with the ring of 2.3 pitches in which scene points are seen."""
    rows, low = lens_grid(lattice)
    span = np.arange(-4, 5)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    order = np.argsort(distance, kind="stable")
    ring = np.ascontiguousarray(steps[order][distance[order] < 2.3 * lattice.pitch])
    return LensArray(
        lattice.centres(), lattice.indices().astype(np.int64), rows, np.asarray(low, np.int64), ring,
        np.asarray(lattice.origin, float), np.linalg.inv(lattice.basis).astype(float), float(lattice.pitch),
        float(radius), float(gap),
    )  # fmt: skip


@njit(inline="always")
def level_of(s, pitch):
    """Number of the level of a patch size."""
    return min(max(int((s / pitch + _RANGE) * (0.5 * LEVELS / _RANGE)), 0), LEVELS - 1)


def mark_levels(surface: NDArray[np.float32], pitch: float, reach: int) -> NDArray[np.uint64]:
    """(rows, columns): a bit for each level of patch sizes that the surface has within `reach` values each way."""
    one = np.uint64(1)
    level = np.clip(((surface / pitch + _RANGE) * (0.5 * LEVELS / _RANGE)).astype(int), 0, LEVELS - 1)
    bits = np.zeros(surface.shape, np.uint64)
    for beside in (-1, 0, 1):
        bits |= one << np.clip(level + beside, 0, LEVELS - 1).astype(np.uint64)
    for axis in (0, 1):
        bits, wide = np.moveaxis(bits, axis, 0), 1
        # The window doubles until it is as wide as it has to be.
        bits = np.pad(bits, ((reach, reach), (0, 0)))
        while wide < 2 * reach + 1:
            step = min(wide, 2 * reach + 1 - wide)
            bits, wide = bits[step:] | bits[:-step], wide + step
        bits = np.moveaxis(bits, 0, axis)
    return np.ascontiguousarray(bits)
