"""Pixels of many lenses, and profiles of microimages: averages at samples `0, step, 2 * step, ...`.

A profile is over the distance from the centre, or from a middle line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..lattice.cell import Cell
from ..runtime.arrays import Array, Floats, Integers

__all__ = ["LensPixels", "ProfilePlaces", "average_profile", "estimate_variance"]

# Samples with a smaller share of the pixels of the fullest one are interpolated.
_FEW_PIXELS = 1e-3
# Samples over which variances are averaged, and pixels of the variance of all that count with them.
_NEAR = 5
_COMMON_PIXELS = 10


class LensPixels(NamedTuple):
    """Pixels (p,) of the cells of lenses (n,)."""

    lens: Integers  # (p,) which a pixel belongs to
    x: Floats  # (p,) [px] from its centre
    y: Floats  # (p,) [px]
    value: Floats  # (p,)

    @classmethod
    def of(
        cls,
        picture: Array,
        places: Floats,
        cell: Cell,
        stride: tuple[int, int] = (1, 1),
        border: float = 0.5,
    ) -> LensPixels:
        """Those of cells about `places` (n, 2) [px] that lie inside a picture (h, w).

        Of a cell every so many columns and rows are taken, other ones in each lens. At a `border`
        above 0.5, cells are that much wider [cell].
        """
        reach = 2 * border * cell.circumradius
        number = np.arange(len(places))
        begin = np.ceil(places - reach).astype(int)
        begin += np.column_stack([number // stride[0] % stride[0], number % stride[1]])
        side = int(2 * reach) + 1
        x, y = (begin[:, way, None] + np.arange(0, side, stride[way]) for way in (0, 1))
        dx = x - places[:, :1]
        dy = y - places[:, 1:]
        height, width = picture.shape
        inside = ((x >= 0) & (x < width))[:, None, :] & ((y >= 0) & (y < height))[:, :, None]
        for across, down in cell.normals:
            inside &= (across * dx)[:, None, :] + (down * dy)[:, :, None] <= border
        lens, row, column = np.nonzero(inside)
        value = picture[y[lens, row], x[lens, column]].astype(np.float64)
        return cls(lens, dx[lens, column], dy[lens, row], value)

    def select(self, pixels: Array) -> LensPixels:
        """Some of the pixels."""
        lens, *rest = self
        return LensPixels(lens[pixels], *(values[pixels] for values in rest))

    def distance(self) -> Floats:
        """(p,) [px] from the centres."""
        return np.hypot(self.x, self.y)


class ProfilePlaces(NamedTuple):
    """Places of pixels (p,) between the samples of a profile."""

    before: Integers  # (p,) sample before each pixel
    part: Array  # (p,) how far it lies towards the next one; 1 beyond the last one

    @classmethod
    def of(cls, place: Array, count: int) -> ProfilePlaces:
        """Those at distances `place` (p,) [samples] on a profile of `count` samples."""
        before = np.minimum(place.astype(np.int64), count - 2)
        return cls(before, np.minimum(place - before, 1.0))

    def select(self, pixels: Integers) -> ProfilePlaces:
        """Some of the pixels."""
        return ProfilePlaces(self.before[pixels], self.part[pixels])

    def add(self, values: Array, count: int, first: Integers | int = 0) -> Array:
        """(count,) sums of values (p,), shared between the samples beside each pixel.

        `first` (p,) is where the profile of each pixel begins, if there are several.
        """
        before = self.before + first
        sums: Array = np.bincount(before, values * (1 - self.part), count)
        return sums + np.bincount(before + 1, values * self.part, count)

    def read(self, profile: Array) -> Array:
        """(p,) values of a profile (count,) at the pixels."""
        start = profile[self.before]
        return np.asarray(start + (profile[self.before + 1] - start) * self.part)


def average_profile(total: Array, number: Array) -> Floats:
    """(k,) mean of the pixels at each sample, from their sum and number (k,).

    Samples with hardly a pixel are interpolated. At least one needs pixels.
    """
    filled = np.flatnonzero(number > _FEW_PIXELS * number.max())
    return np.interp(np.arange(len(number)), filled, total[filled] / number[filled])


def estimate_variance(squares: Array, number: Array) -> Array:
    """(k,) variance of a pixel at each sample, from sums of squares and numbers of pixels (k,)."""
    near = np.ones(_NEAR)
    common = _COMMON_PIXELS * squares.sum() / max(number.sum(), 1)
    total = np.convolve(squares, near, "same") + common
    return np.asarray(total / (np.convolve(number, near, "same") + _COMMON_PIXELS))
