"""Offsets of given lattices from the microimages of a flat."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal

_SIZE = (900, 700)


@pytest.fixture(scope="module", params=["hexagonal", "square"])
def white(request, whites):
    basis = whites.turned(whites.HEXAGON if request.param == "hexagonal" else whites.SQUARE, 20.3, 3)
    image, origin = whites.white_image(basis, _SIZE)
    return image, origin, basis


def _camera(origin, basis):
    return lfcal.Calibration(lfcal.Lattice(origin, basis, _SIZE, 9.0))


def test_true_lattice_agrees_to_a_hundredth_of_a_pixel(white):
    image, origin, basis = white
    found = lfcal.check_fit(_camera(origin, basis), image)
    assert np.linalg.norm(found.offset, axis=-1).max() < 0.01
    assert found.max_offset < 0.01 and found.warning is None


def test_shift_is_measured_all_over_the_flat(white):
    image, origin, basis = white
    found = lfcal.check_fit(_camera(origin + np.array([-1.5, 0.8]), basis), image)
    np.testing.assert_allclose(found.offset.reshape(-1, 2), np.tile([1.5, -0.8], (9, 1)), atol=0.02)
    assert "1.7 px" in str(found.warning)


def test_wrong_rotation_is_largest_in_the_corners(white):
    image, origin, basis = white
    angle = np.radians(0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    middle = (np.array(_SIZE) - 1) / 2
    found = lfcal.check_fit(_camera(middle + (origin - middle) @ turn, basis @ turn), image)
    expected = (found.positions - middle) @ (np.eye(2) - turn)
    np.testing.assert_allclose(found.offset, expected, atol=0.05)
    assert "corner" in str(found.warning)


def test_gaps_taken_for_lenses_are_found(white):
    image, origin, basis = white
    gap = (basis[0] + basis[1]) / (3 if abs(basis[0] @ basis[1]) > 1 else 2)
    found = lfcal.check_fit(_camera(origin + gap, basis), image)
    assert found.max_offset == pytest.approx(np.hypot(*gap), abs=0.2)


def test_offsets_are_unknown_where_a_flat_shows_no_microimages(white):
    _, origin, basis = white
    noise = np.random.default_rng(3).integers(0, 255, _SIZE[::-1]).astype(np.uint8)
    nothing = lfcal.check_fit(_camera(origin, basis), noise)
    assert np.isnan(nothing.max_offset) and nothing.warning is None


def test_image_of_another_size_is_refused(white):
    image, origin, basis = white
    with pytest.raises(lfcal.FlatError, match="900 x 700"):
        lfcal.check_fit(_camera(origin, basis), image[:-1])


@pytest.mark.parametrize(("name", "wrong"), [("Fujita2.png", False), ("TempleBoatGiantR32.webp", True)])
def test_published_file_that_contradicts_the_pixels_has_a_warning(shared, name, wrong):
    flat = lfcal.read_flat(shared("captures", name))
    xml = shared("captures", name.split(".")[0] + ".published.xml")
    found = lfcal.check_fit(lfcal.load(xml, flat.shape[1::-1]), flat)
    assert (found.max_offset > 1.5) is wrong
    assert (found.warning is not None) is wrong


def test_another_camera_of_the_same_kind_is_noticed_by_all_checks(shared):
    flat = lfcal.read_flat(shared("captures", "Fujita2.png"))
    other = lfcal.load(shared("captures", "Fujita2.other_camera.json"))
    found = lfcal.check_fit(other, flat)
    assert 0.8 < found.max_offset < 1.1
    assert lfcal.check_camera(other, flat).problem == found.warning is not None


def test_scale_that_moves_corners_by_a_fortieth_of_the_pitch_is_noticed(white):
    image, origin, basis = white
    middle = (np.array(_SIZE) - 1) / 2
    scale = 1 + 0.045 * 20.3 / np.hypot(*middle)
    camera = _camera(middle + (origin - middle) * scale, basis * scale)
    problem = lfcal.check_camera(camera, image).problem
    assert problem is not None and "the lattice is off by up to 0.9 px" in problem
