"""Bundle adjustment from a cold start: the truth within the stated errors, outliers left out."""

from __future__ import annotations

import numpy as np

from lfcal.metric.bundle_adjustment import Observations, adjust
from lfcal.metric.camera_model import INTERNAL
from lfcal.metric.start import first_camera

from ._cameras import BOARD, PIXEL, camera, detect, observe, poses

FREE = (*INTERNAL[:5], "k1")


def _fit(true, where, rng, observations):
    start = first_camera(detect(true, where, rng), BOARD, (1600, 1200))
    assert start is not None
    return adjust(start[0], PIXEL, start[1], BOARD, observations, FREE)


def test_camera_and_poses_lie_within_the_stated_errors():
    rng = np.random.default_rng(3)
    true = camera(k1=-0.8)
    where = poses(rng)
    found = _fit(true, where, rng, observe(true, where, rng, 0.03))
    errors = np.sqrt(np.diag(found.covariance))
    chosen = [INTERNAL.index(name) for name in FREE]
    assert (np.abs(found.camera - true)[chosen] < 3.5 * errors[chosen]).all()
    off = found.poses.translation - where.translation
    stated = errors[14:-5].reshape(-1, 6)[:, 3:]
    assert (np.abs(off) < 3 * stated).all()
    assert abs(found.noise / 0.03 - 1) < 0.05


def test_five_per_cent_of_wrong_corners_are_left_out():
    rng = np.random.default_rng(4)
    true = camera(k1=-0.8)
    where = poses(rng, 6)
    clean = observe(true, where, rng, 0.03)
    wrong = rng.random(len(clean)) < 0.05
    position = clean.position + wrong[:, None] * rng.normal(0, 4, (len(clean), 2))
    found = _fit(
        true,
        where,
        rng,
        Observations(clean.pose, clean.corner, clean.centre, position, clean.error),
    )
    assert (found.weight[wrong] == 0).mean() > 0.97
    assert abs(found.camera[0] / true[0] - 1) < 0.003
