"""One plane for the lenses of a flat: scenes that are one plane, and scenes that only look like it."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from data_synth.scenes import plane
from lfcal import Lattice
from lfrender.depth.plane_depth import fit_regular_plane
from lfrender.flat.lens_graph import opposite_neighbours

_PITCH, _ERROR = 20.0, 0.05


def _plane(slope: float, count_over_lenses: float):
    """What `fit_regular_plane` finds where all lenses lie on a plane, `1 / s` of which falls by the share `slope`."""
    lattice = Lattice(np.array([15.0, 15.0]), _PITCH * np.array([[1, 0], [0.5, 0.75**0.5]]), (800, 600), 9.5)
    centres = lattice.centres()
    across = centres[:, 0] / centres[:, 0].max() - 0.5
    sizes = 6 / (1 + slope * across) + np.random.default_rng(2).normal(0, _ERROR, len(centres))
    return fit_regular_plane(
        centres,
        int(len(centres) * count_over_lenses),
        _PITCH,
        sizes.astype(np.float32),
        np.full(len(centres), _ERROR, np.float32),
        np.zeros(len(centres), np.int8),
        np.zeros(len(centres)),
        np.hstack(opposite_neighbours(lattice)),
    )


@pytest.mark.parametrize("count_over_lenses", [1, 5])
def test_a_plane_that_faces_the_camera_is_accepted_from_few_lenses(count_over_lenses):
    found = _plane(0, count_over_lenses)
    assert found is not None and not found.slanted
    assert found.at(np.array([[400.0, 300.0]])) == pytest.approx(6, abs=0.01)


def test_a_slanted_plane_is_accepted_only_from_most_lenses():
    found = _plane(0.3, 1)
    assert found is not None and found.slanted
    assert found.at(np.array([[10.0, 300.0]])) == pytest.approx(6 / 0.85, abs=0.05)
    assert _plane(0.3, 5) is None


def test_all_lenses_of_a_plane_have_one_patch_size_within_a_hundredth_of_a_pixel(scenes):
    shot = scenes.one_plane()
    full, quick = scenes.both(shot)
    resolved = quick.mode != 0
    assert resolved.mean() > 0.99
    for depth in (full, quick):
        known = depth.patch_size[depth.mode != 0]
        assert np.ptp(known) == 0
        assert abs(known[0] - 0.3 * 23.2) < 0.01
        assert np.abs(depth.surface.patch_size - 0.3 * 23.2).max() < 0.01


@pytest.mark.parametrize(
    ("scene", "options", "noise"),
    [("slope", {}, None), ("plane", {"ratio": -0.5}, (400, 10)), ("slope", {}, (1500, 8))],
)
def test_slanted_and_noisy_planes_are_detected_and_agree_with_the_exhaustive_search(scenes, scene, options, noise):
    shot = scenes.shot_of(*SCENES[scene](scenes.camera(), **options).surfaces, noise=noise)
    full, quick = scenes.both(shot)
    assert scenes.agreement(full, quick) > 0.99
    for depth in (full, quick):
        error = np.abs(depth.patch_size - shot.truth.patch_size)[shot.truth.mode != 0]
        assert np.isfinite(error).mean() > 0.99
        assert np.nanquantile(error, 0.95) < 0.025


@pytest.mark.parametrize("lattice", ["hex", "square"])
@pytest.mark.parametrize("ratio", [-0.4, 0.3])
def test_planes_of_thousands_of_small_lenses_are_detected(scenes, lattice, ratio):
    small = Camera.design((1000, 800), 14.0, lattice=lattice, rotation=2.0)
    shot = simulate(plane(small, ratio=ratio), small, samples=16, seed=3, noise=(12000, 5))
    # Among thousands of lenses some match better elsewhere by chance.
    full, quick = scenes.both(shot)
    assert scenes.agreement(full, quick) > 0.99


@pytest.mark.parametrize(("scene", "options"), [("slope", {}), ("plane", {"ratio": -0.4}), ("plane", {"ratio": 0.2})])
def test_planes_of_large_microimages_are_measured_at_full_resolution(scenes, scene, options):
    large = Camera.design(size=(1000, 760), pitch=52.0, lattice="hex", rotation=2.0)
    shot = simulate(SCENES[scene](large, **options), large, samples=24, seed=4, noise=(8000, 4))
    _, quick = scenes.both(shot)
    known = (quick.mode != 0) & (shot.truth.mode != 0)
    error = np.abs(quick.patch_size - shot.truth.patch_size)[known]
    assert np.median(error) < 0.01
    assert np.median(error / quick.standard_error[known]) < 2


def test_a_slant_of_four_hundredths_of_a_pixel_over_the_flat_is_measured(scenes):
    """Its few samples do not tell the slant from noise: 0.04 px over the whole flat."""
    shot = simulate(
        SCENES["slope"](scenes.camera(), left=0.199, right=0.201), scenes.camera(), samples=24, seed=4, noise=(8000, 4)
    )
    for depth in scenes.both(shot):
        error = (depth.patch_size - shot.truth.patch_size)[(depth.mode != 0) & (shot.truth.mode != 0)]
        assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("ratio", [0.33, -0.3])
def test_a_small_card_before_a_plane_is_not_overlooked(scenes, ratio):
    shot = scenes.shot_of(*plane(scenes.camera(), ratio=0.3).surfaces, scenes.card(ratio, (250, 200), (370, 300)))
    full, quick = scenes.both(shot)
    centres = shot.truth.calibration.lattice.centres()
    on_card = ((centres > (285, 235)) & (centres < (335, 265))).all(1)
    assert on_card.sum() >= 3
    assert np.abs(quick.patch_size[on_card] - ratio * 23.2).max() < 0.2
    assert scenes.agreement(full, quick) > 0.99
