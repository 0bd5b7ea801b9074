"""Lit lenses: dark ones and their neighbours are left out."""

import numpy as np

from lfcal import Lattice
from lfcal.lattice.lens_subset import StackedCrops
from lfcal.lattice.lit_lenses import LitLenses

_PITCH = 10.0


def _flat() -> tuple[StackedCrops, Lattice]:
    """400 x 300 px of round microimages, those left of x = 150 px unlit."""
    lattice = Lattice([5.0, 5.0], [[_PITCH, 0.0], [0.0, _PITCH]], (400, 300), 4.0)
    y, x = np.mgrid[:300, :400]
    far = np.hypot((x - 5 + 5) % _PITCH - 5, (y - 5 + 5) % _PITCH - 5)
    light = np.where((far < 4) & (x > 150), 1.0, 0.02)
    return StackedCrops.of(np.sqrt(light).astype(np.float32)), lattice


def test_dark_lenses_and_their_neighbours_are_left_out():
    tones, lattice = _flat()
    lit = LitLenses.find(tones, lattice, 7.0, 0.2)
    # The first lit column is at 155 px, the one next to the dark ones.
    assert lattice.points(lit.indices)[:, 0].min() == 165
    assert len(lit.indices) == 23 * 28
