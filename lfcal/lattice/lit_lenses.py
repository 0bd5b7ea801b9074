"""Which lenses are lit: the microlens array need not fill the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.kernels import kernel
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


@kernel(share=lambda picture, centres, *_: len(centres))
def _measure_core_and_gaps(begin, end, picture, centres, corners, core, gaps):
    """Mean of a picture over the 3 x 3 px at the centre of each lens, and over the corners of its cell."""
    height, width = picture.shape
    for lens in range(begin, end):
        cx, cy = centres[lens, 0], centres[lens, 1]
        x, y = int(np.rint(cx)), int(np.rint(cy))
        total = 0.0
        for row in range(y - 1, y + 2):
            for column in range(x - 1, x + 2):
                total += picture[row, column]
        core[lens] = total / 9
        total = 0.0
        for k in range(len(corners)):
            column = min(max(int(np.rint(cx + corners[k, 0])), 0), width - 1)
            row = min(max(int(np.rint(cy + corners[k, 1])), 0), height - 1)
            total += picture[row, column]
        gaps[lens] = total / len(corners)


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
    core, gaps = np.empty(len(centres)), np.empty(len(centres))
    _measure_core_and_gaps(picture, centres, _cell_corners(lattice), core, gaps)
    step = core - gaps
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
