"""The preset `fast` analyses a reduced flat, without losing modes or a twentieth of a pixel."""

from __future__ import annotations

import numba
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.presets import PRESETS


@pytest.fixture(scope="module")
def house():
    camera = Camera.design(size=(420, 340), pitch=23.2, rotation=1.3)
    return simulate(SCENES["house"](camera), camera, samples=24, seed=2)


@pytest.fixture(scope="module")
def found(house):
    return lfrender.analyze(house.flat, house.truth.calibration, "fast")


def test_fast_finds_modes_and_patch_sizes_to_a_twentieth_of_a_pixel(house, found):
    truth = house.truth
    known = (truth.mode != 0) & ~truth.mixed & (found.confidence > 0)
    assert PRESETS["fast"].factor(truth.calibration.lattice.pitch) == 2
    assert (found.mode == truth.mode)[known].mean() > 0.97
    assert (found.mode == -truth.mode)[known].mean() < 0.005
    assert np.nanmedian(np.abs(found.patch_size - truth.patch_size)[known]) < 0.05
    assert found.pitch == truth.calibration.lattice.pitch
    assert found.image_size == truth.calibration.image_size


def test_the_surface_of_fast_agrees_with_that_of_balanced(house, found):
    balanced = lfrender.analyze(house.flat, house.truth.calibration)
    centres = house.truth.calibration.lattice.centres()
    assert found.surface.spacing > balanced.surface.spacing
    assert np.median(np.abs(found.surface.at(centres) - balanced.surface.at(centres))) < 0.1


def test_a_region_analysed_by_fast_agrees_with_the_whole(house, found):
    calibration = house.truth.calibration
    width, height = calibration.image_size
    part = lfrender.analyze(house.flat, calibration, "fast", roi=(0, 0, 0.6 * width, height))
    both = (part.mode != 0) & (found.mode != 0)
    assert both.sum() > 0.4 * len(found)
    assert np.percentile(np.abs(part.patch_size - found.patch_size)[both], 95) < 0.05


def test_fast_gives_the_same_bits_with_one_thread(house, found):
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone = lfrender.analyze(house.flat, house.truth.calibration, "fast")
    finally:
        numba.set_num_threads(threads)
    assert (alone.surface.patch_size == found.surface.patch_size).all()
    np.testing.assert_array_equal(alone.patch_size, found.patch_size)


def test_balanced_locates_edges_and_fast_does_not():
    assert PRESETS["balanced"].edges and not PRESETS["fast"].edges
