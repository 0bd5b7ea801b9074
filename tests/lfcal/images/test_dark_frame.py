"""Dark frames."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal


def test_dark_frame_is_subtracted_in_the_type_of_the_flat():
    flat = np.array([[[5, 90, 300]]], np.uint16)
    np.testing.assert_array_equal(lfcal.subtract_dark(flat, np.array([[7]], np.uint8)), [[[0, 83, 293]]])
    assert lfcal.subtract_dark(flat, np.array([[7]], np.uint8)).dtype == np.uint16
    assert lfcal.subtract_dark(flat / np.float32(10), np.array([[1.0]], np.float32))[0, 0, 0] == np.float32(-0.5)


def test_dark_frame_of_another_sensor_or_kind_is_refused():
    flat = np.zeros((4, 5), np.uint8)
    with pytest.raises(lfcal.FlatError, match="same sensor"):
        lfcal.subtract_dark(flat, np.zeros((5, 4), np.uint8))
    with pytest.raises(lfcal.FlatError, match="as the sensor stores"):
        lfcal.subtract_dark(flat, np.zeros((4, 5), np.uint16))
