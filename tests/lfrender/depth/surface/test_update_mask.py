"""Scene points to compute anew: compared with the nearest lens of each point, one by one."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.surface.scene_grid import scene_grid
from lfrender.depth.surface.update_mask import mark_changed_points
from lfrender.flat.distorted_lookup import lens_displacements, nearest_index
from lfrender.flat.lens_graph import neighbour_rows

BASES = {
    "square": [[20.0, 0.4], [-0.4, 20.0]],
    "hexagonal": [[19.0, 5.0], [5.2, 18.9]],
    "oblong": [[31.0, 3.0], [-9.0, 14.0]],
}
RING = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3)])


@pytest.mark.parametrize("basis", BASES)
@pytest.mark.parametrize("spacing", [2.9, 5.8])
def test_points_of_changed_lenses_and_beyond_the_border_next_to_them_are_marked(basis, spacing):
    lattice = Lattice(np.array([7.0, 4.0]), np.array(BASES[basis]), (300, 220), 7.0)
    indices, around = lattice.indices(), neighbour_rows(lattice, RING)
    unchanged = np.random.default_rng(4).random(len(indices)) > 0.1
    grid, bend = scene_grid(lattice, -0.5, spacing), lens_displacements(lattice)
    found = np.empty((int(230 / spacing), int(310 / spacing)), bool)
    centres = lattice.centres().astype(np.float32)
    mark_changed_points(unchanged, centres, indices, around, RING, grid, found)
    place = {tuple(index): row for row, index in enumerate(indices.tolist())}
    for v, u in np.ndindex(found.shape):
        i, j = map(int, nearest_index(u * spacing - 0.5, v * spacing - 0.5, lattice.origin, grid.inverse, *bend))
        lens = place.get((i, j))
        near = [place[i + a, j + b] for a, b in RING.tolist() if (i + a, j + b) in place]
        assert found[v, u] == (not unchanged[near].all() if lens is None else not unchanged[lens])
    assert 0.02 < found.mean() < 0.5
