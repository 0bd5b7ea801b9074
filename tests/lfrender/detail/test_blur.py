"""Discs that are undone: those that the camera file surely tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_synth import Camera
from lfcal import LensBlur, LensTypes
from lfrender.detail.blur import sure_discs

RATIOS = np.array([-0.4, -0.2])


def camera(types=None):
    return replace(Camera.design(size=(480, 400), pitch=30.0).calibration(), lens_types=types)


def test_a_known_disc_counts_without_its_doubt():
    blur = LensBlur(8.0, 1.0, [0.0], [0.1], [-0.2, -0.4], [[1.0, 3.0]], [[0.5, 0.5]])
    found = sure_discs(replace(camera(), lens_blur=blur), RATIOS)
    np.testing.assert_allclose(found, [[3.0 - 0.84 * 0.5, 1.0 - 0.84 * 0.5]])


def test_of_several_types_the_sharpest_shows_how_soft_the_scene_is():
    i, j = np.mgrid[:3, :3]
    known = camera(LensTypes((i - j) % 3))
    assert not sure_discs(known, RATIOS).any()
    blur = LensBlur(8.0, 1.0, [0.1] * 3, [0.1] * 3, [-0.3], [[2.0], [3.0], [5.0]], [[1e-9]] * 3)
    found = sure_discs(replace(known, lens_blur=blur), RATIOS)
    np.testing.assert_allclose(found[:, 0], [0, np.sqrt(5), np.sqrt(21)], atol=1e-4)


def test_a_blur_of_another_number_of_types_is_not_taken():
    blur = LensBlur(8.0, 1.0, [0.1] * 2, [0.1] * 2, [-0.3], [[2.0], [3.0]], [[0.1]] * 2)
    assert not sure_discs(replace(camera(), lens_blur=blur), RATIOS).any()
