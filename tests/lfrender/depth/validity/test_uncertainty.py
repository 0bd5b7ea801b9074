"""Confidence and standard errors of lenses and planes."""

import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.matching.ambiguity import measure_ambiguity


def test_an_optimum_that_matches_as_well_over_fewer_pixels_is_a_rival():
    shifts = np.arange(41)

    def cost(rival):
        peaks = 0.9 * np.exp(-(((shifts - 12) / 2.0) ** 2)) + rival * np.exp(
            -(((shifts - 32) / 2.0) ** 2)
        )
        return 1 - (peaks * trust)[None].astype(np.float32)

    trust = np.linspace(1.0, 0.4, 41).astype(np.float32)
    no_rows = np.empty((1, 0), np.int32)
    best = np.array([12])
    yes = np.ones(1, bool)
    equal, less, none = (
        measure_ambiguity(cost(r), trust, no_rows, best, yes, 2)[0] for r in (0.9, 0.6, 0.0)
    )
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
    shot = simulate(
        SCENES["blank"](Camera.design(size=(260, 220))),
        Camera.design(size=(260, 220)),
        samples=8,
        seed=2,
    )
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
    return simulate(
        SCENES["periodic"](camera, ratio=ratio, period=period), camera, samples=16, seed=2
    )


def test_a_texture_that_repeats_along_the_lattice_yields_no_confident_wrong_depth():
    for ratio, period in ((-0.45, 0.6), (0.3, 0.4)):
        shot = _periodic(ratio, period)
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        wrong = np.abs(depth.patch_size - shot.truth.patch_size) > 0.5
        assert (wrong & (depth.confidence > 0.5)).mean() < 0.01


def test_planes_err_as_much_as_they_state():
    # All lenses of a plane err together, so that it takes many planes to tell.
    excess = []
    for seed, ratio in enumerate((-0.5, -0.34, -0.18, 0.15, 0.25, 0.35)):
        camera = Camera.design((300, 240), 15.0, rotation=3.0 * seed)
        scene = SCENES["plane"](camera, ratio=ratio, seed=seed)
        shot = simulate(scene, camera, samples=16, seed=seed, noise=(4000.0, 4.0))
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        known = (shot.truth.mode != 0) & (depth.mode != 0)
        error = (depth.patch_size - shot.truth.patch_size)[known]
        excess.append(np.mean((error / depth.standard_error[known]) ** 2))
    assert 0.45 < np.sqrt(np.mean(excess)) < 1.5
