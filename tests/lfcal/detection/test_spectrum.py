"""Power spectra, against NumPy's Fourier transform."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.detection.spectrum import _log_power


@pytest.mark.parametrize("size", [16, 250, 512])
def test_log_power_is_that_of_the_fourier_transform(size):
    picture = np.random.default_rng(size).normal(size=(size, size)).astype(np.float32)
    wanted = np.abs(np.fft.rfft2(picture.astype(np.float64))) ** 2
    np.testing.assert_allclose(np.exp(_log_power(picture)), wanted + 1e-6, rtol=1e-4, atol=1e-5 * wanted.max())
