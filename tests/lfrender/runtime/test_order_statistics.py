"""Places in ordered values are those of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.runtime.order_statistics import count_below, median_of, select


@pytest.mark.parametrize("count", [1, 2, 3, 10, 101])
@pytest.mark.parametrize("distinct", [3, 1000])
def test_selection_and_median_are_those_of_sorted_values(count, distinct):
    values = np.random.default_rng(count).integers(0, distinct, count).astype(np.float32)
    assert [select(values.copy(), place) for place in range(count)] == sorted(values)
    assert median_of(values.copy()) == np.median(values)


def test_places_among_ordered_values_are_those_of_a_search():
    ordered = np.array([-1, 0, 0, 2.5, np.nan])
    assert [count_below(ordered, value) for value in (-2, 0, 0.1, 9)] == np.searchsorted(
        ordered, (-2, 0, 0.1, 9)
    ).tolist()


def test_no_value_is_below_nan():
    assert count_below(np.array([1.0, 2.0]), np.nan) == 0
