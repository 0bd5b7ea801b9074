"""Profiles of microimages: averages over many pixels, at samples `0, step, 2 * step, ...`.

A profile is over the distance from the centre, or from a middle line.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Array, Floats, Integers

__all__ = ["ProfilePlaces", "average_profile", "estimate_variance"]

# Samples with a smaller share of the pixels of the fullest one are interpolated.
_FEW_PIXELS = 1e-3
# Samples over which variances are averaged, and pixels of the variance of all that count with them.
_NEAR = 5
_COMMON_PIXELS = 10


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
