"""What lenses cost with all their neighbours."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfrender.depth.matching.sgm import average_pair_costs
from lfrender.flat.lens_graph import opposite_neighbours


def test_costs_of_some_lenses_are_means_over_the_pairs_with_their_neighbours():
    lattice = Lattice(np.array([9.0, 9.0]), np.array([[20.0, 0.0], [10.0, 17.3]]), (160, 120), 9.0)
    forward, backward = opposite_neighbours(lattice)
    rng = np.random.default_rng(3)
    pair = rng.random((len(lattice), forward.shape[1], 5), np.float32)
    wanted = rng.random(len(lattice)) < 0.3
    expected = []
    for lens in np.flatnonzero(wanted):
        own = [pair[lens, d] for d in range(forward.shape[1]) if forward[lens, d] >= 0]
        theirs = [pair[other, d] for d, other in enumerate(backward[lens]) if other >= 0]
        expected.append(np.mean(own + theirs, axis=0))
    found = average_pair_costs(pair, forward, backward, wanted)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    np.testing.assert_array_equal(found, average_pair_costs(pair, forward, backward)[wanted])
