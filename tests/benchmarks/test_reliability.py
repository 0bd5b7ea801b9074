"""Confidence beside the share of lenses that are right."""

from __future__ import annotations

import numpy as np

from benchmarks.reliability import diagram


def test_a_confidence_that_is_the_share_of_right_lenses_has_no_difference():
    confidence = np.repeat(np.float32([0.25, 0.75]), 4)
    right = np.array([1, 0, 0, 0, 1, 1, 1, 0], bool)
    assert diagram(confidence, right).endswith("mean difference 0.0000")


def test_confident_lenses_that_are_wrong_are_counted():
    rows = diagram(np.full(10, 0.97, np.float32), np.arange(10) < 6).splitlines()
    assert rows == ["0.95 to 0.98      10  0.970 0.600", "mean difference 0.3700"]
