"""Confidence and standard errors of lenses and planes."""

import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.matching.ambiguity import measure_ambiguity
from lfrender.depth.validity.uncertainty import (
    combine_confidence,
    confirmed_by_neighbours,
    has_secondary_peak,
    inflate_errors,
    repeats_with_neighbours,
)

# Lens 0 in the middle of a hexagon of six; the others have it as their only neighbour.
_ROWS = np.array([[1, 2, 3, 4, 5, 6], *([[0, -1, -1, -1, -1, -1]] * 6)], np.int32)


def test_an_error_grows_with_the_texture_that_is_not_matched():
    wide = inflate_errors(np.full(3, 0.1), np.array([1.0, 0.7, 0.4]))
    assert abs(wide[0] - 0.1) < 0.01
    assert 1.2 < wide[1] / wide[0] < 1.4
    assert 1.7 < wide[2] / wide[0] < 2.2


def test_scattered_or_unmeasured_pairs_reduce_confidence():
    firm, loose, unmeasured = combine_confidence(np.ones(3), np.array([0.05, 0.9, np.inf]), 23.0)
    assert firm > 0.98
    assert loose < 0.5
    assert unmeasured <= 0.5


def test_a_faint_lens_is_confirmed_by_two_good_ones_beside_it_and_not_by_one():
    sizes = np.array([-6.0, -6.2, -5.9, -9.0, -9.0, 3.0, 3.0])
    resolved = np.array([False, *[True] * 6])
    good = np.array([0.1, *[0.8] * 6])
    assert confirmed_by_neighbours(resolved, sizes, good, _ROWS, 23.0)[0]
    good[1] = 0.1
    assert not confirmed_by_neighbours(resolved, sizes, good, _ROWS, 23.0)[0]


def test_ambiguous_neighbours_are_periodic_unless_one_depth_occurs_elsewhere():
    ambiguous = np.full(7, 0.3)
    assert repeats_with_neighbours(np.ones(7, bool), ambiguous, np.zeros(7, bool), np.zeros(7, bool), _ROWS).all()
    # One in three of a larger flat is ambiguous: the lens in the middle with half of its neighbours.
    rivals = np.array([*ambiguous[:4], *np.ones(8)])
    rows = np.vstack([[[1, 2, 3, 4, 5, 6]], np.full((11, 6), -1)]).astype(np.int32)
    resolved, nowhere, quiet = np.ones(12, bool), np.zeros(12, bool), np.zeros(12, bool)
    assert repeats_with_neighbours(resolved, rivals, quiet, nowhere, rows).tolist() == [True, *[False] * 11]
    assert not repeats_with_neighbours(resolved, rivals, quiet, ~nowhere, rows).any()
    assert not repeats_with_neighbours(resolved, np.where(np.arange(12) == 3, 1.0, rivals), quiet, nowhere, rows).any()


def test_periodic_texture_has_a_secondary_peak_and_two_depths_in_one_lens_have_not():
    matched, echo = np.array([0.95, 0.6, 0.5, 0.9]), np.array([0.5, 0.35, 0.35, 0.22])
    # Half of the third is noise: the rest matches at both shifts.
    signal = np.array([1.0, 1.0, 0.5, 1.0])
    assert has_secondary_peak(matched, echo, signal).tolist() == [True, False, True, False]
    # If most lenses are periodic, those between them are too.
    most = np.array([False, True, True, True, True, False, False])
    sure = np.ones(7)
    assert repeats_with_neighbours(np.ones(7, bool), sure, most, np.zeros(7, bool), _ROWS)[:5].all()
    assert not repeats_with_neighbours(np.ones(7, bool), sure, np.arange(7) == 0, np.zeros(7, bool), _ROWS).any()


def test_an_optimum_that_matches_as_well_over_fewer_pixels_is_a_rival():
    shifts = np.arange(41)

    def cost(rival):
        peaks = 0.9 * np.exp(-(((shifts - 12) / 2.0) ** 2)) + rival * np.exp(-(((shifts - 32) / 2.0) ** 2))
        return 1 - (peaks * trust)[None].astype(np.float32)

    trust = np.linspace(1.0, 0.4, 41).astype(np.float32)
    no_rows, best, yes = np.empty((1, 0), np.int32), np.array([12]), np.ones(1, bool)
    equal, less, none = (measure_ambiguity(cost(r), trust, no_rows, best, yes, 2)[0][0] for r in (0.9, 0.6, 0.0))
    # As seen, the rival's cost is 0.5 against 0.3.
    assert abs(equal - 0.5) < 0.05
    assert less > 0.98
    assert none == 1


@functools.cache
def _traced_near_zero(ratio):
    camera = Camera.design(size=(300, 260), pitch=23.2, rotation=1.3)
    return simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=16, seed=2)


@pytest.mark.parametrize("ratio", [-0.02, -0.01])
def test_planes_near_zero_patch_size_are_resolved_by_how_they_move(ratio):
    shot = _traced_near_zero(ratio)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    error = np.abs(depth.patch_size - shot.truth.patch_size)
    assert (depth.mode == -1).mean() > 0.9
    assert np.nanquantile(error, 0.95) < 0.05


def test_shading_that_stays_with_its_lens_is_no_depth_however_strong():
    shot = simulate(SCENES["blank"](Camera.design(size=(260, 220))), Camera.design(size=(260, 220)), samples=8, seed=2)
    calibration = shot.truth.calibration
    y, x = np.mgrid[: shot.flat.shape[0], : shot.flat.shape[1]]
    index = calibration.lattice.to_index(np.stack([x, y], -1).reshape(-1, 2))
    delta = (index - np.rint(index)) @ calibration.lattice.basis
    bump = 1 - 0.1 * np.exp(-(delta**2).sum(1) / 20).reshape(y.shape)
    depth = lfrender.analyze(np.rint(shot.flat * bump[..., None]).astype(np.uint8), calibration)
    assert (depth.mode != 0).mean() < 0.02


@functools.cache
def _periodic(ratio, period):
    camera = Camera.design(size=(360, 300), pitch=24.0, lattice="square")
    return simulate(SCENES["periodic"](camera, ratio=ratio, period=period), camera, samples=16, seed=2)


def test_a_texture_that_repeats_along_the_lattice_yields_no_confident_wrong_depth():
    for ratio, period in ((-0.45, 0.6), (0.3, 0.4)):
        shot = _periodic(ratio, period)
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        wrong = np.abs(depth.patch_size - shot.truth.patch_size) > 0.5
        assert (wrong & (depth.confidence > 0.5)).mean() < 0.01


def test_planes_err_as_much_as_they_state():
    # All lenses of a plane err together, so that it takes many planes to tell.
    excess = []
    for seed, ratio in enumerate((-0.5, -0.42, -0.34, -0.26, -0.18, 0.15, 0.2, 0.25, 0.3, 0.35)):
        camera = Camera.design((420, 320), 15.0, rotation=3.0 * seed)
        scene = SCENES["plane"](camera, ratio=ratio, seed=seed)
        shot = simulate(scene, camera, samples=32, seed=seed, noise=(4000.0, 4.0))
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        known = (shot.truth.mode != 0) & (depth.mode != 0)
        error = (depth.patch_size - shot.truth.patch_size)[known]
        excess.append(np.mean((error / depth.standard_error[known]) ** 2))
    assert 0.45 < np.sqrt(np.mean(excess)) < 1.5
