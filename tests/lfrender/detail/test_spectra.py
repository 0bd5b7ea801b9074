"""Noise is seen as it was in the pixels, however high the frequency."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from lfrender.detail.spectra import analysis, quiet_rings


def test_white_noise_has_its_power_in_all_rings():
    side, rng = 16, np.random.default_rng(5)
    window = analysis(side)[0]
    found = []
    for _ in range(300):
        noise, at = rng.standard_normal((side + 4, side + 4)), np.arange(2 * side) / 2
        places = np.meshgrid(at + rng.uniform(1, 2), at + rng.uniform(1, 2), indexing="ij")
        seen = map_coordinates(noise, places, order=1) * window
        power = np.abs(np.fft.rfft2(seen)).ravel() ** 2
        # Four samples for each pixel.
        found.append(power @ quiet_rings(side) / (4 * (window**2).sum()))
    np.testing.assert_allclose(np.mean(found, 0), 1, atol=0.12)
