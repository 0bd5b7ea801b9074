"""How unique the best shift of a lens is, from costs drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.depth.matching.ambiguity import measure_ambiguity

SHIFTS = np.arange(-10, 11)
WEIGHT = np.ones(len(SHIFTS), np.float32)
NONE = np.empty((1, 0), np.int32)


def cost_of(*peaks):
    """(1, k) cost of a lens that correlates at some shifts, by pairs of shift and correlation."""
    correlation = np.zeros(len(SHIFTS))
    for shift, height in peaks:
        correlation = np.maximum(correlation, height * np.exp(-((SHIFTS - shift) ** 2) / 2))
    return (1 - correlation[None]).astype(np.float32)


def uniqueness(cost, shifts, rows=NONE, weight=WEIGHT, wanted=None):
    best = np.searchsorted(SHIFTS, shifts)
    wanted = np.ones(len(cost), bool) if wanted is None else wanted
    return measure_ambiguity(cost, weight, rows, best, wanted, 2)


def test_one_peak_is_unique():
    assert uniqueness(cost_of((3, 0.9)), [3])[0] == 1


def test_two_equal_peaks_are_equally_likely():
    assert uniqueness(cost_of((-4, 0.9), (5, 0.9)), [-4])[0] == pytest.approx(0.5, abs=0.01)
    assert uniqueness(cost_of((-7, 0.9), (0, 0.9), (7, 0.9)), [0])[0] == pytest.approx(
        1 / 3, abs=0.01
    )


def test_a_lower_peak_matters_less_the_better_the_match():
    clear = uniqueness(cost_of((-4, 0.95), (5, 0.8)), [-4])[0]
    poor = uniqueness(cost_of((-4, 0.55), (5, 0.4)), [-4])[0]
    assert 0.5 < poor < clear - 0.1 < 0.95


def test_mirrored_costs_are_as_unique():
    cost = cost_of((-4, 0.9), (5, 0.8))
    np.testing.assert_allclose(uniqueness(cost, [-4]), uniqueness(cost[:, ::-1].copy(), [4]))


def test_shifts_of_small_overlap_do_not_count():
    weight = np.where(SHIFTS > 3, 0.2, 1).astype(np.float32)
    found = uniqueness(cost_of((-4, 0.9), (5, 0.9)), [-4], weight=weight)[0]
    assert found == pytest.approx(1, abs=1e-5)


def test_neighbours_on_the_same_surface_tell_peaks_apart():
    cost = np.concatenate([cost_of((-4, 0.9), (5, 0.9)), cost_of((-4, 0.9)), cost_of((8, 0.9))])
    rows = np.array([[1, 2], [0, -1], [0, -1]], np.int32)
    alone = uniqueness(cost, [-4, -4, 8], np.empty((3, 0), np.int32))
    together = uniqueness(cost, [-4, -4, 8], rows)
    # The second lens is of that surface and has no other peak; the third one is of another.
    assert alone[0] == pytest.approx(0.5, abs=0.01) and together[0] > 0.9
    assert together[2] == 1
    unmatched = uniqueness(cost, [-4, -4, 8], rows, wanted=np.array([True, False, True]))
    assert unmatched[0] == pytest.approx(alone[0]) and unmatched[1] == 1
