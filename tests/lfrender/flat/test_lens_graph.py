import numpy as np
import pytest

from data_synth import Camera
from lfrender.flat.lens_graph import distant_rings, neighbour_rows, two_rings


def cameras(kind):
    lattice = Camera.design((600, 450), 20.0, kind).lattice
    return lattice, lattice.centres().astype(np.float32), neighbour_rows(lattice, lattice.steps)


@pytest.mark.parametrize("kind, count", [("hex", 18), ("square", 12)])
def test_two_rings_hold_every_lens_once(kind, count):
    lattice, centres, neighbours = cameras(kind)
    rings = two_rings(neighbours)
    assert rings.shape[1] == neighbours.shape[1] * 3
    apart = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1)) / lattice.pitch
    for lens, rows in enumerate(rings):
        found = rows[rows >= 0]
        assert len(np.unique(found)) == len(found) <= count and lens not in found
        # All lenses that near, but for those at corners of the flat that are reached over none.
        near = np.flatnonzero((apart[lens] < 2.1) & (apart[lens] > 0))
        assert set(found) <= set(near)
    inner = (neighbours >= 0).all(1) & (neighbours >= 0).all(1)[neighbours].all(1)
    assert ((rings[inner] >= 0).sum(1) == count).all()


@pytest.mark.parametrize("kind", ["hex", "square"])
def test_rings_afar_are_those_of_every_third_lens(kind):
    lattice, centres, neighbours = cameras(kind)
    far, indices = distant_rings(neighbours), lattice.indices()

    def steps(lens, rows):
        return {tuple(step.tolist()) for step in indices[rows[lens][rows[lens] >= 0]] - indices[lens]}

    middle = int(np.hypot(*(centres - (300, 225)).T).argmin())
    third = {(3 * i, 3 * j) for i, j in steps(middle, two_rings(neighbours))}
    assert steps(middle, far) == third
    assert all(steps(lens, far) <= third for lens in range(len(far)))
