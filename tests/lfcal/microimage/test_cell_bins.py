"""Places of pixels in the cells of a lattice."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.cell import Cell
from lfcal.microimage.cell_bins import CellGrid, gather_pixels

from ._dots import LATTICE

_BINS = 7


def _gather(picture: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    grid = CellGrid.of(LATTICE, Cell.of(LATTICE), stride, _BINS)
    place = np.zeros(grid.room, np.uint32)
    values = np.zeros(grid.room, np.float32)
    x, y = LATTICE.points(np.array([[5, 5]]))[0]
    number = gather_pixels(picture, x, y, 0, grid.sides, grid.inverse, stride, _BINS, place, values)
    return place[:number], values[:number]


def test_pixels_of_a_cell_are_all_those_nearest_to_its_centre():
    pixels = np.arange(240 * 300, dtype=np.float32).reshape(240, 300)
    _, values = _gather(pixels, 1)
    y, x = np.mgrid[:240, :300]
    far = np.linalg.norm(LATTICE.centres()[:, None] - np.stack([x, y], -1).reshape(-1, 2), axis=2)
    own = LATTICE.indices().tolist().index([5, 5])
    np.testing.assert_array_equal(np.sort(values), np.flatnonzero(far.argmin(0) == own))


@pytest.mark.parametrize("stride", [1, 3])
def test_bins_are_those_of_the_lattice_coordinates(stride):
    pixels = np.arange(240 * 300, dtype=np.float32).reshape(240, 300)
    place, values = _gather(pixels, stride)
    row, column = np.divmod(values.astype(int), 300)
    offset = LATTICE.to_index(np.column_stack([column, row])) + 0.5 / _BINS
    expected = np.floor(offset % 1 * _BINS).astype(int)
    np.testing.assert_array_equal(place, expected[:, 1] * _BINS + expected[:, 0])
    assert len(place) == pytest.approx(360 / stride**2, rel=0.2)
