"""Differences between recorded and new results are found and told."""

import numpy as np

from benchmarks.same_results import differences


def test_results_that_are_the_same_bit_for_bit_give_no_line():
    before = {"a": np.array([1.0, np.nan]), "b": np.arange(3)}
    assert differences(before, {key: value.copy() for key, value in before.items()}) == []


def test_each_array_that_differs_is_one_line_with_its_largest_difference():
    before = {
        "same": np.arange(3),
        "moved": np.array([0.0, 1.0]),
        "gone": np.zeros(1),
        "grown": np.zeros(2),
    }
    after = {
        "same": np.arange(3),
        "moved": np.array([0.0, 1.25]),
        "new": np.zeros(1),
        "grown": np.zeros(3),
    }
    assert differences(before, after) == [
        "gone: only before",
        "grown: float64 (2,) before, float64 (3,) after",
        "moved: 50.00% of the values differ, by 0.25 at most",
        "new: only after",
    ]
