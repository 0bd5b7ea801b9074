"""Illumination of white images and scene captures."""

from __future__ import annotations

import json

import cv2
import numba
import numpy as np

import lfcal
from lfcal.gain.rows import RegionGain
from lfcal.illumination.measure import measure_illumination
from lfcal.images.preprocessing import sqrt_luminance


def test_result_does_not_depend_on_the_number_of_threads(drawn):

    truth = drawn("hexagonal", 14.3, 3.0, 26.0, size=(500, 400), hot=20, dust=4)
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 7.0)
    picture = sqrt_luminance(truth.image())
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS), 1):
            numba.set_num_threads(threads)
            found.append(measure_illumination(picture, lattice, white=True))
    finally:
        numba.set_num_threads(before)
    for other in found[1:]:
        assert json.dumps(other.gain_map.to_dict()) == json.dumps(found[0].gain_map.to_dict())
        np.testing.assert_array_equal(other.gain_map.level, found[0].gain_map.level)
        assert other.gain_map == found[0].gain_map
        np.testing.assert_array_equal(other.defects.pixels, found[0].defects.pixels)
    assert len(found[0].defects.pixels) > 20


def test_scene_with_much_contrast_gives_the_profile_to_a_percent():
    """Blobs of light 2 to 6 px wide, each microimage its own: levels of lenses differ by more than
    half.
    """

    rng = np.random.default_rng(5)
    size = (1000, 800)
    radius = 9.0
    lattice = lfcal.Lattice((9.3, 11.8), np.array([[20.4, 0.7], [9.6, 17.9]]), size, radius)
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float32)

    scene = np.exp(
        3 * cv2.GaussianBlur(rng.standard_normal((size[1], size[0])), (0, 0), 4) / 0.07 * 0.25
    )
    points = np.column_stack([x.ravel(), y.ravel()])
    index = np.rint(lattice.to_index(points))
    far = np.full(len(points), np.inf)
    for step in [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
        far = np.minimum(far, np.hypot(*(points - lattice.points(index + step)).T))
    light = (np.clip(radius + 0.5 - far, 0.05, 1) * (1 - 0.1 * (far / radius) ** 2)).reshape(
        x.shape
    )
    seen = measure_illumination(sqrt_luminance(scene * light), lattice, white=False)
    gain = RegionGain(seen.gain_map, lattice).at(0, 0, *lattice.image_size)
    core = far.reshape(x.shape) < 0.9 * radius
    ratio = gain[core] / light[core]
    assert ratio.std() / ratio.mean() < 0.01
    outer = far.reshape(x.shape)[core] > 0.75 * radius
    assert abs(ratio[outer].mean() / ratio[~outer].mean() - 1) < 0.01


def test_bright_objects_before_black_make_no_vignetting():
    """Each lens sees an object that reaches over its rim, and black in its middle."""
    lattice = lfcal.Lattice((9.3, 11.8), np.array([[20.4, 0.7], [9.6, 17.9]]), (600, 500), 9.0)
    y, x = np.mgrid[:500, :600]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    index = np.rint(lattice.to_index(points)).astype(int)
    far = np.hypot(*(points - lattice.points(index)).T).reshape(x.shape)
    scene = np.clip((far - 2) / 7, 0.3, 1)
    seen = measure_illumination(np.sqrt(scene).astype(np.float32), lattice, white=False)
    gain = RegionGain(seen.gain_map, lattice).at(0, 0, *lattice.image_size)
    np.testing.assert_array_equal(gain, 1)
    assert "drawn without vignetting" in seen.warnings[0]
