"""Gains and tone curves keep black, middle and white of all types, in light."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.runtime.light.tone import (
    apply_tone,
    decode_srgb,
    encode_srgb,
    grey_world,
    linear_light,
    to_eight_bits,
)


def test_the_curve_of_srgb_has_its_known_values_and_an_inverse():
    light = np.array([0.0, 0.0031308, 0.2140411, 1.0])
    np.testing.assert_allclose(encode_srgb(light), [0, 0.04045, 0.5, 1], atol=1e-5)
    ramp = np.linspace(0, 1.5, 1000)
    np.testing.assert_allclose(decode_srgb(encode_srgb(ramp)), ramp, atol=1e-7)


@pytest.mark.parametrize(
    ("pixels", "white"),
    [
        (np.array([0, 128, 255], np.uint8), 100.0),
        (np.array([0, 128 * 257, 65535], np.uint16), None),
        (np.array([0, 128 * 16, 60000], np.uint16), 4095.0),
        (np.array([np.nan, 128 / 255, 7], np.float32), 4095.0),
    ],
)
def test_black_middle_and_white_of_all_types_with_8_bits(pixels, white):
    shown = to_eight_bits(pixels, white, encoded=True)
    np.testing.assert_array_equal(shown, np.array([0, 128, 255], np.uint8))
    straight = apply_tone(pixels, np.uint8, False, white=white, encoded=False)
    np.testing.assert_array_equal(straight, np.array([0, 128, 255], np.uint8))
    linear = to_eight_bits(pixels, white, encoded=False)
    np.testing.assert_array_equal(linear, np.array([0, 188, 255], np.uint8))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_gains_are_factors_on_the_light_of_each_channel(kind):
    top = 1.0 if np.dtype(kind).kind == "f" else np.iinfo(kind).max
    card = np.full((4, 5, 3), 0.2) * top
    picture = card.astype(kind)
    gains = np.array([2.0, 1.0, 1.5])
    shown = apply_tone(picture, kind, kind is np.uint8, gain=gains)
    wanted = linear_light(picture) * gains
    np.testing.assert_allclose(linear_light(shown), wanted, rtol=0.03)


def test_grey_world_leaves_out_what_is_clipped():
    picture = np.full((20, 20, 3), (0.2, 0.4, 0.1))
    picture[:10] = 1.0
    assert grey_world(picture) == pytest.approx((2, 1, 4))
    assert grey_world(np.ones((5, 5, 3))) == (1, 1, 1)
