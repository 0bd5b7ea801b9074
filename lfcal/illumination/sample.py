"""Sample of whole lenses spread over the field, grouped by windows of it."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses, sample_mask

__all__ = ["Sample", "draw_sample"]


class Sample(NamedTuple):
    """Whole lenses, in the order of the windows of the field that they lie in.

    Parameters
    ----------
    centres, places : (n, 2) float64 [px]
        On the flat, and in the picture that is read.
    first : (b * a + 1,) int64
        Where each window begins.
    shape : (int, int)
        Rows `b` and columns `a` of windows.
    stride : int
        Step between the rows and columns of a lens that are read.
    """

    centres: NDArray[np.float64]
    places: NDArray[np.float64]
    first: NDArray[np.int64]
    shape: tuple[int, int]
    stride: int

    @property
    def middle(self) -> NDArray[np.float64]:
        """(b * a, 2) mean centre [px] of the lenses of each window."""
        return np.array([self.centres[a:b].mean(0) if b > a else (0, 0) for a, b in pairwise(self.first)])


def draw_sample(lattice: Lattice, pixels: float, crops: StackedCrops | None = None) -> Sample:
    """Sample of the lenses of a flat, or of crops of it, with about so many pixels, but 200 lenses at least.

    Of large lenses rows and columns are left out, so that 700 pixels of each remain. The field has 8 x 6 windows, or
    fewer, so that six lenses fall into each.
    """
    area = abs(float(np.linalg.det(lattice.basis)))
    stride = max(1, int(math.sqrt(area / 700)))
    margin = Cell.of(lattice).circumradius + 1
    wanted = max(pixels * stride**2 / area, 200)
    if crops is None or crops.size == lattice.image_size:
        centres = sample_lenses(lattice, margin, wanted)[1]
        places = centres
    else:
        _, centres, crop = crops.lenses(lattice, margin)
        places = centres - crops.offsets[crop]
        chosen = sample_mask(len(centres), wanted / max(len(centres), 1))
        centres, places = centres[chosen], places[chosen]
    shrink = min(1.0, math.sqrt(len(centres) / (6 * 8 * 6)))
    shape = max(1, int(6 * shrink)), max(1, int(8 * shrink))
    size = np.array(lattice.image_size)
    column, row = np.minimum((centres + 0.5) / size * shape[::-1], np.array(shape[::-1]) - 1).astype(int).T
    window = row * shape[1] + column
    order = np.argsort(window, kind="stable")
    first = np.searchsorted(window[order], np.arange(shape[0] * shape[1] + 1))
    centres, places = (np.ascontiguousarray(points[order]) for points in (centres, places))
    return Sample(centres, places, first.astype(np.int64), shape, stride)
