"""Which lenses are lit: the microlens array need not fill the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.kernels.jit import kernel
from .lattice import Lattice, reduce_basis
from .lens_subset import StackedCrops, sample_lenses
from .settings import LIT_LENSES

__all__ = ["LitLenses", "find_lit_lenses"]


@dataclass(frozen=True)
class LitLenses:
    """Lenses of a flat, or of crops of it, that are lit.

    They are lenses `indices` (n, 2) of `lattice`, each in the crop with number `crop` (n,).
    """

    lattice: Lattice
    indices: NDArray[np.int64]
    crop: NDArray[np.int64]

    @classmethod
    def find(
        cls, tones: StackedCrops, lattice: Lattice, margin: float, dark: float, before: LitLenses | None
    ) -> LitLenses:
        """Lit lenses at least `margin` px inside a crop; `before` if its lattice has the same centres.

        `dark` is as in `find_lit_lenses`. Where an even sample of the lenses is lit, all others are taken as lit too.
        """
        if before is not None and before._is_for(lattice):
            return before
        sample = LIT_LENSES.check_sample
        if len(tones) == 1 and len(lattice) > 2 * sample:
            indices, centres = sample_lenses(lattice, margin, sample)
            if find_lit_lenses(tones.picture, lattice, indices, centres - tones.offsets, dark).all():
                # Lenses at the border are left out where some are chosen.
                return cls(lattice, lattice.indices(), np.zeros(len(lattice), np.int64))
        indices, centres, crop = tones.lenses(lattice, margin)
        positions = centres - (tones.offsets[crop] if len(tones) > 1 else tones.offsets)
        if len(tones) > 1 and len(positions) > 2 * sample:
            few = slice(None, None, len(positions) // sample)
            if find_lit_lenses(tones.picture, lattice, indices[few], positions[few], dark).all():
                return cls(lattice, indices, crop)
        lit = find_lit_lenses(tones.picture, lattice, indices, positions, dark)
        return cls(lattice, indices, crop) if lit.all() else cls(lattice, indices[lit], crop[lit])

    def _is_for(self, lattice: Lattice) -> bool:
        """Whether the centres of another lattice are those of this one, within a small share of the pitch."""
        along = (np.linspace(0, length - 1, LIT_LENSES.positions_per_side) for length in lattice.image_size)
        index = self.lattice.to_index(np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 2))
        shift = lattice.points(index) - self.lattice.points(index)
        return bool((np.hypot(*shift.T) < LIT_LENSES.same_lattice * lattice.pitch).all())

    def select(self, tones: StackedCrops, lattice: Lattice, margin: float, chosen: NDArray[np.bool_]) -> LitLenses:
        """The lenses chosen by a mask (n,) that are at least `margin` px inside their crop."""
        indices, crop = self.indices[chosen], self.crop[chosen]
        position = lattice.points(indices) - tones.corners[crop]
        inside = ((position >= margin) & (position <= np.array(tones.size) - 1 - margin)).all(1)
        return LitLenses(lattice, indices[inside], crop[inside])


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
    few = slice(None, None, max(1, len(core) // LIT_LENSES.quantile_sample))
    bright = LIT_LENSES.bright_quantile
    has_gaps = np.quantile(step[few], bright) > LIT_LENSES.gap_step * np.quantile(core[few], bright)
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
