"""Offsets of a given lattice from the microimages of a flat; wrong cameras are noticed, right ones
are not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal

_SIZE = (600, 500)
_MIDDLE = (np.array(_SIZE) - 1) / 2


@pytest.fixture(scope="module")
def white(whites):
    """A white image of 20.3 px pitch, and its camera."""
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, _SIZE)
    return image, lfcal.Calibration(lfcal.Lattice(origin, basis, _SIZE, 9.0))


def _moved(camera, shift=(0.0, 0.0), change=None):
    """The camera, its lattice shifted and changed about the middle of the flat."""
    change = np.eye(2) if change is None else change
    lattice = camera.lattice
    origin = _MIDDLE + (lattice.origin - _MIDDLE) @ change + shift
    return replace(camera, lattice=lfcal.Lattice(origin, lattice.basis @ change, _SIZE, 9.0))


def _turn(degrees):
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    return np.array([[cos, sin], [-sin, cos]])


def test_right_camera_agrees_to_a_hundredth_of_a_pixel_and_has_no_problem(white):
    image, camera = white
    found = lfcal.check_fit(camera, image)
    assert (
        found.max_offset < 0.01 and found.warning is None and "no reason to worry" in found.verdict
    )
    check = lfcal.check_camera(camera, image)
    assert check.fits and check.checked and check.problem is None and check.adjusted is None


def test_shift_is_measured_all_over_the_flat(white):
    image, camera = white
    found = lfcal.check_fit(_moved(camera, (-1.5, 0.8)), image)
    np.testing.assert_allclose(found.offset.reshape(-1, 2), np.tile([1.5, -0.8], (9, 1)), atol=0.02)
    assert "1.7 px" in str(found.warning)


def test_wrong_rotation_is_largest_in_the_corners(white):
    image, camera = white
    found = lfcal.check_fit(_moved(camera, change=_turn(0.3)), image)
    np.testing.assert_allclose(
        found.offset, (found.positions - _MIDDLE) @ (np.eye(2) - _turn(0.3)), atol=0.05
    )
    corners = ("top left", "top right", "bottom left", "bottom right")
    assert any(f"in the {corner}," in str(found.warning) for corner in corners)


def test_gaps_taken_for_lenses_are_found(white):
    image, camera = white
    basis = camera.lattice.basis
    gap = (basis[0] + basis[1]) / 3
    assert lfcal.check_fit(_moved(camera, gap), image).max_offset == pytest.approx(
        np.hypot(*gap), abs=0.2
    )


def test_shift_of_a_third_of_the_pitch_is_noticed_and_undone(white, angle=220):
    image, camera = white
    check = lfcal.check_camera(_moved(camera, [20.3 / 3, 0] @ _turn(angle)), image)
    assert check.fits and "6.8 px" in check.problem
    away = camera.lattice.to_index(check.adjusted.lattice.origin[None])[0]
    assert np.linalg.norm((away - np.rint(away)) @ camera.lattice.basis) < 0.05


@pytest.mark.parametrize("scale", [1.005, 1 / 1.005])
def test_pitch_half_a_percent_off_is_noticed(white, scale):
    image, camera = white
    check = lfcal.check_camera(_moved(camera, change=scale * np.eye(2)), image)
    assert f"{100 * (1 / scale - 1):+.1f}"[:4] in check.problem


def test_scale_that_moves_corners_by_a_fortieth_of_the_pitch_is_noticed(white):
    image, camera = white
    scale = 1 + 0.045 * 20.3 / np.hypot(*_MIDDLE)
    problem = lfcal.check_camera(_moved(camera, change=scale * np.eye(2)), image).problem
    assert problem is not None and "the lattice is off by up to 0.9 px" in problem


def test_turned_and_mirrored_flats_are_noticed(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (360, 360))
    camera = lfcal.Calibration(lfcal.Lattice(origin, basis, (360, 360), 9.0))
    turned = lfcal.check_camera(camera, np.rot90(image).copy())
    assert not turned.fits and "rows" in turned.problem
    assert lfcal.check_camera(camera, image[:, ::-1].copy()).problem is not None


def test_flat_without_microimages_shows_nothing_and_that_is_known(white):
    camera = white[1]
    rng = np.random.default_rng(3)
    nothing = lfcal.check_fit(camera, rng.integers(0, 255, _SIZE[::-1]).astype(np.uint8))
    assert np.isnan(nothing.max_offset) and nothing.warning is None
    check = lfcal.check_camera(camera, rng.integers(0, 5, _SIZE[::-1]).astype(np.uint8))
    assert check.problem is None and not check.checked


@pytest.mark.parametrize("check", [lfcal.check_fit, lfcal.check_camera, lfcal.show])
def test_image_of_another_size_is_refused(white, check):
    with pytest.raises(lfcal.FlatError, match="600 x 500"):
        check(white[1], white[0][:-1])


@pytest.mark.parametrize(
    ("name", "wrong"), [("Fujita2.png", False), ("TempleBoatGiantR32.webp", True)]
)
def test_published_file_that_contradicts_the_pixels_has_a_warning(shared, name, wrong):
    flat = lfcal.read_flat(shared("captures", name))
    found = lfcal.check_fit(
        lfcal.load(shared("captures", name.split(".")[0] + ".published.xml"), flat.shape[1::-1]),
        flat,
    )
    assert (found.max_offset > 1.5) is wrong and (found.warning is not None) is wrong


def test_published_calibration_of_the_whole_sensor_serves_a_crop(shared):
    flat = lfcal.read_flat(shared("captures", "R42_crop.png"))
    check = lfcal.check_camera(
        lfcal.load(shared("captures", "R42_crop.published.xml"), flat.shape[1::-1]), flat
    )
    assert check.fits and lfcal.check_camera(check.adjusted, flat).problem is None


def test_another_camera_of_the_same_kind_is_noticed_by_all_checks(shared):
    flat = lfcal.read_flat(shared("captures", "Fujita2.png"))
    other = lfcal.load(shared("captures", "Fujita2.other_camera.json"))
    found = lfcal.check_fit(other, flat)
    assert 0.8 < found.max_offset < 1.1
    assert lfcal.check_camera(other, flat).problem == found.warning is not None
