"""The polynomial through the light of lenses, and its slope."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfcal.gain.gain_map import field_place
from lfcal.gain.light_polynomial import fit_light, fit_light_slope

_LATTICE = Lattice([10, 10], [[20, 0], [0, 20]], (1000, 800), 9)


def _light(points):
    x, y = field_place(points, _LATTICE).T
    return np.exp(0.3 * x - 0.2 * y - 0.8 * (x * x + y * y) + 0.1 * x * y * y)


def test_slope_is_that_of_the_light_even_if_a_tenth_of_the_lenses_are_dusty():
    centres = _LATTICE.centres()
    light = _light(centres)
    rng = np.random.default_rng(5)
    dusty = rng.random(len(light)) < 0.1
    light[dusty] *= rng.uniform(0.1, 0.9, dusty.sum())
    slope = fit_light_slope(light, centres, _LATTICE)
    for axis, step in enumerate(np.eye(2)):
        true = np.log(_light(centres + step) / _light(centres - step)) / 2
        assert np.abs(slope[:, axis] - true).max() < 1e-6


def test_few_lenses_have_no_slope():
    centres = _LATTICE.centres()[:20]
    assert len(fit_light(np.ones(20), centres, _LATTICE)) == 1
    assert not fit_light_slope(_light(centres), centres, _LATTICE).any()
