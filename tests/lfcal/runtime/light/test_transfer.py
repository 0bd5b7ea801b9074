"""The transfer function of a disc is that of Bessel functions, and of a drawn disc."""

from __future__ import annotations

import numpy as np
from scipy.special import j1

from lfcal.runtime.light.transfer import disc_transfer


def test_it_is_the_bessel_function():
    for most in (0.5, 6.0, 20.0, 200.0):
        periods = np.linspace(1e-6, most, 501)
        expected = 2 * j1(np.pi * periods) / (np.pi * periods)
        np.testing.assert_allclose(disc_transfer(periods), expected, rtol=0, atol=1e-12)


def test_it_is_one_at_no_frequency_whatever_the_shape():
    assert disc_transfer(np.zeros((2, 3))).shape == (2, 3)
    np.testing.assert_allclose(disc_transfer(np.zeros((2, 3))), 1.0, rtol=0, atol=1e-15)


def test_it_vanishes_where_an_airy_disc_does():
    assert abs(disc_transfer(np.array([1.21966989])).item()) < 1e-7
