"""The defocus of the microlenses is measured on the flat alone."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfcal import Calibration, Lattice, LensBlur
from lfrender.detail.defocus import Defocus, measure_defocus


@functools.cache
def photographed(fill, ratio):
    camera = Camera.design(size=(420, 340), pitch=34.0, fill=fill)
    shot = simulate(SCENES["plane"](camera, ratio=ratio, seed=2), camera, samples=32, seed=4, noise=(8000, 5))
    flat, truth = shot.flat, shot.truth
    found = measure_defocus(
        lambda part: flat[part[1] : part[3], part[0] : part[2]], truth.calibration, truth.patch_size.astype(np.float32)
    )
    return flat, truth, found


def measured(fill, ratio):
    found = photographed(fill, ratio)[2]
    return found.diameters(ratio)[0], found


@pytest.mark.parametrize(("fill", "ratio"), [(0.28, -0.3), (0.2, -0.3), (0.28, 0.3)])
def test_the_disc_of_defocus_is_known_within_its_error(fill, ratio):
    # The aperture is that of the lens, and focus lies at s / D = 0.04.
    true = fill * 0.97 * 34.0 * abs(ratio - 0.04)
    blur = measured(fill, ratio)[1].blur
    assert blur.discs[0, 0] == pytest.approx(true, rel=0.25)
    assert abs(blur.discs[0, 0] - true) < 1.5 * blur.disc_errors[0, 0] < 1.3


def test_wider_lenses_blur_more():
    assert measured(0.28, -0.3)[0] > 1.2 * measured(0.2, -0.3)[0]


def test_one_depth_tells_the_disc_but_not_aperture_and_focus():
    blur = measured(0.28, -0.3)[1].blur
    assert blur.aperture_error > 0.1 * blur.aperture
    assert blur.focus_error[0] > 0.05
    assert blur.disc_errors[0, 0] < 0.25 * blur.discs[0, 0]


def test_the_disc_that_is_undone_is_not_larger_than_the_true_one():
    for fill, ratio in ((0.28, -0.3), (0.2, -0.3), (0.28, 0.3)):
        assert measured(fill, ratio)[0] < 1.1 * fill * 0.97 * 34.0 * abs(ratio - 0.04)


def test_noise_is_that_of_light_and_not_the_texture():
    # Three channels of 8000 electrons have 0.0065 of white together, 32 rays about as much.
    assert 0.006 < measured(0.28, -0.3)[1].noise < 0.016


def test_without_depth_nothing_is_measured():
    camera = Camera.design(size=(200, 160), pitch=23.2)
    shot = simulate(SCENES["blank"](camera), camera, samples=16, seed=4)
    nowhere = np.full(len(shot.truth.patch_size), np.nan, np.float32)
    flat = shot.flat
    assert measure_defocus(lambda p: flat[p[1] : p[3], p[0] : p[2]], shot.truth.calibration, nowhere) is None


def look_at(flat):
    return lambda part: flat[part[1] : part[3], part[0] : part[2]]


def known(discs):
    return LensBlur(7.0, 1.0, [0.0], [0.1], [-0.3], [[discs]], [[0.05]])


def test_a_known_blur_is_not_measured_again_at_its_depth():
    flat = np.full((300, 400, 3), 90, np.uint8)
    camera = Calibration(Lattice([20, 20], [[34, 0], [0, 34]], (400, 300), 16), lens_blur=known(2.0))
    near, far = (
        measure_defocus(look_at(flat), camera, np.full(len(camera.lattice), s, np.float32)) for s in (-10.2, -17.0)
    )
    assert near.diameters(-0.3)[0] == pytest.approx(2.0, abs=0.15)
    assert near.blur is camera.lens_blur
    assert far.blur is not camera.lens_blur


def test_of_several_types_the_sharpest_shows_how_soft_the_scene_is():
    discs = [tuple(np.abs(np.linspace(-0.8, 0.8, 33) - f) * 10) for f in (-0.1, -0.3, -0.5)]
    types, alone = Defocus(known(2.0), tuple(discs), 0.01), Defocus(known(2.0), tuple(discs[:1]), 0.01)
    assert types.diameters(-0.2)[1] < 0.1 * alone.diameters(-0.2)[0]


def test_compression_is_not_taken_for_blur():
    flat, truth, plain = photographed(0.28, -0.3)
    for quality in (50, 75, 90):
        coded = cv2.imdecode(cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
        found = measure_defocus(look_at(coded), truth.calibration, truth.patch_size.astype(np.float32))
        assert 0.6 < found.blur.discs[0, 0] / plain.blur.discs[0, 0] < 1.1
        # Less is known of it: what is surely undone becomes less, too.
        assert 0.4 < found.diameters(-0.3)[0] / plain.diameters(-0.3)[0] < 1.1
