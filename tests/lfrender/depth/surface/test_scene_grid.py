"""The grid of scene points, and the lens nearest to each."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfrender.depth.surface.scene_grid import grid_shape, lens_at, scene_grid
from lfrender.flat.distorted_lookup import nearest_index

LATTICE = Lattice(np.array([7.0, 4.0]), np.array([[19.0, 5.0], [5.2, 18.9]]), (300, 220), 7.0)


def test_the_grid_covers_the_flat_with_so_many_values_per_pitch():
    shape, first, spacing = grid_shape(LATTICE, 7)
    assert spacing == LATTICE.pitch / 7
    last = np.array(first) + spacing * (np.array(shape[::-1]) - 1)
    size = np.array(LATTICE.image_size)
    assert (last >= size - 0.5).all() and (last < size + 2 * spacing).all()


def test_the_lens_of_a_point_is_the_one_whose_cell_it_lies_in():
    grid = scene_grid(LATTICE, -0.5, 2.9)
    index = {tuple(ij): row for row, ij in enumerate(LATTICE.indices().tolist())}
    for v, u in np.random.default_rng(1).integers(0, 75, (200, 2)):
        point = np.array([[grid.first + 2.9 * u, grid.first + 2.9 * v]])
        place = LATTICE.to_index(point)[0]
        i, j = np.rint(place).astype(int)
        if np.abs(np.abs(place - (i, j)) - 0.5).min() < 1e-9:
            continue  # on the border of two cells, rounding decides
        assert tuple(map(int, nearest_index(*point[0], grid.origin, grid.inverse, grid.bend, grid.bend_low))) == (i, j)
        assert lens_at(grid.rows, grid.low, i, j) == index.get((i, j), -1)
