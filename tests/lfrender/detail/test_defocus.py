"""The defocus of the microlenses is measured on the flat alone."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfrender.detail.defocus import Defocus, measure_defocus


@functools.cache
def measured(fill, ratio):
    camera = Camera.design(size=(420, 340), pitch=34.0, fill=fill)
    shot = simulate(SCENES["plane"](camera, ratio=ratio, seed=2), camera, samples=32, seed=4, noise=(8000, 5))
    flat, truth = shot.flat, shot.truth
    found = measure_defocus(
        lambda part: flat[part[1] : part[3], part[0] : part[2]], truth.calibration, truth.patch_size.astype(np.float32)
    )
    return found.diameters(ratio)[0], found


@pytest.mark.parametrize(("fill", "ratio"), [(0.28, -0.3), (0.2, -0.3), (0.28, 0.3)])
def test_the_disc_of_defocus_is_known_to_a_quarter(fill, ratio):
    # The aperture is that of the lens, and focus lies at s / D = 0.04.
    true = fill * 0.97 * 34.0 * abs(ratio - 0.04)
    assert measured(fill, ratio)[0] == pytest.approx(true, rel=0.25)


def test_wider_lenses_blur_more():
    assert measured(0.28, -0.3)[0] > 1.2 * measured(0.2, -0.3)[0]


def test_one_depth_tells_the_disc_but_not_aperture_and_focus():
    found = measured(0.28, -0.3)[1]
    assert found.aperture_error > 0.15 * found.aperture
    assert found.focus_error[0] > 0.05


def test_noise_is_below_that_of_the_flat():
    # 8000 electrons are 1 % of white at most, 32 rays about as much.
    assert 0.001 < measured(0.28, -0.3)[1].noise < 0.02


def test_without_depth_nothing_is_measured():
    camera = Camera.design(size=(200, 160), pitch=23.2)
    shot = simulate(SCENES["blank"](camera), camera, samples=16, seed=4)
    nowhere = np.full(len(shot.truth.patch_size), np.nan, np.float32)
    flat = shot.flat
    assert measure_defocus(lambda p: flat[p[1] : p[3], p[0] : p[2]], shot.truth.calibration, nowhere) is None


def test_of_several_types_the_sharpest_shows_how_smooth_the_scene_is():
    types = Defocus(10.0, (-0.1, -0.3, -0.5), 1.0, (0.1, 0.1, 0.1), 0.01, 2.7)
    alone = Defocus(10.0, (-0.1,), 1.0, (0.1,), 0.01, 2.7)
    assert types.diameters(-0.2)[1] < 0.5 * alone.diameters(-0.2)[0]
