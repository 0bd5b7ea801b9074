"""Which depths of lenses are believed: limits on few numbers by hand."""

from __future__ import annotations

import numpy as np

from lfrender.depth.validity.classify import correlates_poorly, inflate_errors, occurs_among


def test_a_depth_occurs_where_a_two_hundredth_of_the_lenses_has_it():
    known = np.repeat([3.0, 8.0], [999, 1]).astype(np.float32)
    values = np.array([3.05, 8.0, 5.0], np.float32)
    # Five of a thousand are needed; one lens has 8 px.
    np.testing.assert_array_equal(occurs_among(values, known, 0.1), [True, False, False])
    few = known[-100:]
    np.testing.assert_array_equal(occurs_among(values, few, 0.1), [True, True, False])


def test_a_depth_occurs_within_the_gap_on_both_sides_alike():
    known = np.full(10, 3.0, np.float32)
    for away in (-0.09, 0.09):
        assert occurs_among(np.array([3 + away], np.float32), known, 0.1)[0]
    for away in (-0.11, 0.11):
        assert not occurs_among(np.array([3 + away], np.float32), known, 0.1)[0]


def test_nothing_occurs_where_no_depth_is_known():
    assert not occurs_among(np.array([1.0], np.float32), np.empty(0, np.float32), 0.5).any()


def test_errors_grow_where_lenses_match_poorly():
    errors = inflate_errors(np.full(3, 0.01), np.array([1.0, 0.8, 0.2]))
    assert 0.009 < errors[0] < 0.0100
    assert (np.diff(errors) > 0).all()


def test_noisy_lenses_tell_nothing_about_a_wrong_map():
    resolved = np.ones(10, bool)
    poor = np.full(10, 0.3)
    assert correlates_poorly(poor, np.full(10, 0.9), resolved)
    assert not correlates_poorly(poor, np.full(10, 0.5), resolved)
    assert not correlates_poorly(np.full(10, 0.6), np.full(10, 0.9), resolved)
    assert not correlates_poorly(poor, np.full(10, 0.9), ~resolved)
