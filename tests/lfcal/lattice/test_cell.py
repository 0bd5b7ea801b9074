"""Cells of lenses."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.white_images import WhiteImage
from lfcal.lattice.cell import Cell, is_outside_cell, nearest_lenses, row_interval
from lfcal.lattice.lattice import Lattice


@pytest.mark.parametrize(
    ("shape", "degrees"), [("hexagonal", 0.0), ("hexagonal", 17.0), ("square", 0.0), ("square", 40)]
)
def test_rows_of_a_cell_end_where_its_sides_are(shape, degrees):
    truth = WhiteImage(shape, 13.7, degrees, size=(200, 200))
    cell = Cell.of(Lattice(truth.origin, truth.basis, truth.size, 6.0))
    sides = cell.row_bounds()
    faces = cell.normals
    reach = cell.circumradius
    inside = 0
    for dy in np.arange(-reach - 1, reach + 1, 0.37):
        low, high = row_interval(dy, sides)
        for dx in np.arange(-reach - 1, reach + 1, 0.37):
            here = sides[6, 0] <= dy <= sides[6, 1] and low <= dx <= high
            assert here == (not is_outside_cell(dx, dy, faces))
            inside += here
    assert inside * 0.37**2 == pytest.approx(abs(np.linalg.det(truth.basis)), rel=0.03)


def test_nearest_lenses_are_those_of_all_around():
    lattice = Lattice([3.0, 2.0], [[9.0, 1.0], [4.0, 8.0]], (120, 100), 4.0)
    places = np.random.default_rng(2).uniform(0, 100, (200, 2))
    index = np.stack(np.meshgrid(np.arange(-30, 30), np.arange(-30, 30)), -1).reshape(-1, 2)
    away = np.hypot(*(lattice.points(index) - places[:, None]).transpose(2, 0, 1))
    np.testing.assert_array_equal(nearest_lenses(lattice, places), index[away.argmin(1)])
