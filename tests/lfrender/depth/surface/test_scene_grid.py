"""Lenses looked up by their place, and the grid of scene points."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.surface.scene_grid import grid_shape, lens_array, lens_at

LATTICE = Lattice([31.0, 27.0], [[20.0, 0.0], [10.0, 17.3]], (200, 160), 9.0)


@pytest.mark.parametrize("cells", [5, 7])
def test_the_grid_covers_the_flat_with_so_many_points_a_pitch(cells):
    (rows, columns), first, spacing = grid_shape(LATTICE, cells)
    assert spacing == pytest.approx(LATTICE.pitch / cells)
    assert first == (-0.5, -0.5)
    assert first[0] + (columns - 2) * spacing < 199.5 <= first[0] + (columns - 1) * spacing + 1e-6
    assert first[1] + (rows - 2) * spacing < 159.5 <= first[1] + (rows - 1) * spacing + 1e-6


def test_a_ring_holds_the_lens_itself_and_all_within_two_pitches_in_order():
    lenses = lens_array(LATTICE, 1.0, 9.0)
    steps = lenses.ring @ LATTICE.basis
    distance = np.hypot(*steps.T)
    assert (lenses.ring[0] == 0).all()
    assert (np.diff(distance) > -1e-6).all()
    # A hexagonal lattice has 1 + 6 + 12 lenses within 2.2 pitches.
    assert len(lenses.ring) == 19
    assert distance.max() < 2.2 * LATTICE.pitch


def test_lenses_are_found_by_their_indices_and_none_beyond_the_flat():
    lenses = lens_array(LATTICE, 1.0, 9.0)
    for row in (0, 7, len(lenses.centres) - 1):
        i, j = lenses.indices[row]
        assert lens_at(lenses.rows, lenses.low, i, j) == row
    low = lenses.indices.min(0)
    high = lenses.indices.max(0)
    assert lens_at(lenses.rows, lenses.low, low[0] - 1, low[1]) == -1
    assert lens_at(lenses.rows, lenses.low, high[0], high[1] + 1) == -1
