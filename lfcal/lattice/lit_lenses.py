"""Which lenses are lit: the microlens array need not fill the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice, reduce_basis
from .lens_subset import StackedCrops

__all__ = ["LitLenses", "find_lit_lenses"]


@dataclass(frozen=True)
class LitLenses:
    """Lenses `indices` (n, 2) of a flat, or of crops of it, that are lit, each in the crop with number `crop` (n,)."""

    indices: NDArray[np.int64]
    crop: NDArray[np.int64]

    @classmethod
    def find(cls, tones: StackedCrops, lattice: Lattice, margin: float, dark: float) -> LitLenses:
        """Lit lenses at least `margin` px inside a crop; `dark` is as in `find_lit_lenses`."""
        indices, centres, crop = tones.lenses(lattice, margin)
        lit = find_lit_lenses(tones.picture, lattice, indices, centres - tones.offsets[crop], dark)
        return cls(indices[lit], crop[lit])

    def select(self, tones: StackedCrops, lattice: Lattice, margin: float, chosen: NDArray[np.bool_]) -> LitLenses:
        """The lenses chosen by a mask (n,) that are at least `margin` px inside their crop."""
        indices, crop = self.indices[chosen], self.crop[chosen]
        position = lattice.points(indices) - tones.corners[crop]
        inside = ((position >= margin) & (position <= np.array(tones.size) - 1 - margin)).all(1)
        return LitLenses(indices[inside], crop[inside])


def find_lit_lenses(
    picture: NDArray[np.float32],
    lattice: Lattice,
    indices: NDArray[np.int64],
    centres: NDArray[np.float64],
    dark: float,
) -> NDArray[np.bool_]:
    """(n,) whether lenses are lit and not next to a dark one, as the border of the array cuts some.

    Stray light also reaches pixels without a lens, so lenses are found by the step to the gaps around them where
    gaps are visible, else by the brightness of their core.

    `picture` (h, w) is light or its square root; `centres` (n, 2) are at least 1.5 px inside it. A lens is dark below
    the share `dark` of the step (or brightness) of a bright lens.
    """
    if len(centres) == 0:
        return np.zeros(0, dtype=bool)

    def mean_at(offsets: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.zeros(len(centres))
        for offset in offsets:
            x, y = np.rint(centres + offset).astype(np.int64).T
            total += picture[y.clip(0, len(picture) - 1), x.clip(0, picture.shape[1] - 1)]
        return total / len(offsets)

    core = mean_at(np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2))
    step = core - mean_at(_cell_corners(lattice))
    # Bright, without being dust or a hot pixel.
    few, bright = slice(None, None, max(1, len(core) // 20_000)), 0.95
    has_gaps = np.quantile(step[few], bright) > 0.3 * np.quantile(core[few], bright)
    value = step if has_gaps else core
    unlit = value < dark * np.quantile(value[few], bright)
    if not unlit.any():
        return ~unlit
    low = indices.min(0) - 1
    grid = np.zeros(indices.max(0) - low + 2, dtype=bool)
    grid[tuple((indices[unlit] - low).T)] = True
    beside = unlit.copy()
    for neighbour in lattice.steps:
        beside |= grid[tuple((indices - low + neighbour).T)]
    return ~beside


def _cell_corners(lattice: Lattice) -> NDArray[np.float64]:
    """(6, 2) from a lens to the corners of its cell, where three or four lenses meet [px]."""
    a, b = reduce_basis(lattice.basis)
    corner = np.linalg.solve(np.array([a, b]), [a @ a / 2, b @ b / 2])
    half = np.array([corner, corner - a, corner - b])
    return np.concatenate([half, -half])
