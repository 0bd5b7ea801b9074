"""Parts of a large flat beside each other in one small picture: what a fit needs of it, without the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["ReadCrop", "StackedCrops", "sample_lenses", "sample_mask", "select_whole_lenses"]

#: Picture of a rectangle of a flat, (height, width) float32, given its x, y, width and height [px].
ReadCrop = Callable[[int, int, int, int], NDArray[np.float32]]

# Points along each side of a part by which a distorted lattice is followed.
_ALONG = 5
# Steps by the golden ratio choose lenses evenly whatever period they have.
_GOLDEN = 0.6180339887498949
# Of more lenses than this hardly any lie at the border: which lie whole on the flat is asked after choosing.
_MANY = 60_000


def select_whole_lenses(lattice: Lattice, margin: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices (n, 2) and centres (n, 2) of lenses at least `margin` px inside the flat."""
    centres, indices = lattice.centres(), lattice.indices()
    width, height = lattice.image_size
    x, y = centres.T
    # Of very many lenses, two columns are compared several times as fast as rows of two, and so are rows taken.
    keep = np.flatnonzero((x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin))
    return indices.take(keep, 0), centres.take(keep, 0)


def sample_lenses(lattice: Lattice, margin: float, wanted: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """About so many of `select_whole_lenses`, evenly spread; fewer by those at the border of very large flats."""
    if len(lattice) <= _MANY:
        indices, centres = select_whole_lenses(lattice, margin)
        rows = _chosen(len(indices), wanted)
        return indices[rows], centres[rows]
    indices = lattice.indices()
    indices = indices[_chosen(len(indices), wanted)]
    centres = lattice.points(indices)
    keep = ((centres >= margin) & (centres <= np.array(lattice.image_size) - 1 - margin)).all(1)
    return indices[keep], centres[keep]


def sample_mask(number: int, share: float) -> NDArray[np.bool_]:
    """(n,) which of so many lenses are this share of them, evenly spread."""
    place = np.arange(number) * _GOLDEN
    # A remainder takes NumPy twenty times as long.
    place -= np.floor(place)
    return place < share


def _chosen(number: int, wanted: float) -> NDArray[np.int64]:
    """Rows of so many, evenly spread."""
    return np.flatnonzero(sample_mask(number, wanted / max(number, 1)))


@dataclass(frozen=True)
class StackedCrops:
    """Parts of a flat, all of one size and none upon another, below each other in one picture.

    Parameters
    ----------
    picture : (m * height, width) float32
    corners : (m, 2) int64 [px]
        Flat coordinates x, y of the first pixel of each part.
    size : (int, int) [px]
        Width and height of a part.
    """

    picture: NDArray[np.float32]
    corners: NDArray[np.int64]
    size: tuple[int, int]

    @classmethod
    def whole(cls, picture: NDArray[np.float32]) -> StackedCrops:
        """A flat as its only part."""
        return cls(picture, np.zeros((1, 2), np.int64), (picture.shape[1], picture.shape[0]))

    @classmethod
    def of(cls, picture: NDArray[np.float32] | StackedCrops) -> StackedCrops:
        """Parts as they are, or a whole flat."""
        return picture if isinstance(picture, StackedCrops) else cls.whole(picture)

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """(m, 2) what places of the flat are more than those of the picture, in each part [px]."""
        down = np.arange(len(self)) * self.size[1]
        return self.corners - np.column_stack([np.zeros_like(down), down])

    def part(self, number: int) -> NDArray[np.float32]:
        """(height, width) view of one part."""
        return self.picture[number * self.size[1] : (number + 1) * self.size[1]]

    def lenses(
        self, lattice: Lattice, margin: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Lenses at least `margin` px inside a part.

        Returns
        -------
        indices : (n, 2) int64
        centres : (n, 2) float64 [px]
            On the flat.
        part : (n,) int64
            That they are in; places of the flat lie at `offsets[part]` less in the picture.
        """
        if self.size == lattice.image_size:
            whole = select_whole_lenses(lattice, margin)
            return (*whole, np.zeros(len(whole[0]), np.int64))
        found = [
            _inside(lattice, corner + margin, corner + np.array(self.size) - 1 - margin) for corner in self.corners
        ]
        part = np.repeat(np.arange(len(self)), [len(index) for index in found])
        indices = np.concatenate(found)
        return indices, lattice.points(indices), part


def _inside(lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 2) indices of the lenses with centres in a rectangle."""
    share = np.linspace(0, 1, _ALONG)
    x, y = np.meshgrid(*(low[axis] + share * (high[axis] - low[axis]) for axis in (0, 1)))
    bounds = lattice.to_index(np.column_stack([x.ravel(), y.ravel()]))
    least, most = np.floor(bounds.min(0)).astype(np.int64) - 1, np.ceil(bounds.max(0)).astype(np.int64) + 1
    i, j = np.meshgrid(np.arange(least[0], most[0] + 1), np.arange(least[1], most[1] + 1))
    index = np.column_stack([i.ravel(), j.ravel()])
    centres = lattice.points(index)
    return index[((centres >= low) & (centres <= high)).all(1)]
