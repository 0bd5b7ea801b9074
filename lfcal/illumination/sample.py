"""Pixels of a sample of whole lenses spread over the field, which is parted into windows."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses, sample_mask

__all__ = ["Sample", "draw_sample"]

Array = NDArray[Any]


class Sample(NamedTuple):
    """Pixels (p,) of lenses (n,)."""

    lattice: Lattice
    centres: Array  # (n, 2) [px]
    window: NDArray[np.int64]  # (n,) of the field that each lens lies in
    lens: NDArray[np.int64]  # (p,) which a pixel belongs to
    x: Array  # (p,) [px] from its centre
    y: Array  # (p,) [px]
    value: Array  # (p,) luminance

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.window.max()) + 1

    @property
    def middle(self) -> Array:
        """(windows, 2) mean centre [px] of the lenses of each window, of which each has some."""
        count = np.bincount(self.window)
        return np.stack([np.bincount(self.window, self.centres[:, axis]) / count for axis in (0, 1)], axis=1)

    def evaluate(self, gain: GainMap) -> Array:
        """(3, p) relative light of each pixel, distance on the profile [px], share not cut off."""
        return gain.evaluate(gain.describe(self.centres, self.lattice), self.lens, self.x, self.y)

    def select(self, pixels: NDArray[np.int64]) -> Sample:
        """Some of the pixels."""
        return self._replace(lens=self.lens[pixels], x=self.x[pixels], y=self.y[pixels], value=self.value[pixels])

    def add(self, values: Array) -> Array:
        """(n,) sums over the pixels of each lens."""
        return np.bincount(self.lens, values, len(self.centres))


def draw_sample(lattice: Lattice, picture: NDArray[np.float32] | StackedCrops, pixels: float, scene: bool) -> Sample:
    """Sample of the lenses of a flat, or of crops of it, with about so many pixels, but 200 lenses at least.

    `picture` is the square root of the luminance. Of large lenses rows and columns are left out, so that 700 pixels of
    each remain, of scenes 350, as their content differs little from row to row. The field has 8 x 6 windows, or fewer,
    so that six lenses fall into each.
    """
    crops, cell = StackedCrops.of(picture), Cell.of(lattice)
    area = abs(float(np.linalg.det(lattice.basis)))
    stride = max(1, int(math.sqrt(area / 700)))
    margin, wanted = cell.circumradius + 1, max(pixels * stride**2 / area, 200)
    if crops.size == lattice.image_size:
        places = centres = sample_lenses(lattice, margin, wanted)[1]
    else:
        _, centres, crop = crops.lenses(lattice, margin)
        chosen = sample_mask(len(centres), wanted / max(len(centres), 1))
        centres, places = centres[chosen], (centres - crops.offsets[crop])[chosen]
    shrink = min(1.0, math.sqrt(len(centres) / (6 * 8 * 6)))
    shape = np.maximum(1, np.array([8, 6]) * shrink).astype(int)
    column, row = np.minimum((centres + 0.5) / lattice.image_size * shape, shape - 1).astype(int).T
    window = np.unique(row * shape[0] + column, return_inverse=True)[1].ravel()
    # Other pixels are left out in each lens.
    rows, number = stride * (1 + scene), np.arange(len(places))
    first = np.ceil(places - cell.circumradius).astype(int) + np.column_stack(
        [number // stride % stride, number % rows]
    )
    side = int(2 * cell.circumradius) + 1
    x, y = (first[:, axis, None] + np.arange(0, side, step) for axis, step in ((0, stride), (1, rows)))
    dx, dy = x - places[:, :1], y - places[:, 1:]
    inside = np.ones((len(places), y.shape[1], x.shape[1]), np.bool_)
    for across, down in cell.normals:
        inside &= (across * dx)[:, None, :] + (down * dy)[:, :, None] <= 0.5
    lens, row, column = np.nonzero(inside)
    value = crops.picture[y[lens, row], x[lens, column]].astype(np.float64) ** 2
    return Sample(lattice, centres, window, lens, dx[lens, column], dy[lens, row], value)
