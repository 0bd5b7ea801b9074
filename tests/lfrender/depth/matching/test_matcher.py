"""The minimum of costs between the shifts that were tried."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.depth.matching.matcher import fit_parabola

SHIFTS = np.arange(-5.0, 6.0)


@pytest.mark.parametrize("place", [-3.4, -0.5, 0.0, 0.2, 2.9])
def test_minimum_of_a_parabola_is_found_exactly(place):
    cost = (0.03 * (SHIFTS - place) ** 2)[None].astype(np.float32)
    best = cost.argmin(1)
    assert SHIFTS[best[0]] + fit_parabola(cost, best)[0] == pytest.approx(place, abs=1e-4)


def test_mirrored_costs_have_the_mirrored_minimum():
    cost = np.random.default_rng(0).random((50, len(SHIFTS)), np.float32)
    mirrored = np.ascontiguousarray(cost[:, ::-1])
    place = fit_parabola(cost, cost.argmin(1))
    np.testing.assert_allclose(fit_parabola(mirrored, mirrored.argmin(1)), -place, atol=1e-6)


def test_minimum_at_the_end_of_the_range_and_even_costs_stay_where_they_are():
    cost = np.vstack([SHIFTS, -SHIFTS, np.ones_like(SHIFTS)]).astype(np.float32)
    np.testing.assert_array_equal(fit_parabola(cost, cost.argmin(1)), 0)
