"""Conversion of pictures of any type to 8 bits."""

import numpy as np
import pytest

from lfcal.runtime.eight_bit import to_eight_bits


@pytest.mark.parametrize(
    ("pixels", "white"),
    [
        (np.array([0, 128, 255], np.uint8), None),
        (np.array([0, 128, 255], np.uint8), 100.0),
        (np.array([0, 128 * 257, 65535], np.uint16), None),
        (np.array([0, 128 * 16, 4095], np.uint16), 4095.0),
        (np.array([0, 128 * 16, 60000], np.uint16), 4095.0),
        (np.array([-1, 128 / 255, 7], np.float32), None),
        (np.array([np.nan, 128 / 255, 1], np.float64), 4095.0),
    ],
)
def test_black_middle_and_white_of_all_types(pixels, white):
    np.testing.assert_array_equal(to_eight_bits(pixels, white), np.array([0, 128, 255], np.uint8))
