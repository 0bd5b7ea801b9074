"""Neighbours of lenses."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import Camera
from lfrender.flat.lens_graph import nearest_lens
from lfrender.flat.neighbours import neighbours_of


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
        # All lenses that near, except at corners of the flat, where no neighbour leads to them.
        near = np.flatnonzero((apart[lens] < 2.1) & (apart[lens] > 0))
        assert set(found) <= set(near)
    complete = (neighbours.all >= 0).all(1)
    inner = complete & complete[neighbours.all].all(1)
    assert ((rings[inner] >= 0).sum(1) == count).all()


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


def test_nearest_lens_of_each_centre_is_itself():
    lattice = cameras("hex")[0]
    centres = lattice.centres()
    offset = np.random.default_rng(0).uniform(-5, 5, centres.shape)
    np.testing.assert_array_equal(nearest_lens(centres, centres + offset), np.arange(len(centres)))
