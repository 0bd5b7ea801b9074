"""Parameters join when the data ask for them, and only then; correlated errors widen what is
stated.
"""

from __future__ import annotations

import numpy as np

from lfcal.metric.bundle_adjustment import BASE, Observations, adjust, select_order
from lfcal.metric.camera_model import SHAPE, shape_derivatives
from lfcal.metric.uncertainty import describe_degeneracies, optics_of, pose_factor, rim_covariance

from ._cameras import BOARD, PIXEL, camera, observe, poses


def _fitted(values, seed, **shared):
    rng = np.random.default_rng(seed)
    where = poses(rng, 6, near=500, far=1100)
    seen = observe(values, where, rng, 0.02)
    if shared:
        # The same error in all microimages of a corner, as of a warped print.
        key = seen.pose * 54 + seen.corner
        moved = seen.position + rng.normal(0, shared["error"], (key.max() + 1, 2))[key]
        seen = Observations(seen.pose, seen.corner, seen.centre, moved, seen.error)
    return adjust(values, PIXEL, where, BOARD, seen, BASE), seen


def test_tilt_is_fitted_where_there_is_one_and_nothing_where_there_is_none():
    straight, seen = _fitted(camera(k1=-0.5), 1)
    assert select_order(straight, PIXEL, BOARD, seen).free == BASE
    tilted, seen = _fitted(camera(k1=-0.5, tilt_x=0.0035, tilt_y=-0.002), 1)
    # Fitted without the tilt first.
    tilted = adjust(camera(k1=-0.5), PIXEL, tilted.poses, BOARD, seen, BASE)
    found = select_order(tilted, PIXEL, BOARD, seen)
    assert set(found.free) - set(BASE) == {"tilt_x", "tilt_y"}
    assert abs(found.camera[10] - 0.0035) < 3 * np.sqrt(found.covariance[10, 10])


def test_errors_that_corners_share_widen_the_stated_ones():
    alone, _ = _fitted(camera(k1=-0.5), 2)
    assert alone.cluster < 1.3
    assert pose_factor(alone) < 2
    together, _ = _fitted(camera(k1=-0.5), 2, error=0.04)
    assert together.cluster > 3


def test_bend_of_the_board_is_fitted_and_does_not_pass_for_another_focal_length():
    rng = np.random.default_rng(5)
    values = camera(k1=-0.5)
    where = poses(rng, 6, near=500, far=1100)
    bent = np.array([0.3, -0.1, 0.0, 0.04, 0.0])
    seen = observe(values, where, rng, 0.02, board=BOARD + shape_derivatives(BOARD) @ bent)
    flat = adjust(values, PIXEL, where, BOARD, seen, BASE)
    found = select_order(flat, PIXEL, BOARD, seen)
    assert set(found.free) - set(BASE) == set(SHAPE)
    errors = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.shape - bent) < 3 * errors[-5:]).all()
    assert abs(found.camera[0] - values[0]) < 3 * errors[0]
    assert abs(flat.camera[0] - values[0]) > 3 * abs(found.camera[0] - values[0])


def test_errors_that_no_scatter_shows_widen_what_is_best_known():
    straight, seen = _fitted(camera(k1=-0.5), 4)
    # Corners at the rim of the microimages, 11.5 px from their centres, lie 0.004 px too far out.
    outward = seen.position + (seen.position - seen.centre) * (0.004 / 11.5)
    moved = Observations(seen.pose, seen.corner, seen.centre, outward, seen.error)
    found = adjust(straight.camera, PIXEL, straight.poses, BOARD, moved, BASE)
    own = slice(0, len(BASE))
    off = (found.camera - straight.camera)[own]
    stated = found.covariance[own, own]
    widened = stated + rim_covariance(found, PIXEL, moved, 11.5)[own, own]
    scale = np.sqrt(np.diag(stated))
    misfit = [
        off / scale @ np.linalg.solve(c / np.outer(scale, scale), off / scale)
        for c in (stated, widened)
    ]
    assert misfit[0] > 3 * misfit[1]
    # One error of 0.004 px, where 0.003 px of a standard error are allowed for.
    assert misfit[1] < 2.7


def test_lengths_that_hardly_separate_are_named():
    found, _ = _fitted(camera(k1=-0.5), 3)
    notes = describe_degeneracies(optics_of(found, PIXEL))
    assert any(
        "F, L and b hardly separate" in note and "D / s = A + B / Z" in note for note in notes
    )
