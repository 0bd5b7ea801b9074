"""Light of single lenses."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal import Lattice
from lfcal.illumination.lens_light import find_unlit_in_scene


def test_missing_lens_is_a_defect_without_gain(drawn):
    truth = drawn("square", 24.0, 2.0, 30.0, size=(700, 500))
    image = truth.image()
    index = truth.index_of(np.array([[350.0, 250.0]]))
    x, y = np.rint(truth.centres(index)[0]).astype(int)
    image[y - 12 : y + 13, x - 12 : x + 13] = image.min()
    camera = lfcal.calibrate(image, kind="white")
    lenses = camera.defects.lenses
    assert len(lenses) == 1
    np.testing.assert_allclose(camera.lattice.points(lenses)[0], (x, y), atol=1)
    assert np.isnan(camera.gain()[y - 8 : y + 9, x - 8 : x + 9]).all()
    assert (camera.usable_radius() == 0).sum() == 1


def test_dark_lens_of_a_scene_is_unlit_if_all_around_are_lit():
    lattice = Lattice((9.0, 10.0), ((20.0, 0.0), (10.0, 17.3)), (300, 240), 9.0)
    rng = np.random.default_rng(0)
    light = rng.uniform(0.5, 1.0, (240, 300)).astype(np.float32)
    # One dark lens, and a dark corner of the scene, whose lenses may be lit.
    x, y = np.rint(lattice.points(np.array([[5, 6]]))[0]).astype(int)
    light[y - 10 : y + 11, x - 10 : x + 11] *= 0.01
    light[180:, 200:] *= 0.01
    rows = find_unlit_in_scene(np.sqrt(light), lattice)
    np.testing.assert_array_equal(lattice.indices()[rows], [[5, 6]])
