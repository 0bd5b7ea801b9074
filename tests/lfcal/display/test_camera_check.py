"""Wrong cameras are noticed, and right ones cause no alarm."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import lfcal


def test_shift_of_a_third_of_the_pitch_is_noticed_and_undone(white, angle=220):
    check = lfcal.check_camera(white.image, white.moved([20.3 / 3, 0] @ white.turn(angle)))
    assert not check.fits and check.usable and "6.8 px" in check.problem
    moved = check.apply(white.camera, "camera.json")
    assert moved.lattice is check.adjusted.lattice and "was moved onto" in moved.warnings[-1]
    away = white.camera.lattice.to_index(check.adjusted.lattice.origin[None])[0]
    assert np.linalg.norm((away - np.rint(away)) @ white.camera.lattice.basis) < 0.05


@pytest.mark.parametrize("scale", [1.005, 1 / 1.005])
def test_pitch_half_a_percent_off_is_noticed(white, scale):
    check = lfcal.check_camera(white.image, white.moved(change=scale * np.eye(2)))
    assert f"{100 * (1 / scale - 1):+.1f}"[:4] in check.problem


def test_scale_that_moves_corners_by_a_fortieth_of_the_pitch_is_noticed(white):
    scale = 1 + 0.045 * 20.3 / np.hypot(*white.middle)
    problem = lfcal.check_camera(white.image, white.moved(change=scale * np.eye(2))).problem
    assert problem is not None and "the lattice is off by up to 0.9 px" in problem


def test_turned_and_mirrored_flats_are_noticed(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (360, 360))
    camera = lfcal.Calibration(lfcal.Lattice(origin, basis, (360, 360), 9.0))
    turned = lfcal.check_camera(np.rot90(image).copy(), camera)
    assert not turned.usable and "rows" in turned.problem
    with pytest.raises(lfcal.CameraError, match=r"camera\.json: the flat was not made with"):
        turned.apply(camera, "camera.json")
    assert lfcal.check_camera(image[:, ::-1].copy(), camera).problem is not None


def test_published_calibration_of_the_whole_sensor_serves_a_crop(shared):
    flat = lfcal.read_flat(shared("captures", "R42_crop.png"))
    check = lfcal.check_camera(
        flat, lfcal.load(shared("captures", "R42_crop.published.xml"), flat.shape[1::-1])
    )
    assert check.usable and lfcal.check_camera(flat, check.adjusted).fits


def test_another_camera_of_the_same_kind_is_noticed_by_all_checks(shared):
    flat = lfcal.read_flat(shared("captures", "Fujita2.png"))
    other = lfcal.load(shared("captures", "Fujita2.other_camera.json"))
    found = lfcal.check_fit(other, flat)
    assert 0.8 < found.max_offset < 1.1
    assert lfcal.check_camera(flat, other).problem == found.warning
    assert found.warning is not None


@pytest.mark.parametrize("shift", [0.08, 0.12, 0.35])
def test_small_and_large_shifts_of_a_capture_are_undone(shared, shift):
    flat = lfcal.read_flat(shared("captures", "Wall.png"))
    camera = replace(lfcal.calibrate(flat), gain_map=None)
    lattice = camera.lattice
    origin = lattice.origin + shift * lattice.pitch * np.array([0.8, 0.6])
    check = lfcal.check_camera(flat, replace(camera, lattice=replace(lattice, origin=origin)))
    index = lattice.to_index(check.adjusted.lattice.origin[None])[0]
    assert np.linalg.norm((index - np.rint(index)) @ lattice.basis) < 0.02 * lattice.pitch


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("captures", "Boys2.webp"),
        ("captures", "Faint.white.tif"),
        ("captures", "Letras.png"),
        ("captures/hard", "spots_white.png"),
        ("kinds", "types3.png"),
    ],
)
def test_camera_is_not_contradicted_on_the_flat_it_was_calibrated_on(shared, folder, name):
    flat = lfcal.read_flat(shared(*folder.split("/"), name))
    camera = lfcal.calibrate(flat)
    check = lfcal.check_camera(flat, camera)
    assert check.fits and check.checked and lfcal.check_fit(camera, flat).warning is None


def test_the_earlier_order_of_arguments_is_deprecated(white):
    with pytest.warns(DeprecationWarning, match=r"call check_camera\(flat, calibration\)"):
        before = lfcal.check_camera(white.camera, white.image)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert lfcal.check_camera(white.image, white.camera) == before


def test_own_flat_confirms_a_sure_camera_from_its_file_until_its_lattice_changes(white, tmp_path):
    lfcal.calibrate(white.image).save(tmp_path / "camera.json")
    camera = lfcal.load(tmp_path / "camera.json")
    assert camera.is_own(white.image) and lfcal.check_camera(white.image, camera).fits
    other = white.image.copy()
    other[16, 0] = other[16, 0] + 1
    assert not camera.is_own(other)
    origin = camera.lattice.origin + camera.lattice.basis[0] / 2
    moved = replace(camera, lattice=replace(camera.lattice, origin=origin))
    assert not moved.is_own(white.image)
    assert lfcal.check_camera(white.image, moved).problem is not None


def test_camera_that_is_in_doubt_is_checked_on_its_own_flat(white, monkeypatch):
    monkeypatch.setattr("lfcal.pipeline.SURE_CONFIDENCE", 2.0)
    assert not lfcal.calibrate(white.image).is_own(white.image)
