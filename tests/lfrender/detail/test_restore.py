"""Texture that was blurred gains contrast, without halos beside what is clipped."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import Camera
from lfcal import LensBlur
from lfrender.detail.filters import make_filters
from lfrender.detail.restore import Places, restore_detail

PITCH = 30.0
SIZE = -9.0
DISC = 2.5


def smooth(image):
    wide = np.pad(image, ((1, 1), (1, 1), (0, 0)), "edge")
    wide = (wide[:-2] + 2 * wide[1:-1] + wide[2:]) / 4
    return (wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]) / 4


def restored(image, dtype=np.float32):
    """As from a camera whose discs of defocus are 2.5 px, at one pixel of the picture for each of
    the flat.
    """
    blur = LensBlur(8.0, 1.0, [0.0], [0.1], [SIZE / PITCH], [[DISC]], [[1e-6]])
    calibration = Camera.design(size=(480, 400), pitch=PITCH, rotation=3.0).calibration()
    filters = make_filters(calibration, blur, 0.001, -SIZE, 1.7, (SIZE, SIZE))
    kinds = np.full((1, 1), round(-SIZE / PITCH * filters.per_ratio), np.uint16)
    rows, columns = (np.zeros(n, np.int64) for n in image.shape[:2])
    places = Places(kinds, rows, columns)
    seen = np.ones(image.shape[:2], bool)
    return restore_detail(
        np.float32(image), seen, places, filters, 1.0, False, dtype, overshoot=100.0
    )


def test_blurred_texture_gains_contrast():
    image = np.random.default_rng(1).uniform(0.2, 0.8, (96, 96, 1))
    for _ in range(3):
        image = smooth(image)
    assert restored(image)[12:-12, 12:-12].std() > 1.1 * image[12:-12, 12:-12].std()


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_all_channels_of_a_pixel_change_by_one_factor(channels):
    grey = smooth(smooth(np.random.default_rng(1).uniform(0.2, 0.8, (64, 64, 1))))
    shares = np.linspace(0.4, 1, channels)
    shares *= channels / shares.sum()
    found = restored(grey * shares)
    np.testing.assert_allclose(found, restored(grey) * shares, rtol=2e-5)


@pytest.mark.parametrize("period", [4, 6])
def test_fine_stripes_gain_contrast_as_other_texture_does(period):
    stripes = 0.3 + 0.05 * np.cos(2 * np.pi * np.arange(96) / period)
    image = np.tile(stripes, (96, 1))[..., None]
    assert restored(image)[12:-12, 12:-12].std() > 1.2 * image[12:-12, 12:-12].std()


def test_nothing_gets_darker_than_its_surroundings_beside_clipped_light():
    bars = np.where(np.arange(96) // 6 % 2 > 0, 1.6, 0.3)
    blurred = smooth(np.tile(bars, (96, 1))[..., None])
    dark = blurred < 1
    assert restored(np.minimum(blurred, 1))[dark].min() > 0.299
    # Below white, edges may overshoot.
    assert restored(0.6 * blurred)[dark].min() < 0.9 * 0.6 * 0.3
