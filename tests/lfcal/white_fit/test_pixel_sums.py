"""Normal equations of lenses from single pixels."""

from __future__ import annotations

import numpy as np

from lfcal.white_fit.pixel_sums import Comparison


def _pixels():
    rng = np.random.default_rng(2)
    lens = np.repeat([0, 2], 2000)
    table = rng.normal(size=(4000, 4))
    true = np.array([0.1, -0.2, 0.3, 0.05])
    return lens, table @ true + 0.01 * rng.standard_normal(4000), table, true


def test_sums_are_those_of_each_lens_and_outliers_have_no_weight():
    lens, residual, table, true = _pixels()
    # Near the solution, where residuals are noise and a few outliers.
    miss = residual - table @ true
    miss[::50] += 5
    sums = Comparison(lens, miss, table).sums(3)
    assert (sums.normal[1] == 0).all() and (sums.right[1] == 0).all()
    for number in (0, 2):
        normal = np.triu(sums.normal[number]) + np.triu(sums.normal[number], 1).T
        assert np.abs(np.linalg.solve(normal, sums.right[number])).max() < 0.002
        own = table[lens == number]
        np.testing.assert_allclose(normal * 1e-4, own.T @ own, rtol=0.3, atol=120)


def test_soft_weights_never_vanish():
    lens, residual, table, true = _pixels()
    miss = residual - table @ true
    miss[7] = 1e3
    hard, soft = (Comparison(lens, miss, table).sums(3, one) for one in (False, True))
    assert np.abs(soft.right[0] - hard.right[0]).max() > 1
