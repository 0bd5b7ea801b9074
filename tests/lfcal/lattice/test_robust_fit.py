"""Robust least squares of a lattice: outliers have no weight, errors are those of the rest."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.robust_fit import fit_affine, tukey_weights

_CHANGE = np.array([[0.3, -0.2], [0.01, 0.004], [-0.006, 0.02]])


@pytest.fixture
def shifts():
    """Indices, and shifts of 0.05 px noise an axis; every fifth is an outlier to one side."""
    rng = np.random.default_rng(4)
    index = rng.integers(-15, 16, (400, 2))
    design = np.column_stack([np.ones(len(index)), index])
    values = design @ _CHANGE + 0.05 * rng.standard_normal(index.shape)
    values[::5] += [3.0, 1.0]
    return design, values


def test_affine_fit_ignores_a_fifth_of_outliers(shifts):
    design, values = shifts
    change, weight = fit_affine(design, values, np.ones(len(design)))
    np.testing.assert_allclose(design @ change, design @ _CHANGE, atol=0.02)
    assert (weight[::5] == 0).all() and (weight > 0).sum() > 300
    # Half of the good ones keep at least three quarters of their weight.
    assert np.median(weight[weight > 0]) > 0.75


def test_affine_fit_leaves_out_shifts_without_prior_weight(shifts):
    design, values = shifts
    prior = np.ones(len(design))
    prior[::5] = 0
    values[::5] = 1e9
    change, weight = fit_affine(design, values, prior)
    np.testing.assert_allclose(change, _CHANGE, atol=0.01)
    assert (weight[::5] == 0).all()


def test_weights_follow_the_median_and_not_the_outliers():
    weight, variance = tukey_weights(np.array([1.386] * 9 + [1e6]))
    assert variance == pytest.approx(1.0)
    assert weight[-1] == 0 and (weight[:9] > 0.8).all()
