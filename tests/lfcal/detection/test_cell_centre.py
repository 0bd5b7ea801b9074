"""Cells and centres: sub- and super-lattices, and lenses told from gaps."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.detection.cell_centre import choose_lens_centre, find_primitive_cell, find_round_centres
from lfcal.lattice.cell import bin_offsets

_SQUARE = np.array([[30.0, 0.0], [0.0, 30.0]])


def _disc(basis, radius, bins=36):
    return (np.linalg.norm(bin_offsets(basis, bins, np.array([0.5, 0.5]) / bins), axis=2) < radius).astype(float)


@pytest.mark.parametrize("multiple", [2, 3])
def test_cell_of_several_microimages_is_cut_down(multiple):
    one = _disc(_SQUARE, 13, 36 // multiple)
    found = find_primitive_cell([np.tile(one, (multiple, multiple))], _SQUARE * multiple)
    assert abs(np.linalg.det(found)) == pytest.approx(900)


def test_cell_of_one_microimage_is_kept():
    np.testing.assert_array_equal(find_primitive_cell([_disc(_SQUARE, 13)], _SQUARE), _SQUARE)


def test_lenses_and_gaps_in_turn_are_not_one_lattice():
    # Half of a square array: what repeats at (1/2, 1/2) is a gap, not a lens.
    wide = np.array([[60.0, 0.0], [0.0, 60.0]])
    cell = _disc(wide, 20)
    np.testing.assert_array_equal(find_primitive_cell([cell], wide), wide)


def test_round_centre_is_found_to_a_bin():
    cell = np.roll(_disc(_SQUARE, 12), (7, 20), axis=(0, 1))
    best = find_round_centres([cell], _SQUARE)[0]
    np.testing.assert_allclose(best.position, np.array([20.5, 7.5]) / 36)
    assert best.roundness > 0.9


def test_dark_gap_as_round_as_a_lens_is_no_lens():
    # Overlapping discs of a square array leave gaps rounder than the lenses themselves.
    gap = np.roll(_disc(_SQUARE, 6), (18, 18), axis=(0, 1))
    light = 1.0 - 0.9 * gap
    guesses = find_round_centres([light], _SQUARE)
    best = choose_lens_centre(guesses, light, _SQUARE)
    assert np.abs((best.position - 0.5 / 36 + 0.5) % 1 - 0.5).max() < 0.05


def test_rows_far_stronger_than_lenses_in_a_row_do_not_hide_their_period():
    # Rows differ ten times as much as the lenses in a row: shifted along the row the cell is almost the same.
    y, x = np.mgrid[:36, :36] * 2 * np.pi / 36
    np.testing.assert_array_equal(find_primitive_cell([10 * np.cos(y) + np.cos(x)], _SQUARE), _SQUARE)


def test_noise_along_a_row_is_no_longer_period():
    rng = np.random.default_rng(0)
    one = np.tile(_disc(_SQUARE, 6, 12), (3, 3))
    first, second = (one + rng.standard_normal(one.shape) for _ in range(2))
    assert abs(np.linalg.det(find_primitive_cell([first], _SQUARE * 3, [second]))) == pytest.approx(900)
