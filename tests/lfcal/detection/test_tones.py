"""Tones of microimages."""

import numpy as np

from lfcal.detection.tones import measure_tones
from lfcal.lattice.lattice import Lattice


def test_noise_inside_lenses_is_no_difference_of_their_tones():
    lattice = Lattice(np.array([12.0, 12.0]), 24.0 * np.eye(2), (480, 480), 12.0)
    noise = np.random.default_rng(0).normal(0, 0.1, (480, 480)).astype(np.float32)
    tones = measure_tones(0.3 + noise, lattice)
    assert tones.inside > np.log(0.25)
    assert tones.between < np.log(0.03)
    assert tones.unlike < 0.05


def test_tiles_differ_in_tone_beyond_noise():
    lattice = Lattice(np.array([12.0, 12.0]), 24.0 * np.eye(2), (480, 480), 12.0)
    rng = np.random.default_rng(0)
    tiles = np.kron(rng.uniform(0.3, 0.8, (20, 20)), np.ones((24, 24)))
    tones = measure_tones((tiles + rng.normal(0, 0.01, tiles.shape)).astype(np.float32), lattice)
    assert tones.between > np.log(0.1)
    assert tones.unlike > 0.3


def test_lenses_that_are_dark_but_for_a_few_pixels_have_finite_tones():
    lattice = Lattice(np.array([12.0, 12.0]), 24.0 * np.eye(2), (480, 480), 12.0)
    picture = (np.random.default_rng(0).random((480, 480)) < 0.05).astype(np.float32)
    assert np.isfinite(measure_tones(picture, lattice)).all()
