"""Normal equations and planes of kernels, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.depth.refinement.least_squares import (
    add_point,
    geman_mcclure,
    no_points,
    solve_plane,
    solve_symmetric,
)


def test_terms_that_are_kept_have_the_schur_complement_of_the_others():
    rng = np.random.default_rng(0)
    equations = rng.standard_normal((40, 6))
    priors = np.array([0, 0, 0, 0.5, 2, 7])
    sums = equations.T @ equations
    known = (sums + np.diag(priors))[2:, 2:]
    expected = sums[:2, :2] - sums[:2, 2:] @ np.linalg.solve(known, sums[2:, :2])
    solved = np.tril(sums)
    solve_symmetric(solved, priors, 2)
    np.testing.assert_allclose(np.tril(solved[:2, :2]), np.tril(expected), rtol=1e-5)


def test_a_term_that_the_prior_fixes_takes_no_part():
    sums = np.array([[2.0, 0], [1.5, 3]])
    solve_symmetric(sums, np.array([0, 1e12]), 1)
    assert sums[0, 0] == pytest.approx(2, abs=1e-6)


def _sums(points, weights, zero=0.0):
    sums = no_points(zero)
    for weight, (x, y, value) in zip(weights, points, strict=True):
        sums = add_point(sums, weight, x, y, value)
    return sums


def test_plane_through_points_is_that_of_numpy_with_its_variances():
    rng = np.random.default_rng(1)
    points = rng.standard_normal((9, 3))
    weights = rng.uniform(0.2, 1, 9)
    prior = 0.8
    plane = solve_plane(_sums(points, weights), prior)
    terms = np.column_stack([np.ones(9), points[:, :2]])
    inverse = np.linalg.inv(terms.T @ (weights[:, None] * terms) + np.diag([0, prior, prior]))
    np.testing.assert_allclose(plane[:3], inverse @ terms.T @ (weights * points[:, 2]), rtol=1e-10)
    np.testing.assert_allclose(plane[3:], np.diag(inverse), rtol=1e-10)


def test_one_point_and_a_prior_give_a_level_plane():
    plane = solve_plane(_sums([(0.0, 0.0, 4.0)], [2.0]), 5.0)
    np.testing.assert_allclose(plane, [4, 0, 0, 0.5, 0.2, 0.2])


def test_a_residual_of_the_scale_has_a_quarter_of_the_weight():
    assert geman_mcclure(9.0, 9.0) == 0.25
    assert geman_mcclure(0.0, 9.0) == 1
