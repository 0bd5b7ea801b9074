"""Which lenses are resolved, and the reason why others are not."""

from __future__ import annotations

import numpy as np

from lfrender.depth.matching.matcher import MatchResult
from lfrender.depth.validity.classify import classify_lenses, initial_reasons


def test_unresolved_lenses_have_the_right_reason():
    sizes = np.array([5, 5, 5, 5, 19], np.float32)
    confidence, evidence = np.array([1, 1, 0.3, 0.3, 1], np.float32), np.array([1, 1, 0.8, 0.1, 0.8], np.float32)
    found = MatchResult(
        sizes,
        confidence,
        evidence,
        evidence,
        np.ones(5),
        evidence,
        np.zeros(5),
        np.full(5, np.nan, np.float32),
        evidence,
        evidence,
        1.0,
        0.0,
    )
    textured = np.array([True, False, True, True, True])
    assert initial_reasons(textured, found, sizes, np.ones(5, bool), 23.0).tolist() == [0, 1, 2, 3, 3]


def test_low_contrast_without_a_match_counts_as_too_little_texture():
    sizes, faint = np.full(4, 5, np.float32), np.full(4, 0.1, np.float32)
    found = MatchResult(sizes, 3 * faint, faint, faint, np.ones(4), faint, np.zeros(4), sizes, faint, faint, 1.0, 0.0)
    # Contrast four and ten times the noise.
    signal = np.repeat(np.float32([1 - 1 / 16, 1 - 1 / 100]), 2)
    centres, alone = 23 * np.arange(8, dtype=np.float32).reshape(4, 2), np.full((4, 6), -1, np.int32)
    reason, _, sure = classify_lenses(np.ones(4, bool), found, sizes, np.full(4, 9.0), signal, centres, alone, 23.0)
    assert reason.tolist() == [1, 1, 3, 3]
    assert (sure[:2] == 0).all() and (sure[2:] > 0).all()


def test_weak_lens_alone_at_its_depth_has_too_little_texture_but_a_clear_one_is_kept():
    row = np.arange(-3, 4)
    centres = (20 * np.stack(np.meshgrid(row, row), -1).reshape(-1, 2)).astype(np.float32)
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    neighbours = np.full((49, 4), -1, np.int32)
    for lens, near in enumerate(apart):
        beside = np.flatnonzero((near > 0) & (near < 21))
        neighbours[lens, : len(beside)] = beside
    sizes, signal = np.full(49, 5, np.float32), np.full(49, 0.99, np.float32)
    weak, clear = 16, 32
    sizes[[weak, clear]] = 9
    match = np.full(49, 0.9, np.float32)
    match[weak] = 0.6
    # Contrast a third of that of the others.
    signal[weak] = 0.91
    none = np.zeros(49, np.float32)
    found = MatchResult(sizes, match, match, match, np.ones(49), match, none, sizes * np.nan, match, match, 1.0, 0.0)
    errors = np.full(49, 0.05)
    reason, _, sure = classify_lenses(np.ones(49, bool), found, sizes, errors, signal, centres, neighbours, 20.0)
    assert reason[weak] == 1 and reason[clear] == 0 and (reason == 0).sum() == 48
    # As all lenses without texture.
    assert sure[weak] == 0 and (np.delete(sure, weak) > 0).all()
