"""Discs of defocus on captures: found where the capture tells them, none where the scene may be
soft itself.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import lfcal
from data_synth import SCENES, Camera, simulate


def measure(camera, scene, seed=5, noise=(8000, 5), **more):
    """The blur measured with the true depth, and the camera."""
    shot = simulate(scene, camera, samples=32, seed=seed, noise=noise)
    truth = shot.truth
    grey = (shot.flat.mean(2) / 255) ** 2
    calibration = replace(truth.calibration, **more)
    radius = 0.9 * calibration.lattice.radius

    def light(corners, side):
        x, y = corners.T
        return sliding_window_view(grey, (side, side))[y, x]

    return lfcal.measure_lens_blur(light, calibration, truth.patch_size, radius)


def design(**more):
    return Camera.design(
        size=(600, 480), rotation=1.3, **{"pitch": 40.0, "focus": 0.04, "fill": 0.22} | more
    )


@pytest.mark.parametrize(("fill", "ratio"), [(0.22, -0.3), (0.3, 0.35), (0.25, -0.2)])
def test_the_disc_of_a_plane_is_found_and_its_least_value_is_not_above_the_truth(fill, ratio):
    camera = design(fill=fill)
    found = measure(camera, SCENES["plane"](camera, seed=3, ratio=ratio))
    truth = fill * 40.0 * abs(ratio - 0.04)
    discs, errors = found.at([ratio])
    assert discs[0, 0] == pytest.approx(truth, abs=0.3)
    assert discs[0, 0] - errors[0, 0] < truth + 0.2
    if truth > 3.5:
        assert discs[0, 0] - errors[0, 0] > truth - 1.3


def test_a_soft_scene_is_not_taken_for_a_wide_disc():
    camera = design(fill=0.15)
    sharp = SCENES["plane"](camera, seed=3, ratio=-0.25)
    (sheet,) = sharp.surfaces
    soft = replace(sheet, texture=cv2.GaussianBlur(sheet.texture, (0, 0), 6.0))
    found = measure(camera, replace(sharp, surfaces=(soft,)))
    discs, errors = found.at([-0.25])
    assert discs[0, 0] - errors[0, 0] < 0.15 * 40.0 * 0.29 + 0.2


def test_the_expected_disc_of_a_sharp_slope_is_near_the_truth_where_its_error_is_wide():
    camera = design(fill=0.2, focus=0.0)
    found = measure(camera, SCENES["slope"](camera, seed=3, left=0.2, right=0.35))
    discs, errors = found.at([0.25, 0.3])
    assert errors.min() > 1.0
    np.testing.assert_allclose(discs[0], [2.0, 2.4], atol=0.4)


def test_the_disc_is_found_where_windows_hardly_fit_between_the_shifts_of_small_lenses():
    camera = design(pitch=19.0, fill=0.28, focus=0.18)
    found = measure(camera, SCENES["plane"](camera, seed=3, ratio=-0.3))
    discs, _ = found.at([-0.3])
    assert discs[0, 0] == pytest.approx(0.28 * 19 * 0.48, abs=0.5)


def test_a_capture_of_noise_has_no_wider_disc_than_those_that_were_compared():
    # A usual aperture of 0.2 D would make discs of 11 px, and wider ones would not be unlikely.
    camera = Camera.design(size=(1200, 1000), pitch=100.0).calibration()
    rng = np.random.default_rng(4)
    found = lfcal.measure_lens_blur(
        lambda corners, side: rng.normal(0.5, 0.1, (len(corners), side, side)),
        camera,
        np.full(len(camera.lattice), -60.0),
        45.0,
    )
    assert 2 < found.discs.max() < 9.2


def test_too_few_lenses_tell_nothing():
    camera = design()
    calibration = camera.calibration()
    nothing = np.full(len(calibration.lattice), np.nan)
    assert (
        lfcal.measure_lens_blur(
            lambda corners, side: np.zeros((len(corners), side, side)), calibration, nothing, 10.0
        )
        is None
    )
