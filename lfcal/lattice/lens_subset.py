"""Subsets of the lenses of a flat, and crops of a large flat that hold some of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["ReadCrop", "StackedCrops", "sample_lenses", "sample_mask", "select_whole_lenses"]

#: Reads a rectangle of a flat, (height, width) float32, given its x, y, width and height [px].
ReadCrop = Callable[[int, int, int, int], NDArray[np.float32]]


def select_whole_lenses(lattice: Lattice, margin: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices (n, 2) and centres (n, 2) of lenses at least `margin` px inside the flat."""
    centres, indices = lattice.centres(), lattice.indices()
    width, height = lattice.image_size
    x, y = centres.T
    # Comparing two columns, and `take`, are several times as fast as comparing and indexing rows of two.
    keep = np.flatnonzero((x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin))
    return indices.take(keep, 0), centres.take(keep, 0)


def sample_lenses(lattice: Lattice, margin: float, wanted: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """About `wanted` of `select_whole_lenses`, evenly spread."""
    indices, centres = select_whole_lenses(lattice, margin)
    rows = np.flatnonzero(sample_mask(len(indices), wanted / max(len(indices), 1)))
    return indices.take(rows, 0), centres.take(rows, 0)


def sample_mask(number: int, share: float) -> NDArray[np.bool_]:
    """(number,) mask that is True for this share of its entries, evenly spread."""
    # Steps of the golden ratio sample evenly, whatever the period of the lenses.
    fraction = np.arange(number) * 0.6180339887498949
    # Twenty times as fast as a remainder.
    fraction -= np.floor(fraction)
    return fraction < share


@dataclass(frozen=True)
class StackedCrops:
    """Crops of a flat, all of one size and without overlap, stacked in one picture.

    Parameters
    ----------
    picture : (m * height, width) float32
    corners : (m, 2) int64 [px]
        Flat coordinates x, y of the first pixel of each crop.
    size : (int, int) [px]
        Width and height of a crop.
    """

    picture: NDArray[np.float32]
    corners: NDArray[np.int64]
    size: tuple[int, int]

    @classmethod
    def of(cls, picture: NDArray[np.float32] | StackedCrops) -> StackedCrops:
        """Crops as they are, or a whole flat as its only crop."""
        if isinstance(picture, StackedCrops):
            return picture
        return cls(picture, np.zeros((1, 2), np.int64), (picture.shape[1], picture.shape[0]))

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """(m, 2) flat coordinates minus picture coordinates in each crop [px]."""
        down = np.arange(len(self)) * self.size[1]
        return self.corners - np.column_stack([np.zeros_like(down), down])

    def crop(self, number: int) -> NDArray[np.float32]:
        """(height, width) view of one crop."""
        return self.picture[number * self.size[1] : (number + 1) * self.size[1]]

    def lenses(
        self, lattice: Lattice, margin: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Lenses at least `margin` px inside a crop: indices (n, 2), centres on the flat (n, 2) [px], crop number (n,).

        Their centres in the picture are `centres - offsets[crop]`.
        """
        if self.size == lattice.image_size:
            whole = select_whole_lenses(lattice, margin)
            return (*whole, np.zeros(len(whole[0]), np.int64))
        inside = [
            _lenses_in_rectangle(lattice, corner + margin, corner + np.array(self.size) - 1 - margin)
            for corner in self.corners
        ]
        crop = np.repeat(np.arange(len(self)), [len(index) for index in inside])
        indices = np.concatenate(inside)
        return indices, lattice.points(indices), crop


def _lenses_in_rectangle(lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 2) indices of the lenses with centres in a rectangle."""
    # A grid of positions, as a distorted lattice has no straight borders.
    share = np.linspace(0, 1, 5)
    x, y = np.meshgrid(*(low[axis] + share * (high[axis] - low[axis]) for axis in (0, 1)))
    bounds = lattice.to_index(np.column_stack([x.ravel(), y.ravel()]))
    least, most = np.floor(bounds.min(0)).astype(np.int64) - 1, np.ceil(bounds.max(0)).astype(np.int64) + 1
    i, j = np.meshgrid(np.arange(least[0], most[0] + 1), np.arange(least[1], most[1] + 1))
    index = np.column_stack([i.ravel(), j.ravel()])
    centres = lattice.points(index)
    return index[((centres >= low) & (centres <= high)).all(1)]
