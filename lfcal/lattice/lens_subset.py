"""Subsets of the lenses of a flat: whole, evenly spread, and those on crops of a large flat."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..runtime.arrays import Booleans, Floats, Integers, Singles
from .lattice import Lattice

__all__ = [
    "ReadCrop",
    "StackedCrops",
    "neighbour_rows",
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


def neighbour_rows(indices: Integers, steps: Integers) -> Integers:
    """(k, n) row of the lens at each of the steps (k, 2) from each of the lenses (n, 2).

    It is -1 where there is none among them.
    """
    reach = np.abs(steps).max(0)
    low = indices.min(0) - reach
    rows = np.full(indices.max(0) - low + reach + 1, -1)
    rows[tuple((indices - low).T)] = np.arange(len(indices))
    return np.array([rows[tuple((indices - low + step).T)] for step in steps])


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
