"""The preset `fast`: it looks at a smaller flat, and must not lose modes, places or a twentieth of a pixel there."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.matching.cost_volume import compute_pair_costs
from lfrender.depth.presets import PRESETS
from lfrender.flat.gray_flat import make_gray_flat
from lfrender.flat.lens_graph import neighbour_rows
from lfrender.flat.microimages import extract_strips


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


def test_the_surface_of_fast_lies_where_that_of_balanced_lies(house, found):
    balanced = lfrender.analyze(house.flat, house.truth.calibration)
    centres = house.truth.calibration.lattice.centres()
    assert found.surface.spacing > balanced.surface.spacing
    assert np.median(np.abs(found.surface.at(centres) - balanced.surface.at(centres))) < 0.1


def test_a_region_of_fast_has_the_answers_of_the_whole(house, found):
    calibration = house.truth.calibration
    width, height = calibration.image_size
    part = lfrender.analyze(house.flat, calibration, "fast", roi=(0, 0, 0.6 * width, height))
    both = (part.mode != 0) & (found.mode != 0)
    assert both.sum() > 0.4 * len(found)
    assert np.percentile(np.abs(part.patch_size - found.patch_size)[both], 95) < 0.05


def test_a_still_frame_of_fast_keeps_its_depth(house, found):
    rng = np.random.default_rng(3)
    noisy = np.clip(house.flat + rng.integers(-1, 2, house.flat.shape), 0, 255).astype(np.uint8)
    first = lfrender.analyze(noisy, house.truth.calibration, "fast")
    changed = noisy.copy()
    changed[: len(noisy) // 4] = np.roll(noisy, 9, 1)[: len(noisy) // 4]
    after = lfrender.analyze(changed, house.truth.calibration, "fast", previous=(noisy, first))
    assert 0.5 < after.saved["still"] < 0.9
    kept = house.truth.calibration.lattice.centres()[:, 1] > 0.5 * len(noisy)
    # Noise alone may make a lens or two look new.
    assert np.isclose(after.filled_patch_size, first.filled_patch_size, rtol=1e-6)[kept].mean() > 0.97


def test_fast_gives_the_same_bits_with_one_thread(house, found):
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone = lfrender.analyze(house.flat, house.truth.calibration, "fast")
    finally:
        numba.set_num_threads(threads)
    assert (alone.surface.patch_size == found.surface.patch_size).all()
    np.testing.assert_array_equal(alone.patch_size, found.patch_size)


@pytest.mark.parametrize("row_step", [1, 2])
def test_strips_match_as_the_flat_itself(house, row_step):
    calibration = house.truth.calibration
    gray = make_gray_flat(house.flat, calibration)
    lattice = calibration.lattice
    rows = neighbour_rows(lattice, lattice.steps)[:, : len(lattice.steps) // 2]
    means = np.full(len(lattice), 0.4, np.float32)
    strips = extract_strips(gray, means, row_step)
    assert 0.6 < strips.complete.mean() < 1
    shifts = np.arange(-14, 15, 2).astype(np.float32)
    few = (np.arange(len(lattice)) % 4 == 0).astype(bool)
    quick, slow = (
        compute_pair_costs(gray, rows, means, means, few, shifts, 0.004, 0.02, row_step, strips=s)
        for s in (strips, replace(strips, whole=np.zeros(len(lattice), bool)))
    )
    # Pixels at the rim differ: one way goes by their distance from the centre, the other from the pixel in the middle.
    assert np.corrcoef(quick.ravel(), slow.ravel())[0, 1] > 0.9
    assert np.median(np.abs(quick - slow)) < 0.02
    # Where few are shared both go by the distance, but every other row of theirs may be another one.
    far = np.abs(shifts) > 12
    tried = few[:, None] & (rows >= 0)
    assert (quick[tried][:, far] < 1).mean() > 0.3
    if row_step == 1:
        assert (np.abs(quick - slow)[tried][:, far] < 1e-3).mean() > 0.999
