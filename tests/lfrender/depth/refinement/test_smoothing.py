"""Fits smoothed over planes, curved surfaces and depth edges."""

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.estimate import LensEstimates
from lfrender.depth.refinement.lens_plane import LensFits
from lfrender.depth.refinement.smoothing import smooth_fits
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.neighbours import neighbours_of

NOISE = 0.05
RADIUS = 8.5


def cameras(kind="hex"):
    lattice = Camera.design((600, 450), 20.0, kind).lattice
    return lattice, lattice.centres().astype(np.float32), neighbours_of(lattice)


def flat(centres):
    """A flat of these lenses, without pixels: smoothing takes only their places."""
    return GrayFlat(np.zeros((1, 1), np.float32), centres, RADIUS, 20.0)


def fits(sizes, noise=NOISE, seed=0):
    """Fits of these sizes with some noise, and slants of large errors."""
    rng = np.random.default_rng(seed)
    errors = np.broadcast_to(np.float32(noise), len(sizes)).copy()
    measured = (sizes + errors * rng.standard_normal(len(sizes))).astype(np.float32)
    slants = np.zeros((len(sizes), 2), np.float32)
    return LensFits(measured, errors, slants, np.full(len(sizes), 0.02, np.float32))


def smoothed(centres, neighbours, own, wanted=None):
    """Smoothed sizes and errors."""
    wanted = np.ones(len(centres), bool) if wanted is None else wanted
    joint = smooth_fits(flat(centres), neighbours, own, wanted)
    return joint.patch_size, joint.standard_error


@pytest.mark.parametrize("kind", ["hex", "square"])
@pytest.mark.parametrize("slant", [0.0, 0.0004])
def test_planes_of_many_lenses_come_out_as_planes(kind, slant):
    _, centres, neighbours = cameras(kind)
    truth = 1 / (-1 / 9.0 + (centres[:, 0] - 300) * slant / 9)
    own = fits(truth)
    sizes, errors = smoothed(centres, neighbours, own)
    away = np.abs(sizes - truth)
    assert np.median(away) < 0.25 * np.median(np.abs(own.patch_size - truth))
    assert 0.6 < np.mean(away <= errors) < 0.95


def test_depth_edges_stay_sharp():
    _, centres, neighbours = cameras()
    left = centres[:, 0] < 300
    truth = np.where(left, -9.0, -8.5)
    own = fits(truth)
    own.slant_error[:] = 0.004
    sizes, _ = smoothed(centres, neighbours, own)
    assert np.abs(sizes - truth).max() < 4 * NOISE
    at_edge = np.abs(centres[:, 0] - 300) < 20
    assert np.abs((sizes - truth)[at_edge & left].mean()) < 0.02


def test_an_uncertain_lens_between_two_depths_keeps_its_large_error():
    """Neighbours that differ by far more than their errors have little weight, however small these
    are.
    """
    _, centres, neighbours = cameras()
    truth = np.where(centres[:, 0] < 300, -9.0, -8.0)
    own = fits(truth, 0.01)
    doubtful = np.abs(centres[:, 0] - 300) < 10
    own.standard_error[doubtful] = 0.6
    own.patch_size[doubtful] = -8.5
    _, errors = smoothed(centres, neighbours, own)
    assert np.median(errors[doubtful]) > 0.1
    assert np.median(errors[~doubtful]) < 0.01


def test_lenses_with_few_inlier_neighbours_hardly_bias_distant_ones():
    """As beside depth edges, where lenses see a little of the other side and all err toward it."""
    _, centres, neighbours = cameras()
    across = (centres[:, 0] - 300) / 20
    mixed = np.abs(across) % 10 < 2
    truth = np.full(len(centres), -9.0)
    away = []
    for seed in range(4):
        own = fits(truth, seed=seed)
        own.slant_error[:] = 0.002
        own.patch_size[mixed] += (
            5 * NOISE * np.random.default_rng(seed).uniform(0, 1, mixed.sum()).astype(np.float32)
        )
        sizes, _ = smoothed(centres, neighbours, own)
        away.append((sizes - truth)[~mixed].mean())
    assert np.mean(away) < 0.23 * NOISE


def bowl(centres, curvature, noise=0.002):
    """A surface of this curvature [px / pitch^2]: sizes at the centres of lenses, their means over
    microimages, fits of these with noise, and which lenses see its central part.
    """
    away = (centres - centres.mean(0)) / 20.0
    truth = -9.0 + 0.5 * curvature * (away**2).sum(1)
    told = truth + 0.5 * curvature * (RADIUS / truth) ** 2 / 2
    own = fits(told, noise)
    own.slant[:] = -curvature * away / truth[:, None] + 0.004 * np.random.default_rng(
        1
    ).standard_normal(away.shape)
    own.slant_error[:] = 0.004
    return truth, told, own, (np.abs(away) < 5).all(1)


@pytest.mark.parametrize("curvature", [0.01, 0.02, 0.04])
def test_curved_surfaces_stay_so(curvature):
    _, centres, neighbours = cameras()
    truth, _, own, inner = bowl(centres, curvature)
    sizes, _ = smoothed(centres, neighbours, own)
    assert np.median(np.abs(sizes - truth)[inner]) < 0.0015 + 1.15 * np.median(
        np.abs(own.patch_size - truth)[inner]
    )


def test_lenses_of_unknown_error_have_no_influence():
    _, centres, neighbours = cameras()
    truth = np.full(len(centres), -9.0)
    own = fits(truth)
    wanted = np.ones(len(centres), bool)
    own.standard_error[::3] = np.inf
    own.patch_size[::3] = np.nan
    wanted[1::3] = False
    sizes, errors = smoothed(centres, neighbours, own, wanted)
    assert np.isnan(sizes[::3]).all() and np.isinf(errors[::3]).all()
    np.testing.assert_array_equal(sizes[1::3], own.patch_size[1::3])
    assert np.isfinite(sizes[2::3]).all()
    assert np.median(np.abs(sizes - truth)[2::3]) < 0.6 * np.median(
        np.abs(own.patch_size - truth)[2::3]
    )


def test_an_analysis_smooths_what_its_lenses_measure(monkeypatch):
    """Behind branches, where no plane is recognised for all."""
    camera = Camera.design((420, 320), 16.0, "hex")
    shot = simulate(SCENES["house"](camera, seed=21), camera, samples=32, seed=21, noise=(4000, 3))
    truth = shot.truth
    known = (truth.mode != 0) & ~truth.mixed & (truth.contrast > 0.03)

    def errors():
        depth = lfrender.analyze(shot.flat, truth.calibration)
        return np.abs(depth.patch_size - truth.patch_size)[known], depth.standard_error[known]

    away, stated = errors()
    monkeypatch.setattr(LensEstimates, "smooth", lambda estimates, *_: estimates)
    single, single_stated = errors()
    assert known.sum() > 100
    assert np.nanmedian(away) < 0.7 * np.nanmedian(single)
    assert np.median(stated) < 0.7 * np.median(single_stated)
    assert np.mean(away <= stated) > 0.55
