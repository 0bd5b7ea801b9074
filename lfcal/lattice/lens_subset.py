"""Subsets of the lenses of a flat: whole, evenly spread, lit ones, and those on crops of a large
flat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..runtime.arrays import Booleans, Floats, Integers, Singles
from .lattice import Lattice, reduce_basis

__all__ = [
    "ReadCrop",
    "StackedCrops",
    "find_lit_lenses",
    "sample_lenses",
    "sample_mask",
]

#: Reads a rectangle of a flat, (height, width) float32, given its x, y, width and height [px].
ReadCrop = Callable[[int, int, int, int], Singles]


def sample_lenses(lattice: Lattice, margin: float, wanted: float) -> tuple[Integers, Floats]:
    """About `wanted` of `Lattice.select_whole`, evenly spread."""
    indices, centres = lattice.select_whole(margin)
    rows = np.flatnonzero(sample_mask(len(indices), wanted / max(len(indices), 1)))
    return indices.take(rows, 0), centres.take(rows, 0)


def sample_mask(number: int, share: float) -> Booleans:
    """(number,) mask that is True for this share of its entries, evenly spread."""
    # Steps of the golden ratio sample evenly, whatever the period of the lenses.
    fraction = np.arange(number) * 0.6180339887498949
    # Twenty times as fast as a remainder.
    fraction -= np.floor(fraction)
    return fraction < share


@dataclass(frozen=True)
class StackedCrops:
    """Crops of a flat, all of one size and without overlap, stacked in one picture."""

    picture: Singles  # (m * height, width)
    corners: Integers  # (m, 2) [px] x, y of the first pixel of each crop on the flat
    size: tuple[int, int]  # [px] width and height of a crop

    @classmethod
    def of(cls, picture: Singles | StackedCrops) -> StackedCrops:
        """Crops as they are, or a whole flat as its only crop."""
        if isinstance(picture, StackedCrops):
            return picture
        return cls(picture, np.zeros((1, 2), np.int64), (picture.shape[1], picture.shape[0]))

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def offsets(self) -> Integers:
        """(m, 2) flat coordinates minus picture coordinates in each crop [px]."""
        down = np.arange(len(self)) * self.size[1]
        return self.corners - np.column_stack([np.zeros_like(down), down])

    def crop(self, number: int) -> Singles:
        """(height, width) view of one crop."""
        return self.picture[number * self.size[1] : (number + 1) * self.size[1]]

    def lenses(self, lattice: Lattice, margin: float) -> tuple[Integers, Floats, Integers]:
        """Lenses at least `margin` px inside a crop: indices (n, 2), centres on the flat (n, 2)
        [px], crop number (n,).

        Their centres in the picture are `centres - offsets[crop]`.
        """
        if self.size == lattice.image_size:
            whole = lattice.select_whole(margin)
            return (*whole, np.zeros(len(whole[0]), np.int64))
        last = np.array(self.size) - 1 - margin
        inside = [
            lattice.select_in_rectangle(corner + margin, corner + last) for corner in self.corners
        ]
        crop = np.repeat(np.arange(len(self)), [len(index) for index in inside])
        indices = np.concatenate(inside)
        return indices, lattice.points(indices), crop


def find_lit_lenses(
    picture: Singles, lattice: Lattice, indices: Integers, centres: Floats, dark: float
) -> Booleans:
    """(n,) whether lenses are lit and not next to a dark one, as the border of the array cuts some.

    Stray light also reaches pixels without a lens, so lenses are found by the step to the gaps
    around them where gaps are visible, else by the brightness of their core.

    `picture` (h, w) is light or its square root; `centres` (n, 2) are at least 1.5 px inside it. A
    lens is dark below the share `dark` of the step (or brightness) of a bright lens.
    """
    if len(centres) == 0:
        return np.zeros(0, dtype=bool)

    def mean_at(offsets: Floats) -> Floats:
        total = np.zeros(len(centres))
        for offset in offsets:
            x, y = np.rint(centres + offset).astype(np.int64).T
            total += picture[y.clip(0, len(picture) - 1), x.clip(0, picture.shape[1] - 1)]
        return total / len(offsets)

    core = mean_at(np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2))
    step = core - mean_at(_cell_corners(lattice))
    # Bright, without being dust or a hot pixel.
    few = slice(None, None, max(1, len(core) // 20_000))
    bright = 0.95
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


def _cell_corners(lattice: Lattice) -> Floats:
    """(6, 2) from a lens to the corners of its cell, where three or four lenses meet [px]."""
    a, b = reduce_basis(lattice.basis)
    corner = np.linalg.solve(np.array([a, b]), [a @ a / 2, b @ b / 2])
    half = np.array([corner, corner - a, corner - b])
    return np.concatenate([half, -half])
