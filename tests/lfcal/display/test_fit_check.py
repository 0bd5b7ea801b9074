"""Offsets of a given lattice from the microimages of a flat."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal


def test_right_camera_agrees_to_a_hundredth_of_a_pixel_and_has_no_problem(white):
    found = lfcal.check_fit(white.camera, white.image)
    assert (
        found.max_offset < 0.01 and found.warning is None and "no reason to worry" in found.verdict
    )
    check = lfcal.check_camera(white.image, white.camera)
    assert check.fits and check.checked and check.problem is None and check.adjusted is None


def test_shift_is_measured_all_over_the_flat(white):
    found = lfcal.check_fit(white.moved((-1.5, 0.8)), white.image)
    np.testing.assert_allclose(found.offset.reshape(-1, 2), np.tile([1.5, -0.8], (9, 1)), atol=0.02)
    assert "1.7 px" in str(found.warning)


def test_wrong_rotation_is_largest_in_the_corners(white):
    found = lfcal.check_fit(white.moved(change=white.turn(0.3)), white.image)
    np.testing.assert_allclose(
        found.offset, (found.positions - white.middle) @ (np.eye(2) - white.turn(0.3)), atol=0.05
    )
    assert "rotation -0.30 degrees from the camera" in str(found.warning)


def test_gaps_taken_for_lenses_are_found(white):
    basis = white.camera.lattice.basis
    gap = (basis[0] + basis[1]) / 3
    assert lfcal.check_fit(white.moved(gap), white.image).max_offset == pytest.approx(
        np.hypot(*gap), abs=0.2
    )


def test_flat_without_microimages_shows_nothing_and_that_is_known(white):
    camera = white.camera
    rng = np.random.default_rng(3)
    nothing = lfcal.check_fit(camera, rng.integers(0, 255, (500, 600)).astype(np.uint8))
    assert np.isnan(nothing.max_offset) and nothing.warning is None
    check = lfcal.check_camera(rng.integers(0, 5, (500, 600)).astype(np.uint8), camera)
    assert check.problem is None and not check.checked


@pytest.mark.parametrize("grey", [0, 100, 255])
def test_even_grey_shows_nothing_and_that_is_known(white, grey):
    even = np.full_like(white.image, grey)
    assert np.isnan(lfcal.check_fit(white.camera, even).max_offset)
    check = lfcal.check_camera(even, white.camera)
    assert not check.checked and check.problem is None
    assert "neither dark nor saturated" in check.apply(white.camera, "a.json").warnings[-1]


@pytest.mark.parametrize("check", [lfcal.check_fit, lfcal.check_camera, lfcal.show])
def test_image_of_another_size_is_refused(white, check):
    with pytest.raises(lfcal.FlatError, match="600 x 500"):
        check(white.camera, white.image[:-1])


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


def test_verdict_on_the_flat_of_the_calibration_names_it(white):
    found = lfcal.check_fit(lfcal.calibrate(white.image), white.image)
    assert found.own and found.warning is None and found.max_offset < 0.05
    assert found.verdict.startswith("the camera was calibrated on this flat; a fit")
