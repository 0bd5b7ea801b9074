"""Robust lattice fit of scenes from the shifts of single lenses."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.robust_fit import field_rms
from lfcal.scene_fit.fit import standard_error
from lfcal.scene_fit.irls import LensShifts, error_inflation, solve_irls


def test_one_lens_far_more_certain_than_the_others_moves_the_origin_only():
    """As on a photograph of one clear spot: sums of squares about a single position underflow."""
    i = np.arange(12) % 4
    j = np.arange(12) // 4
    step = np.random.default_rng(1).normal(size=(12, 2))
    variance = np.where(i + j == 0, 1e-60, 1e60)
    steps = LensShifts(np.column_stack([np.ones(12), i, j]), step, variance, 20 * np.eye(2))
    change, weight = solve_irls(steps)
    np.testing.assert_allclose(change, [step[0], [0, 0], [0, 0]], atol=1e-12)
    assert (weight[1:] == 0).all() and weight[0] > 0


def test_standard_error_with_inflation_is_the_spread_of_the_fits():
    """Weights depend on the residuals: with fixed ones a third of the error would be missing."""
    j, i = np.mgrid[-10:11, -12:13]
    design = np.column_stack([np.ones(i.size), i.ravel(), j.ravel()]).astype(float)
    rng = np.random.default_rng(3)
    stated = []
    found = []
    for _ in range(60):
        variance = rng.uniform(0.5, 2.0, len(design))
        step = rng.normal(0, 0.1, (len(design), 2)) * np.sqrt(variance)[:, None]
        steps = LensShifts(design, step, variance, 14.0 * np.eye(2))
        change, share = solve_irls(steps)
        stated.append(
            standard_error(steps, change, share, steps.design) * error_inflation(steps, share)
        )
        found.append(field_rms(steps.design, change))
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(
        np.sqrt(np.mean(np.square(stated))), rel=0.15
    )


def test_given_weights_select_the_solution_they_lead_to():
    rng = np.random.default_rng(2)
    design = np.column_stack([np.ones(600), rng.integers(-20, 20, (600, 2))])
    step = rng.normal(0, 0.01, (600, 2))
    misled = np.arange(600) < 250
    step[misled] += 1.0
    steps = LensShifts(design, step, np.full(600, 1e-4), np.eye(2) * 20)
    assert np.abs(solve_irls(steps)[0][0]).max() < 0.01
    again, share = solve_irls(steps, before=misled.astype(float))
    np.testing.assert_allclose(again[0], [1.0, 1.0], atol=0.01)
    assert share[~misled].max() == 0


def test_lenses_in_one_position_are_no_division_by_zero():
    steps = LensShifts(np.ones((30, 3)), np.full((30, 2), 0.1), np.full(30, 1e-4), np.eye(2) * 20)
    change, _ = solve_irls(steps)
    assert change.shape == (3, 2)
