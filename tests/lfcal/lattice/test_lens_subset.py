"""Lenses of parts of a flat, and samples of lenses."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.distortion import Distortion
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.lens_subset import (
    StackedCrops,
    neighbour_rows,
    sample_lenses,
)


def test_neighbours_of_lenses_are_those_a_step_away():
    indices = np.array([[4, -2], [5, -2], [4, -1], [9, 9]])
    rows = neighbour_rows(indices, np.array([[1, 0], [0, -1], [-1, 1]]))
    np.testing.assert_array_equal(rows, [[1, -1, -1, -1], [-1, -1, 0, -1], [-1, 2, -1, -1]])


@pytest.mark.parametrize("size", [(400, 300), (2400, 1800)])
def test_sampled_lenses_are_whole_and_spread_over_every_period(size):
    lattice = Lattice([3.0, 2.0], [[6.1, 0.2], [2.9, 5.4]], size, 3.0)
    every, _ = lattice.select_whole(5.0)
    indices, centres = sample_lenses(lattice, 5.0, 2400.0)
    np.testing.assert_allclose(centres, lattice.points(indices), atol=1e-9)
    assert {tuple(ij) for ij in indices.tolist()} <= {tuple(ij) for ij in every.tolist()}
    assert len(indices) == pytest.approx(2400, rel=0.02)
    for period in (2, 3):
        kinds = np.bincount(indices[:, 0] % period * period + indices[:, 1] % period)
        np.testing.assert_allclose(kinds, len(indices) / period**2, rtol=0.1)


def test_lenses_of_parts_are_those_of_the_flat_well_inside_them():
    bend = Distortion([400.0, 300.0], 0.01, 0.0, 500.0)
    whole = Lattice([400.3, 300.2], [[9.1, 0.4], [4.2, 8.3]], (800, 600), 4.0, bend)
    picture = np.arange(800.0 * 600, dtype=np.float32).reshape(600, 800)
    corners = np.array([(0, 0), (500, 20), (640, 440)])
    parts = StackedCrops(
        np.concatenate([picture[y : y + 160, x : x + 160] for x, y in corners]), corners, (160, 160)
    )
    indices, centres, part = parts.lenses(whole, 7.0)
    every, places = whole.select_whole(7.0)
    inside = [((places >= c + 7) & (places <= c + 159 - 7)).all(1) for c in corners]
    np.testing.assert_array_equal(indices, np.concatenate([every[mask] for mask in inside]))
    at = np.rint(centres).astype(int)
    there = at - parts.offsets[part]
    np.testing.assert_array_equal(
        parts.picture[there[:, 1], there[:, 0]], picture[at[:, 1], at[:, 0]]
    )
