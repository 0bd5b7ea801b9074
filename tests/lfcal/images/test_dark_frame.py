"""Dark frames."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

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


def test_parts_of_a_flat_are_those_of_the_whole_less_the_dark_frame(tmp_path):
    rng = np.random.default_rng(2)
    flat, dark = (rng.integers(0, top, (50, 40), np.uint16) for top in (900, 300))
    tifffile.imwrite(tmp_path / "flat.tif", flat)
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    with lfcal.open_flat(tmp_path / "flat.tif", dark=tmp_path / "dark.tif") as source:
        assert source.in_parts and source.dark == tmp_path / "dark.tif"
        np.testing.assert_array_equal(source.read(3, 7, 21, 30), lfcal.subtract_dark(flat, dark)[7:30, 3:21])


def test_dark_file_that_does_not_fit_the_flat_is_named_when_it_is_opened(tmp_path):
    tifffile.imwrite(tmp_path / "flat.tif", np.zeros((50, 40), np.uint8))
    tifffile.imwrite(tmp_path / "small.tif", np.zeros((40, 40), np.uint8))
    tifffile.imwrite(tmp_path / "deep.tif", np.zeros((50, 40), np.uint16))
    for name, message in (("small.tif", "40 x 40 and 40 x 50 px"), ("deep.tif", "as the sensor stores"), ("no", "no")):
        with pytest.raises(lfcal.FlatError, match=f"{name}.*{message}"):
            lfcal.open_flat(tmp_path / "flat.tif", dark=tmp_path / name)
