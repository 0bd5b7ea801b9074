"""Texture is restored; what no scene can show behind the lenses is left nearly as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_synth import Camera
from lfcal import LensBlur
from lfrender.detail.defocus import Defocus
from lfrender.detail.filters import make_filters
from lfrender.detail.restore import restore_detail, smooth_picture
from lfrender.detail.settings import RESTORE

PITCH, SIZE, DISC = 30.0, -9.0, 2.5


def restored(image, **changed):
    """As from a camera whose discs of defocus are 2.5 px, at one pixel of the picture for each of the flat."""
    calibration = Camera.design(size=(480, 400), pitch=PITCH, rotation=3.0).calibration()
    blur = LensBlur(8.0, 1.0, [0.0], [0.1], [SIZE / PITCH], [[DISC]], [[0.2]])
    defocus = Defocus(blur, ((DISC,) * 33,), 0.001)
    filters = make_filters(defocus, calibration, -SIZE, 1.7, 0.0, 1, (SIZE, SIZE))
    every = np.ones(image.shape[:2], np.float32)
    settings = replace(RESTORE, overshoot=100.0)
    return restore_detail(
        image, every > 0, every * np.float32(SIZE), replace(filters, **changed), 1.0, False, PITCH, every, settings
    )


def test_blurred_texture_gains_contrast():
    image = np.random.default_rng(1).uniform(0.2, 0.8, (96, 96, 1)).astype(np.float32)
    for _ in range(3):
        image = smooth_picture(image)
    assert restored(image)[12:-12, 12:-12].std() > 1.1 * image[12:-12, 12:-12].std()


def test_single_pixels_that_no_lens_can_show_are_sharpened_less():
    image = np.full((96, 96, 1), 0.3, np.float32)
    image[24:80:16, 24:80:16] += 0.1
    assert restored(image).max() - 0.3 < 1.6 * 0.1
    assert restored(image, most=np.full(386, 1e9, np.float32)).max() - 0.3 > 2.2 * 0.1
