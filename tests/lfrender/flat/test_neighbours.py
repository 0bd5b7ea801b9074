"""Neighbours of lenses, and straight rows of lenses, along which costs are aggregated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from data_synth import Camera
from lfcal import Lattice
from lfrender.flat.neighbours import neighbours_of

SQUARE = Lattice([10.3, 10.7], [[20, 1], [-1, 20]], (300, 240), 8.5)
HEXAGONAL = Lattice([10.3, 10.7], [[20, 0], [10, 17.32]], (300, 240), 8.5)


def cameras(kind):
    lattice = Camera.design((600, 450), 20.0, kind).lattice
    return lattice, lattice.centres().astype(np.float32), neighbours_of(lattice)


@pytest.mark.parametrize("kind, count", [("hex", 18), ("square", 12)])
def test_two_rings_hold_every_lens_once(kind, count):
    lattice, centres, neighbours = cameras(kind)
    rings = neighbours.two_rings
    assert rings.shape[1] == neighbours.all.shape[1] * 3
    apart = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1)) / lattice.pitch
    for lens, rows in enumerate(rings):
        found = rows[rows >= 0]
        assert len(np.unique(found)) == len(found) <= count and lens not in found
        near = np.flatnonzero((apart[lens] < 2.1) & (apart[lens] > 0))
        assert set(found) == set(near)


@pytest.mark.parametrize("kind", ["hex", "square"])
def test_distant_rings_are_those_of_every_third_lens(kind):
    lattice, centres, neighbours = cameras(kind)
    far = neighbours.distant_rings
    indices = lattice.indices()

    def steps(lens, rows):
        return {
            tuple(step.tolist()) for step in indices[rows[lens][rows[lens] >= 0]] - indices[lens]
        }

    middle = int(np.hypot(*(centres - (300, 225)).T).argmin())
    third = {(3 * i, 3 * j) for i, j in steps(middle, neighbours.two_rings)}
    assert steps(middle, far) == third
    assert all(steps(lens, far) <= third for lens in range(len(far)))


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
def test_each_lens_is_in_one_row_of_each_direction(lattice):
    neighbours = neighbours_of(lattice)
    assert len(neighbours.chains) == len(lattice.steps)
    for order, starts in neighbours.chains:
        np.testing.assert_array_equal(np.sort(order), np.arange(len(lattice)))
        assert starts[0] == 0 and starts[-1] == len(lattice)


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
def test_a_row_goes_from_border_to_border_by_one_step(lattice):
    neighbours = neighbours_of(lattice)
    opposite = np.hstack([neighbours.backward, neighbours.forward])
    directions = zip(neighbours.chains, neighbours.all.T, opposite.T, strict=True)
    for (order, starts), ahead, behind in directions:
        for first, end in pairwise(starts):
            row = order[first:end]
            assert behind[row[0]] == -1 and ahead[row[-1]] == -1
            np.testing.assert_array_equal(ahead[row[:-1]], row[1:])
