"""Light of single lenses."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal import Lattice
from lfcal.gain.gain_map import GainMap
from lfcal.illumination.lens_light import LensMeasurements, find_unlit_in_scene, fit_lens_lights


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


def test_few_pixels_that_scatter_little_by_chance_are_no_proof_of_another_light():
    lattice = Lattice((9.0, 9.0), ((18.0, 0.0), (0.0, 18.0)), (720, 540), 9.0)
    count = len(lattice)
    rng = np.random.default_rng(0)
    scatter = np.full(count, 0.04)
    light = rng.normal(1, 0.01, count)
    # The errors are 0.01; that of the first lens looks like 0.005.
    scatter[0] = 0.02
    light[0] = 1.028
    scatter[1] = 0.02
    light[1] = 1.08
    ones = np.ones(count)
    found = LensMeasurements(*np.float32([light, 16 * ones, scatter, light]))
    own = fit_lens_lights(found, lattice, GainMap.round(np.ones(40), 0.25, 9.0)).gain.lens_gain
    assert own[0] == 1
    assert own[1] > 1.05


def test_where_the_lit_part_ends_lenses_have_their_own_light(drawn):
    truth = drawn("hexagonal", 16.0, 3.0, 34.0, size=(640, 480), hot=0)
    y, x = np.mgrid[:480, :640]
    lit = 1 / (1 + np.exp((np.hypot(x - 320, y - 240) - 220) / 8))
    camera = lfcal.calibrate((truth.image() * lit).astype(np.uint16), kind="white")
    assert len(camera.defects.lenses) > 50
    # The sensor has no defects there, and the map follows the light.
    assert len(camera.defects.pixels) < 1e-3 * lit.size
    ratio = np.nan_to_num(camera.gain()) / (truth.light() * lit)
    inside = (truth.light() > 0.5) & (lit > 0.1)
    error = ratio[inside] / np.median(ratio[inside & (lit > 0.95)]) - 1
    assert np.quantile(np.abs(error), 0.95) < 0.5


def test_stray_light_without_the_shape_of_a_microimage_is_no_lens():
    lattice = Lattice((9.0, 9.0), ((18.0, 0.0), (0.0, 18.0)), (720, 540), 9.0)
    count = len(lattice)
    ones = np.ones(count)
    shaped = ones.copy()
    # As bright as a quarter of the lenses, but even.
    light = np.where(np.arange(count) < 5, 0.25, 1)
    shaped[:5] = 0.1
    found = LensMeasurements(*np.float32([light, 48 * ones, 0.05 * light, shaped]))
    lights = fit_lens_lights(found, lattice, GainMap.round(np.ones(40), 0.25, 9.0))
    np.testing.assert_array_equal(lights.unlit, np.arange(5))
