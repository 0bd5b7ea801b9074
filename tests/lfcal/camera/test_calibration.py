"""Calibrations: saved and loaded without loss; damaged files are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.gain.gain_map import GainMap, Vignetting
from lfcal.lattice.standard_errors import equal_weight_errors

TYPES = lfcal.LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]], True, [-0.4, float("nan"), -0.2], 0.97)
BLUR = lfcal.LensBlur(
    5.0, 0.5, [0.1, -0.1], [0.02, 0.03], [-0.3, -0.2, -0.1], np.ones((2, 3)), np.full((2, 3), 0.1)
)


@pytest.fixture
def camera():
    lattice = lfcal.Lattice((10.25, 7.5), [[20.0, 0.5], [9.5, 17.0]], (200, 100), 9.5)
    vignetting = Vignetting([1.0, 0.9, 0.5], 4.0)
    return lfcal.Calibration(
        lattice,
        vignetting,
        "white",
        0.01,
        40,
        0.97,
        ("look",),
        TYPES,
        white_level=4095.0,
        lens_blur=BLUR,
        errors=equal_weight_errors(lattice, 0.02),
        optics=lfcal.Optics(50, 58, 0.7, 0.005, covariance=np.eye(14)),
    )


def test_saved_camera_is_loaded_exactly(camera, tmp_path):
    for one in (camera, lfcal.Calibration(camera.lattice)):
        one.save(tmp_path / "camera.json")
        back = lfcal.load(tmp_path / "camera.json")
        assert back.to_dict() == one.to_dict() and back == one


def test_camera_of_another_image_size_is_refused(camera, tmp_path):
    camera.save(tmp_path / "camera.json")
    assert lfcal.load(tmp_path / "camera.json", (200, 100)).image_size == (200, 100)
    with pytest.raises(lfcal.CameraFileError, match="200 x 100"):
        lfcal.load(tmp_path / "camera.json", (100, 200))


@pytest.mark.parametrize(
    "text", [None, "", "{", "[]", "{}", '{"schema": "lfcal-camera", "version": 99}', "\x00"]
)
def test_missing_and_other_files_are_refused_by_name(tmp_path, text):
    path = tmp_path / "camera.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.json"):
        lfcal.load(path)


def test_lenses_of_a_file_of_version_1_are_put_in_the_order_of_the_centres():
    lattice = lfcal.Lattice([101.0, 80.0], [[20.1, 11.6], [0.0, 23.2]], (400, 300), 9.0)
    own = np.linspace(0.5, 1.5, len(lattice)).astype(np.float16).astype(np.float32)
    gain = replace(GainMap.round(np.ones(40), 0.25, 10.0), lens_gain=own)
    data = lfcal.Calibration(lattice=lattice, gain_map=gain).to_dict()
    np.testing.assert_array_equal(lfcal.Calibration.from_dict(data).gain_map.lens_gain, own)
    rows = sorted(range(len(lattice)), key=lambda n: tuple(lattice.indices()[n][::-1]))
    assert rows != sorted(rows)
    old = data | {"version": 1, "gain_map": replace(gain, lens_gain=own[rows]).to_dict()}
    np.testing.assert_array_equal(lfcal.Calibration.from_dict(old).gain_map.lens_gain, own)
