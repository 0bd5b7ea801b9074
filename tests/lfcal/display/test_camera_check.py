"""Wrong cameras for a flat are noticed, right ones are not complained of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal

_SIZE = (500, 500)


@pytest.fixture(scope="module")
def capture(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, _SIZE)
    return image, lfcal.Calibration(lfcal.Lattice(origin, basis, _SIZE, 9.0))


def _moved(camera, origin=None, basis=None):
    lattice = camera.lattice
    origin = lattice.origin if origin is None else origin
    return replace(camera, lattice=lfcal.Lattice(origin, lattice.basis if basis is None else basis, _SIZE, 9.0))


def test_right_camera_has_no_problem(capture):
    image, camera = capture
    check = lfcal.check_camera(camera, image)
    assert check.fits and check.problem is None and check.adjusted is None


@pytest.mark.parametrize("angle", [0, 100, 220])
def test_shift_of_a_third_of_the_pitch_is_noticed_and_undone(capture, angle):
    image, camera = capture
    shift = 20.3 / 3 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    check = lfcal.check_camera(_moved(camera, camera.lattice.origin + shift), image)
    assert check.fits and "6.8 px" in check.problem
    away = camera.lattice.to_index(check.adjusted.lattice.origin[None])[0]
    assert np.linalg.norm((away - np.rint(away)) @ camera.lattice.basis) < 0.05


@pytest.mark.parametrize("scale", [1.005, 1 / 1.005])
def test_pitch_half_a_percent_off_is_noticed(capture, scale):
    image, camera = capture
    check = lfcal.check_camera(_moved(camera, basis=camera.lattice.basis * scale), image)
    assert f"{100 * (1 / scale - 1):+.1f}"[:4] in check.problem


def test_turned_flat_of_a_hexagonal_array_is_refused_and_the_turn_named(capture):
    image, camera = capture
    check = lfcal.check_camera(camera, np.rot90(image).copy())
    assert not check.fits and "rows" in check.problem


def test_mirrored_flat_is_noticed(capture):
    image, camera = capture
    check = lfcal.check_camera(camera, image[:, ::-1].copy())
    assert check.problem is not None


def test_dark_flat_says_nothing_and_that_is_known(capture):
    image, camera = capture
    noise = np.random.default_rng(3).integers(0, 5, _SIZE).astype(np.uint8)
    check = lfcal.check_camera(camera, noise)
    assert check.problem is None and not check.checked
    assert lfcal.check_camera(camera, image).checked


def test_image_of_another_size_is_refused(capture):
    image, camera = capture
    with pytest.raises(lfcal.FlatError, match="500 x 500"):
        lfcal.check_camera(camera, image[:-1])


def test_published_calibration_of_the_whole_sensor_serves_a_crop(shared):
    flat = lfcal.read_flat(shared("captures", "R42_crop.png"))
    camera = lfcal.load(shared("captures", "R42_crop.published.xml"), flat.shape[1::-1])
    check = lfcal.check_camera(camera, flat)
    assert check.fits and check.adjusted is not None
    assert lfcal.check_camera(check.adjusted, flat).problem is None
