"""Lit lenses of flats."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfcal.microimage.lit import STRAY, UNLIT, bright_light, find_lit_lenses, is_lit


def test_corners_of_a_vignetted_flat_are_lit_and_places_beside_the_array_are_not():
    light = np.concatenate([np.linspace(0.05, 1, 2000), np.full(500, 0.01)])
    np.testing.assert_array_equal(is_lit(light, UNLIT), light > 0.02)
    # Beside arrays, stray light has up to a thirtieth of the light.
    assert not is_lit(np.append(np.ones(100), 0.1), STRAY)[-1]


def test_hot_pixels_do_not_make_the_lenses_dark():
    light = np.append(np.ones(1000), np.full(20, 1000.0))
    assert is_lit(light, STRAY).all()
    assert bright_light(light) == 1


def test_no_lenses_are_no_error():
    assert is_lit(np.zeros(0), STRAY).shape == (0,)


def test_dark_lenses_and_their_neighbours_are_left_out():
    # 400 x 300 px of round microimages, those left of x = 150 px unlit.
    lattice = Lattice([5.0, 5.0], [[10.0, 0.0], [0.0, 10.0]], (400, 300), 4.0)
    y, x = np.mgrid[:300, :400]
    light = np.where((np.hypot(x % 10 - 5, y % 10 - 5) < 4) & (x > 150), 1.0, 0.02)
    indices, centres = lattice.select_whole(7.0)
    lit = find_lit_lenses(np.sqrt(light).astype(np.float32), lattice, indices, centres, 0.2)
    # The first lit column is at 155 px, the one next to the dark ones.
    assert centres[lit, 0].min() == 165
    assert lit.sum() == 23 * 28
