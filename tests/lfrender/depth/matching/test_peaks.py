"""Unresolved lenses are filled from their surroundings."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfrender.depth.matching.peaks import fill_unresolved
from lfrender.flat.lens_graph import neighbour_rows


def test_guess_that_no_neighbour_has_becomes_the_depth_around_to_a_tenth_of_a_pixel():
    lattice = Lattice([10, 10], [[20, 0], [10, 17.3]], (300, 300), 9)
    neighbours = neighbour_rows(lattice, lattice.steps)
    middle = int(np.argmin(np.linalg.norm(lattice.centres() - 150, axis=1)))
    values, known = np.full(len(lattice), 6, np.float32), np.ones(len(lattice), bool)
    alone = [middle, int(neighbours[middle, 0])]
    values[alone], known[alone] = 11, False
    assert np.abs(fill_unresolved(values, known, neighbours, 1.0) - 6).max() < 0.1
