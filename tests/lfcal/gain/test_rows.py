"""Gain of all pixels, from lens to lens along rows."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal.gain.gain_map import GainMap
from lfcal.gain.rows import RegionGain
from lfcal.lattice.distortion import Distortion


def test_gain_of_a_distorted_lattice_is_that_of_the_nearest_lens():

    size = (300, 240)
    general = np.zeros((2, 7))
    general[0, 2], general[1, 0] = 6.0, -5.0
    bend = Distortion(np.array([150.0, 120.0]), 0.01, 0.0, 192.0, general, np.array([150.0, 120.0]))
    lattice = lfcal.Lattice((12.0, 9.0), np.array([[15.2, 0.4], [7.2, 13.3]]), size, 7.0, bend)
    profile = np.linspace(1.0, 0.3, 64)
    gain = RegionGain(GainMap.round(profile, 0.25, 7.0), lattice).at(0, 0, *size)
    y, x = np.mgrid[: size[1], : size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    i, j = np.meshgrid(np.arange(-20, 40), np.arange(-10, 40))
    centres = lattice.points(np.column_stack([i.ravel(), j.ravel()]))
    far = np.full(len(points), np.inf)
    for centre in centres[((centres > -20) & (centres < np.array(size) + 20)).all(1)]:
        far = np.minimum(far, np.hypot(*(points - centre).T))
    expected = np.interp(far, np.arange(64) * 0.25, profile).reshape(gain.shape)
    np.testing.assert_allclose(gain, expected, atol=1e-6)
