from dataclasses import replace

import numpy as np
import pytest

from lfrender.depth.matching.cost_volume import compute_pair_costs
from lfrender.depth.matching.local_match import match_locally
from lfrender.depth.matching.settings import COST
from lfrender.depth.matching.sgm import average_pair_costs
from lfrender.flat.lens_graph import opposite_neighbours
from lfrender.flat.microimages import extract_strips
from lfrender.flat.texture import FIXED_PATTERN, measure_statistics

NOISE = 0.004


def probed(drawn_flat, patch_size, expected, row_step):
    gray, lattice, _, inner = drawn_flat(patch_size, noise=NOISE, detail=0.8)
    statistics, active = measure_statistics(gray), np.ones(len(lattice), bool)
    halves = opposite_neighbours(lattice)
    about = np.full(len(lattice), expected, np.float32)
    strips = extract_strips(gray, statistics.mean, row_step)
    return gray, lattice, inner, match_locally(gray, *halves, statistics, active, about, NOISE, strips)


# At -14 px of a pitch of 23 px only the rims of neighbours overlap.
@pytest.mark.parametrize("row_step", [1, 2])
@pytest.mark.parametrize("patch_size", [7.0, 1.5, -6.0, -14.0])
@pytest.mark.parametrize("off", [-0.4, 0.0, 0.3])
def test_one_step_finds_the_offset_of_the_best_shift(drawn_flat, patch_size, off, row_step):
    _, _, inner, (_, offset, _) = probed(drawn_flat, patch_size, patch_size + off, row_step)
    # Because of interpolation a single step may fall short.
    assert np.median(offset[inner]) == pytest.approx(-off, abs=max(0.1, 0.65 * abs(off)))


def test_the_standard_error_of_the_offset_is_that_of_noise(drawn_flat):
    gray, lattice, _, inner = drawn_flat(7.0, noise=0.0, detail=0.8)
    active, halves = np.ones(len(lattice), bool), opposite_neighbours(lattice)
    # Each lens has two pairs per direction.
    one = [np.ascontiguousarray(rows[:, :1]) for rows in halves]
    about, rng, offsets = np.full(len(lattice), 7.0, np.float32), np.random.default_rng(3), []
    for _ in range(24):
        noisy = replace(gray, image=gray.image + rng.normal(0, NOISE, gray.image.shape).astype(np.float32))
        statistics = measure_statistics(noisy)
        strips = extract_strips(noisy, statistics.mean, 1)
        _, offset, error = match_locally(noisy, *one, statistics, active, about, NOISE, strips)
        offsets.append(offset)
    measured = np.std(offsets, axis=0)[inner]
    assert np.median(measured / error[inner]) == pytest.approx(np.sqrt(0.5), rel=0.25)


def test_far_from_the_best_shift_the_sign_of_the_offset_is_right(drawn_flat):
    _, _, inner, (cost, offset, _) = probed(drawn_flat, 7.0, 8.2, 1)
    assert np.median(offset[inner]) == -COST.max_offset
    assert (offset[inner] < 0).mean() > 0.95
    assert np.median(cost[inner]) > 0.1


@pytest.mark.parametrize("patch_size", [7.0, -14.0])
def test_the_cost_equals_that_of_the_search(drawn_flat, patch_size):
    gray, lattice, _, (cost, _, _) = probed(drawn_flat, patch_size, patch_size, 2)
    statistics, halves = measure_statistics(gray), opposite_neighbours(lattice)
    pairs = compute_pair_costs(
        gray, halves[0], statistics.mean, statistics.contrast, np.ones(len(lattice), bool),
        np.array([patch_size], np.float32), NOISE, FIXED_PATTERN, 2,
    )  # fmt: skip
    np.testing.assert_allclose(cost, average_pair_costs(pairs, *halves)[:, 0], atol=2e-4)
