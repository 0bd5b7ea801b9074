"""Costs of pairs on five lenses drawn by hand, and their definition."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.depth.matching.cost_volume import (
    compute_pair_costs,
    half_weight_area,
    match_cost,
    overlap_area,
    overlap_masks,
    pair_terms,
    pairs_of,
    shifts_from_zero,
)
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.microimages import allocate_strips, extract_strips
from lfrender.flat.texture import measure_statistics

# Five lenses in a cross: the middle one, and those right, below, left and above of it.
CENTRES = np.array([[60.3, 59.8], [84.1, 60.4], [59.7, 83.6], [36.5, 59.2], [60.9, 36.0]])
PITCH = 23.81
SHIFTS = np.arange(-16, 17, dtype=np.float32)
FROM_MIDDLE = np.full((5, 4), -1, np.int32)
FROM_MIDDLE[0] = 1, 2, 3, 4
FROM_OTHERS = np.full((5, 4), -1, np.int32)
FROM_OTHERS[[1, 2, 3, 4], [0, 1, 2, 3]] = 0


def cross(s):
    """A grey flat of the five lenses before waves on a plane."""
    y, x = np.mgrid[:121, :121].astype(float)
    points = np.stack([x, y], -1)
    lens = np.square(points[:, :, None] - CENTRES).sum(-1).argmin(-1)
    scene = CENTRES[lens] - (points - CENTRES[lens]) * PITCH / s
    image = np.full(x.shape, 0.5)
    rng = np.random.default_rng(3)
    for _ in range(40):
        wave = rng.uniform(-0.7, 0.7, 2) * abs(s) / PITCH
        image += 0.02 * np.cos(scene @ wave + rng.uniform(0, 2 * np.pi))
    return GrayFlat(image.astype(np.float32), CENTRES.astype(np.float32), 10.5, PITCH)


def turned(gray, across, down):
    """The same flat mirrored in `x` if `across`, and in `y` if `down`."""
    image = gray.image[:: -1 if down else 1, :: -1 if across else 1]
    last = np.array(gray.image.shape[::-1], np.float32) - 1
    centres = np.where([across, down], last - gray.centres, gray.centres).astype(np.float32)
    return GrayFlat(np.ascontiguousarray(image), centres, gray.radius, gray.pitch)


def costs(gray, rows, step=1, which=None, done=None, expected=None, out=None):
    """(4, k) costs of the pairs of the middle lens with the others."""
    statistics = measure_statistics(gray)
    strips = allocate_strips(gray, statistics.mean, step)
    extract_strips(strips, gray, np.ones(5, bool))
    lens, direction = np.nonzero(rows >= 0)
    away = gray.centres[rows[lens, direction]] - gray.centres[lens]
    masks = overlap_masks(strips, gray, away / np.float32(gray.pitch), SHIFTS)
    rows = pairs_of(rows, np.ones(5, bool), done)
    shifts = shifts_from_zero(SHIFTS, gray.pitch)
    if which is not None:
        shifts = shifts._replace(which=which)
    terms = pair_terms(gray, statistics, 0.005, expected)
    return compute_pair_costs(terms, strips, masks, rows, shifts, out)[lens, direction]


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("s", [-7, -4, 5, 8])
def test_each_pair_costs_least_at_the_shift_it_was_drawn_with(s, step):
    found = costs(cross(s), FROM_MIDDLE, step)
    np.testing.assert_array_equal(SHIFTS[found.argmin(1)], s)
    # A perfect match costs only what the small overlap takes from its weight, and noise.
    gray = cross(s)
    area = float(overlap_area(gray, np.array([[1, 0]], np.float32), SHIFTS[s == SHIFTS])[0, 0])
    weight = area / (area + half_weight_area(gray))
    assert (found.min(1) < 1 - 0.9 * weight).all()
    assert (found.min(1) > 1 - weight - 0.05).all()


def test_exchanged_lenses_cost_the_same():
    gray = cross(-6)
    there = costs(gray, FROM_MIDDLE)
    back = costs(gray, FROM_OTHERS)
    np.testing.assert_allclose(back, there, atol=0.12)
    np.testing.assert_array_equal(back.argmin(1), there.argmin(1))


@pytest.mark.parametrize(
    ("across", "down"), [(True, False), (False, True), (True, True)], ids=["x", "y", "half a turn"]
)
def test_a_mirrored_or_turned_flat_costs_the_same(across, down):
    gray = cross(6)
    first = costs(gray, FROM_MIDDLE)
    second = costs(turned(gray, across, down), FROM_MIDDLE)
    # Overlaps are rounded to whole pixels, the same way in all flats.
    np.testing.assert_allclose(second, first, atol=0.12)
    np.testing.assert_array_equal(second.argmin(1), first.argmin(1))


def test_shifts_from_expected_ones_are_those_of_their_sum():
    gray = cross(-6)
    all_shifts = costs(gray, FROM_MIDDLE)
    about = costs(gray, FROM_MIDDLE, expected=np.full(5, -6, np.float32))
    # Near zero a match may be one of shading: the doubt is that at the expected shift.
    far = np.abs(SHIFTS[:-6]) >= 5
    np.testing.assert_allclose(about[:, 6:][:, far], all_shifts[:, :-6][:, far], atol=0.01)


def test_lenses_that_are_done_and_shifts_that_are_not_asked_for_keep_their_costs():
    gray = cross(-6)
    full = costs(gray, FROM_MIDDLE)
    out = np.full((5, 4, len(SHIFTS)), 0.5, np.float32)
    some = costs(gray, FROM_MIDDLE, which=np.array([3, 4]), out=out)
    np.testing.assert_array_equal(some[:, 3:5], full[:, 3:5])
    np.testing.assert_array_equal(np.delete(some, [3, 4], 1), 0.5)
    done = costs(gray, FROM_MIDDLE, done=np.arange(5) == 0, out=out.copy())
    np.testing.assert_array_equal(done[:, :3], 0.5)


def _cost(a, b, floor=0.0, half_weight=0.0, doubt=0.0, difference=0.0):
    a = np.asarray(a, np.float32)
    b = np.asarray(b, np.float32)
    count = np.float32(len(a))
    moments = (a.sum(), b.sum(), (a * a + b * b).sum(), ((a - b) ** 2).sum())
    numbers = map(np.float32, (difference, count, floor, half_weight, doubt))
    return float(match_cost(count, *moments, *numbers))


def test_the_cost_is_one_less_the_correlation_of_two_views():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 500))
    a -= a.mean()
    b -= b.mean()
    assert _cost(a, a) == pytest.approx(0, abs=1e-5)
    # With equal means, the squared difference over the sum of both variances.
    assert _cost(a, b) == pytest.approx(1 - 2 * (a @ b) / (a @ a + b @ b), abs=1e-4)
    assert _cost(a, -a) == pytest.approx(2, abs=1e-4)


def test_noise_small_overlaps_and_doubt_pull_the_cost_toward_one():
    a = np.sin(np.arange(100.0))
    assert _cost(a, a, half_weight=100) == pytest.approx(0.5, abs=1e-4)
    assert _cost(a, a, doubt=0.25) == pytest.approx(0.25, abs=1e-4)
    noisy = _cost(a, a, floor=0.5 * float(np.var(a)))
    assert noisy == pytest.approx(0.2, abs=0.01)


def test_a_difference_of_means_counts_by_half():
    a = np.sin(np.arange(200.0))
    variance = float(np.var(a))
    apart = 0.5 * 0.3**2
    assert _cost(a, a + 0.3) == pytest.approx(apart / (2 * variance + apart), abs=1e-3)
    assert _cost(a, a + 0.3, difference=0.3) == pytest.approx(0, abs=1e-4)
