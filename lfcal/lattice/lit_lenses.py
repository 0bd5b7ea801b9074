"""Lenses that get light: an array need not fill the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .lattice import Lattice, reduce_basis
from .lens_subset import StackedCrops, sample_lenses

__all__ = ["LitLenses", "find_lit_lenses"]

# Gaps are seen where they are darker than lenses by this share of the light; else dark lenses are told by their middle.
_GAPS = 0.3
# Quantile of the lenses that is a bright one, without being dust or a hot pixel.
_BRIGHT = 0.95
# So many lenses tell what is bright.
_TELLING = 20_000
# If so many, evenly spread, are all lit, then so are the others, but for single ones.
_ASKED = 5000
# Lenses that move by less than this share of the pitch stay lit, or dark.
_SAME = 0.02
# Places along each side of the flat at which such moves are looked for.
_ALONG = 9


@dataclass(frozen=True)
class LitLenses:
    """Lenses of a flat, or of parts of it, that get light.

    Parameters
    ----------
    lattice : Lattice [px]
        That they were looked for on.
    indices : (n, 2) int64
    part : (n,) int64
        That they are in.
    """

    lattice: Lattice
    indices: NDArray[np.int64]
    part: NDArray[np.int64]

    @classmethod
    def on(
        cls, tones: StackedCrops, lattice: Lattice, margin: float, dark: float, before: LitLenses | None
    ) -> LitLenses:
        """Lenses at least `margin` px inside a part; `before` where the lattice is the same still."""
        if before is not None and before._still_on(lattice):
            return before
        if len(tones) == 1 and len(lattice) > 2 * _ASKED:
            indices, centres = sample_lenses(lattice, margin, _ASKED)
            if find_lit_lenses(tones.picture, lattice, indices, centres - tones.offsets, dark).all():
                # Those at the border are left out where some are chosen.
                return cls(lattice, lattice.indices(), np.zeros(len(lattice), np.int64))
        indices, centres, part = tones.lenses(lattice, margin)
        places = centres - (tones.offsets[part] if len(tones) > 1 else tones.offsets)
        if len(tones) > 1 and len(places) > 2 * _ASKED:
            few = slice(None, None, len(places) // _ASKED)
            if find_lit_lenses(tones.picture, lattice, indices[few], places[few], dark).all():
                return cls(lattice, indices, part)
        alight = find_lit_lenses(tones.picture, lattice, indices, places, dark)
        return cls(lattice, indices, part) if alight.all() else cls(lattice, indices[alight], part[alight])

    def _still_on(self, lattice: Lattice) -> bool:
        along = (np.linspace(0, length - 1, _ALONG) for length in lattice.image_size)
        index = self.lattice.to_index(np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 2))
        apart = lattice.points(index) - self.lattice.points(index)
        return bool((np.hypot(*apart.T) < _SAME * lattice.pitch).all())

    def some(self, tones: StackedCrops, lattice: Lattice, margin: float, chosen: NDArray[np.bool_]) -> LitLenses:
        """The chosen (n,) ones that are still `margin` px inside their part."""
        indices, part = self.indices[chosen], self.part[chosen]
        place = lattice.points(indices) - tones.corners[part]
        inside = ((place >= margin) & (place <= np.array(tones.size) - 1 - margin)).all(1)
        return LitLenses(lattice, indices[inside], part[inside])


@njit(cache=True, nogil=True, parallel=True)
def _measure(picture, centres, corners, core, gaps):
    """Mean of a picture in the middle of lenses, and at the corners of their cells."""
    height, width = picture.shape
    for lens in prange(len(centres)):
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
    """(n,) whether lenses are lit and not beside a dark one: the border of an array cuts some.

    Stray light reaches places without a lens too, so it is the step from a lens to the gaps around it that counts.

    Parameters
    ----------
    picture : (h, w) float32
        Light, or a tone of it.
    lattice : Lattice [px]
    indices, centres : (n, 2)
        Lenses, their centres in the picture at least 1.5 px inside.
    dark : float
        Share of the value of a bright lens below which one is dark.
    """
    if len(centres) == 0:
        return np.zeros(0, dtype=bool)
    core, gaps = np.empty(len(centres)), np.empty(len(centres))
    _measure(picture, centres, _corners(lattice), core, gaps)
    step = core - gaps
    few = slice(None, None, max(1, len(core) // _TELLING))
    seen = np.quantile(step[few], _BRIGHT) > _GAPS * np.quantile(core[few], _BRIGHT)
    value = step if seen else core
    shut = value < dark * np.quantile(value[few], _BRIGHT)
    if not shut.any():
        return ~shut
    low = indices.min(0) - 1
    grid = np.zeros(indices.max(0) - low + 2, dtype=bool)
    grid[tuple((indices[shut] - low).T)] = True
    beside = shut.copy()
    for neighbour in lattice.steps:
        beside |= grid[tuple((indices - low + neighbour).T)]
    return ~beside


def _corners(lattice: Lattice) -> NDArray[np.float64]:
    """(6, 2) from a lens to the corners of its cell, where three or four lenses meet [px]."""
    a, b = reduce_basis(lattice.basis)
    corner = np.linalg.solve(np.array([a, b]), [a @ a / 2, b @ b / 2])
    half = np.array([corner, corner - a, corner - b])
    return np.concatenate([half, -half])
