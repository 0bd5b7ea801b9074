"""The vignetting-corrected flat: every pixel of a trusted microimage has the gain of its own lens."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Calibration, Lattice
from lfcal.gain.vignetting import Vignetting
from lfrender.flat.gray_flat import GrayFlat, correction_tables, downsample, make_gray_flat

BASES = [((20, 0), (0, 20)), ((20, 0), (10, 17.32)), ((0, 20), (17.32, 10)), ((19.5, 4.5), (5.85, 19.1))]


@pytest.mark.parametrize("basis", BASES)
def test_pixels_have_the_gain_of_the_nearest_lens(basis):
    lattice = Lattice((101.0, 83.0), basis, (200, 160), 9.6)
    profile = Vignetting(np.linspace(1, 0.92, 21) ** 2, 0.5)
    calibration = Calibration(lattice, profile)
    gray = make_gray_flat(np.ones((160, 200, 3), np.float32), calibration)
    y, x = np.mgrid[:160, :200]
    distance = np.sqrt(((np.stack([x, y], -1)[:, :, None] - lattice.centres()) ** 2).sum(-1)).min(-1)
    (gains, *_), step = correction_tables(calibration)
    wanted = gains[np.minimum(distance**2 / step, len(gains) - 1).astype(int)]
    trusted = distance < gray.radius + 0.9
    assert trusted.mean() > 0.4
    np.testing.assert_allclose(gray.image[trusted], wanted[trusted], rtol=2e-3)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_brightness_is_the_mean_of_the_channels(channels):
    lattice = Lattice((20.0, 20.0), ((12.0, 0.0), (0.0, 12.0)), (50, 40), 5.5)
    flat = np.random.default_rng(channels).integers(0, 256, (40, 50, channels), np.uint8)
    gray = make_gray_flat(flat, Calibration(lattice))
    np.testing.assert_allclose(gray.image, flat.mean(2) / 255, atol=1e-6)


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_downsampling_a_few_lenses_equals_downsampling_the_whole_flat(factor):
    rng = np.random.default_rng(4)
    lattice = Lattice((31.3, 28.7), ((40, 0), (0, 40)), (401, 319), 19.0)
    centres = lattice.centres().astype(np.float32)
    flat = GrayFlat(rng.random((319, 401)).astype(np.float32), centres, 18.0, 40.0)
    few = np.zeros(len(centres), bool)
    few[[0, 13, len(centres) - 1]] = True
    whole, part = downsample(flat, factor), downsample(flat, factor, few)
    np.testing.assert_array_equal(part.centres, whole.centres)
    assert (part.radius, part.pitch) == (whole.radius, whole.pitch)
    y, x = np.mgrid[: whole.image.shape[0], : whole.image.shape[1]]
    for cx, cy in whole.centres[few]:
        # Interpolation and slopes read a pixel beyond the microimage.
        about = np.maximum(np.abs(x - cx), np.abs(y - cy)) <= whole.radius + 1.5
        np.testing.assert_allclose(part.image[about], whole.image[about], rtol=1e-5)
