"""Lit lenses: dark ones and their neighbours are left out; found once for lattices with the same centres."""

from dataclasses import replace

import numpy as np

from lfcal import Lattice
from lfcal.lattice import lit_lenses
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
    lit = LitLenses.find(tones, lattice, 7.0, 0.2, None)
    # The first lit column is at 155 px, the one next to the dark ones.
    assert lattice.points(lit.indices)[:, 0].min() == 165
    assert len(lit.indices) == 23 * 28


def test_lit_lenses_are_reused_until_the_lattice_moves_by_a_fiftieth_of_the_pitch():
    tones, lattice = _flat()
    before = LitLenses.find(tones, lattice, 7.0, 0.2, None)
    near = replace(lattice, origin=lattice.origin + 0.015 * _PITCH)
    assert LitLenses.find(tones, near, 7.0, 0.2, before) is not before
    near = replace(lattice, origin=lattice.origin + np.array([0.015 * _PITCH, 0]))
    assert LitLenses.find(tones, near, 7.0, 0.2, before) is before
    # The step adds up over 40 lenses.
    stretched = replace(lattice, basis=lattice.basis * 1.001)
    assert LitLenses.find(tones, stretched, 7.0, 0.2, before) is not before


def _many(dark: float) -> tuple[StackedCrops, Lattice]:
    """1200 x 1000 px of 12000 round microimages, those left of x = `dark` px unlit."""
    lattice = Lattice([5.0, 5.0], [[_PITCH, 0.0], [0.0, _PITCH]], (1200, 1000), 4.0)
    y, x = np.mgrid[:1000, :1200]
    far = np.hypot(x % _PITCH - 5, y % _PITCH - 5)
    return StackedCrops.of(np.sqrt(np.where((far < 4) & (x > dark), 1.0, 0.02)).astype(np.float32)), lattice


def test_a_sample_of_many_lenses_is_measured_and_all_of_them_only_if_it_has_dark_ones(monkeypatch):
    measured = []
    original = lit_lenses.find_lit_lenses
    monkeypatch.setattr(lit_lenses, "find_lit_lenses", lambda *of: (measured.append(len(of[2])), original(*of))[1])
    tones, lattice = _many(dark=0)
    lit = LitLenses.find(tones, lattice, 7.0, 0.2, None)
    assert len(lit.indices) == 12_000
    assert sum(measured) < 5500
    # Those at the border are left out when some are chosen.
    assert len(lit.select(tones, lattice, 7.0, np.ones(12_000, bool)).indices) == 118 * 98
    tones, lattice = _many(dark=20)
    lit = LitLenses.find(tones, lattice, 7.0, 0.2, None)
    # Two columns of 120 are dark, and their neighbours are left out.
    assert lattice.points(lit.indices)[:, 0].min() == 35
    assert len(lit.indices) == 116 * 98
