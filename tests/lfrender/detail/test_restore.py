"""Texture that was blurred gains contrast, without halos beside what is clipped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data_synth import Camera
from lfcal import LensBlur
from lfrender.detail.defocus import Defocus
from lfrender.detail.filters import make_filters
from lfrender.detail.restore import restore_detail, smooth_picture
from lfrender.detail.settings import RESTORE

PITCH, SIZE, DISC = 30.0, -9.0, 2.5


def restored(image):
    """As from a camera whose discs of defocus are 2.5 px, at one pixel of the picture for each of the flat."""
    calibration = Camera.design(size=(480, 400), pitch=PITCH, rotation=3.0).calibration()
    blur = LensBlur(8.0, 1.0, [0.0], [0.1], [SIZE / PITCH], [[DISC]], [[0.2]])
    defocus = Defocus(blur, ((DISC,) * 33,), 0.001)
    filters = make_filters(defocus, calibration, -SIZE, 1.7, 0.0, 1, (SIZE, SIZE))
    every = np.ones(image.shape[:2], np.float32)
    settings = replace(RESTORE, overshoot=100.0)
    return restore_detail(image, every > 0, every * np.float32(SIZE), filters, 1.0, False, PITCH, every, settings)


def test_blurred_texture_gains_contrast():
    image = np.random.default_rng(1).uniform(0.2, 0.8, (96, 96, 1)).astype(np.float32)
    for _ in range(3):
        image = smooth_picture(image)
    assert restored(image)[12:-12, 12:-12].std() > 1.1 * image[12:-12, 12:-12].std()


@pytest.mark.parametrize("period", [4, 6])
def test_fine_stripes_gain_contrast_as_other_texture_does(period):
    stripes = 0.3 + 0.05 * np.cos(2 * np.pi * np.arange(96) / period)
    image = np.tile(stripes.astype(np.float32), (96, 1))[..., None]
    assert restored(image)[12:-12, 12:-12].std() > 1.2 * image[12:-12, 12:-12].std()


def test_nothing_gets_darker_than_its_surroundings_beside_clipped_light():
    bars = np.where(np.arange(96) // 6 % 2 > 0, 1.6, 0.3).astype(np.float32)
    blurred = smooth_picture(np.tile(bars, (96, 1))[..., None])
    dark = blurred < 1
    assert restored(np.minimum(blurred, 1))[dark].min() > 0.299
    # Below white, edges may overshoot.
    assert restored(0.6 * blurred)[dark].min() < 0.9 * 0.6 * 0.3
