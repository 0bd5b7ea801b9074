"""Over-exposed white images are named so."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal.images.stack import measure_overexposure


def test_overexposed_white_image_is_named_with_the_share_of_clipped_pixels(drawn):
    truth = drawn("square", 24.3, 31.0, 34.0, size=(600, 500))
    light = truth.light() + truth.noise * np.random.default_rng(1).standard_normal((500, 600))
    image = np.rint(np.clip(2.2 * light, 0, 1) * 255).astype(np.uint8)
    camera = lfcal.calibrate(image, "white")
    assert any("over-exposed" in text for text in camera.warnings)
    assert not any("over-exposed" in text for text in lfcal.calibrate(truth.image(), "white").warnings)


def test_share_of_clipped_pixels_is_measured_at_the_limit_of_the_sensor():
    flat = np.full((10, 10), 100, np.uint16)
    flat[:3] = 4095
    flat[3] = 80  # masks have two tones
    assert measure_overexposure(flat) == 0.3
    assert measure_overexposure(flat.astype(np.float32)) == 0.0
    flat[:3] = 200
    assert measure_overexposure(flat) == 0.0
