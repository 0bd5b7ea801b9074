"""The vignetting-corrected flat: every pixel has the gain of its own lens."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Calibration, Lattice
from lfcal.gain.gain_map import Vignetting
from lfrender.flat.gray_flat import (
    GrayFlat,
    correction_tables,
    make_gray_flat,
    trusted_radius,
)

BASES = [
    ((20, 0), (0, 20)),
    ((20, 0), (10, 17.32)),
    ((0, 20), (17.32, 10)),
    ((19.5, 4.5), (5.85, 19.1)),
]


@pytest.mark.parametrize("basis", BASES)
def test_pixels_have_the_gain_of_the_nearest_lens(basis):
    lattice = Lattice((101.0, 83.0), basis, (200, 160), 9.6)
    profile = Vignetting(np.linspace(1, 0.92, 21) ** 2, 0.5)
    calibration = Calibration(lattice, profile)
    gray = make_gray_flat(np.ones((160, 200, 3), np.float32), calibration)
    y, x = np.mgrid[:160, :200]
    distance = np.sqrt(((np.stack([x, y], -1)[:, :, None] - lattice.centres()) ** 2).sum(-1)).min(
        -1
    )
    (gains, *_), step = correction_tables(calibration)
    wanted = gains[np.minimum(distance**2 / step, len(gains) - 1).astype(int)]
    trusted = distance < gray.radius + 0.9
    assert trusted.mean() > 0.4
    np.testing.assert_allclose(gray.image[trusted], wanted[trusted], rtol=2e-3)


@pytest.mark.parametrize(
    ("beyond", "radius"), [(1.3, 7.0), (0.8, 7.0), (1.05, 8.6)], ids=["bright", "dim", "even"]
)
def test_only_pixels_as_bright_as_the_middle_are_compared(beyond, radius):
    """Of rims that are brighter, light of the neighbours is a part."""
    lattice = Lattice((101.0, 83.0), BASES[0], (200, 160), 9.6)
    profile = Vignetting([1.0] * 14 + [beyond] * 10, 0.5)
    assert abs(trusted_radius(Calibration(lattice, profile)) - radius) <= 0.25


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_brightness_is_the_mean_of_the_channels(channels):
    lattice = Lattice((20.0, 20.0), ((12.0, 0.0), (0.0, 12.0)), (50, 40), 5.5)
    flat = np.random.default_rng(channels).integers(0, 256, (40, 50, channels), np.uint8)
    gray = make_gray_flat(flat, Calibration(lattice))
    np.testing.assert_allclose(gray.image, flat.mean(2) / 255, atol=1e-6)


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_downsampled_flat_holds_the_means_of_blocks_and_the_centres_in_its_own_pixels(factor):
    image = np.random.default_rng(4).random((319, 401)).astype(np.float32)
    gray = GrayFlat(image, np.array([[31.3, 28.7]], np.float32), 18.0, 40.0)
    small = gray.downsampled(factor)
    height = 319 // factor
    width = 401 // factor
    wanted = (
        image[: height * factor, : width * factor]
        .reshape(height, factor, width, factor)
        .mean((1, 3))
    )
    np.testing.assert_allclose(small.image, wanted, atol=1e-6)
    np.testing.assert_allclose(
        small.centres, (np.array([[31.3, 28.7]]) + 0.5) / factor - 0.5, atol=1e-5
    )
