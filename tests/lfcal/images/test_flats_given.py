"""Flats are validated, their white level is estimated, white images are told from scenes."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.images.stack import estimate_white_level


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.full((100, 100), np.nan), "NaN"),
        (np.where(np.eye(100) > 0, np.inf, 1.0), "infinite"),
        (np.zeros((10, 10)), "too small"),
        (np.zeros((50, 50, 4), np.uint8), "shape"),
        (np.zeros((0, 5)), "non-empty"),
        (np.ones((64, 64), complex), "real"),
    ],
)
def test_array_that_cannot_be_a_flat_is_refused_with_the_reason(image, reason):
    with pytest.raises(lfcal.FlatError, match=reason):
        lfcal.calibrate(image)


@pytest.mark.parametrize(("dtype", "largest", "level"), [
    (np.uint16, 900, 1023), (np.uint16, 4095, 4095), (np.uint16, 40000, None), (np.uint8, 200, None),
    (np.float32, 900, None),
])  # fmt: skip
def test_white_level_is_that_of_the_least_number_of_bits(dtype, largest, level):
    assert estimate_white_level([np.array([[0, largest]], dtype)]) == level
