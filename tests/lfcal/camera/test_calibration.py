"""Calibrations: saved and loaded without loss; damaged files are refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.gain.gain_map import GainMap
from lfcal.gain.vignetting import Vignetting


@pytest.fixture
def camera():
    lattice = lfcal.Lattice((10.25, 7.5), [[20.0, 0.5], [9.5, 17.0]], (200, 100), 9.5)
    vignetting = Vignetting([1.0, 0.9, 0.5], 4.0)
    return lfcal.Calibration(lattice, vignetting, "white", 0.01, 40, 0.97, ("look",), white_level=4095.0)


def test_saved_camera_is_loaded_exactly(camera, tmp_path):
    camera.save(tmp_path / "camera.json")
    back = lfcal.load(tmp_path / "camera.json")
    assert back.to_dict() == camera.to_dict()
    np.testing.assert_array_equal(back.lattice.basis, camera.lattice.basis)


def test_unmeasured_residual_is_loaded_as_nan(camera, tmp_path):
    lfcal.Calibration(camera.lattice).save(tmp_path / "camera.json")
    assert np.isnan(lfcal.load(tmp_path / "camera.json").residual_rms)


def test_camera_of_another_image_size_is_refused(camera, tmp_path):
    camera.save(tmp_path / "camera.json")
    assert lfcal.load(tmp_path / "camera.json", (200, 100)).image_size == (200, 100)
    with pytest.raises(lfcal.CameraFileError, match="200 x 100"):
        lfcal.load(tmp_path / "camera.json", (100, 200))


@pytest.mark.parametrize("field", ["lattice", "fit", "source", "warnings", "image_size", "vignetting"])
def test_missing_field_is_named(camera, tmp_path, field):
    data = camera.to_dict()
    del data[field]
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(data))
    with pytest.raises(lfcal.CameraFileError, match=field):
        lfcal.load(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"schema": "lfcal-camera", "version": 99}', "\x00"])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.json"):
        lfcal.load(path)


def test_missing_file_is_a_camera_file_error(tmp_path):
    with pytest.raises(lfcal.CameraFileError, match="nowhere"):
        lfcal.load(tmp_path / "nowhere.json")


def test_camera_file_keeps_the_standard_errors(tmp_path):
    from lfcal.lattice.standard_errors import equal_weight_errors

    lattice = lfcal.Lattice([10.0, 9.0], [[14.3, 0.2], [6.9, 12.4]], (300, 200), 6.0)
    camera = lfcal.Calibration(lattice, errors=equal_weight_errors(lattice, 0.02))
    camera.save(tmp_path / "camera.json")
    kept = lfcal.load(tmp_path / "camera.json").errors.of_centres(lattice)
    np.testing.assert_allclose(np.sqrt((kept**2).mean()), 0.02, rtol=1e-9)
    middle, corner = lattice.centres() - [150, 100], np.hypot(150, 100)
    assert kept[np.hypot(*middle.T) < 20].max() < 0.7 * kept[np.hypot(*middle.T) > 0.85 * corner].min()


def test_the_condition_of_a_fit_is_larger_for_strips_and_independent_of_the_unit():
    from lfcal.lattice.standard_errors import LatticeErrors, equal_weight_errors

    def condition(size, origin):
        return equal_weight_errors(lfcal.Lattice(origin, [[10.0, 0.0], [0.0, 10.0]], size, 4.0), 0.02).condition

    assert 1 <= condition((300, 300), (150.0, 150.0)) < 1.2
    # With the origin in a corner, origin and basis are correlated.
    assert 4 < condition((300, 300), (5.0, 5.0)) < 6
    assert condition((900, 20), (455.0, 5.0)) > 2
    errors = equal_weight_errors(lfcal.Lattice((5.0, 5.0), [[10.0, 0.0], [0.0, 10.0]], (300, 300), 4.0), 0.02)
    assert errors.scaled(8.0).condition == pytest.approx(errors.condition)
    # All parameters are fully correlated.
    assert LatticeErrors(errors.names, np.full((6, 6), 1e-6)).condition > 1e6


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
