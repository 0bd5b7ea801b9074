"""Semi-global matching on the lattice, against its definition in plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.matching.sgm import aggregate_costs, average_pair_costs
from lfrender.flat.neighbours import Neighbours

SLOPE = 0.1
JUMP = 0.25


def _neighbours(basis):
    return Neighbours(Lattice([12.0, 12.0], basis, (100, 80), 9.0))


SQUARE = _neighbours([[20.0, 0.0], [0.0, 20.0]])
HEXAGONAL = _neighbours([[20.0, 0.0], [10.0, 17.3]])


def _plain_paths(cost, neighbours):
    """Sum of the path costs, by the recursion of the paper (section 2.3, equation 12)."""
    labels = np.arange(cost.shape[1])
    price = np.minimum(SLOPE * np.abs(labels[:, None] - labels), JUMP)
    total = np.zeros_like(cost)
    for behind in neighbours.all.T:
        known = {}

        def path(lens, behind=behind, known=known):
            if lens not in known:
                known[lens] = cost[lens]
                if behind[lens] >= 0:
                    before = path(behind[lens])
                    known[lens] = cost[lens] + (before - before.min() + price).min(1)
            return known[lens]

        total += [path(lens) for lens in range(len(cost))]
    return total


@pytest.mark.parametrize("neighbours", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
def test_sums_of_paths_are_those_of_the_recursion(neighbours):
    cost = np.random.default_rng(0).random((len(neighbours.all), 11), np.float32)
    found = aggregate_costs(cost, neighbours, SLOPE, JUMP)
    np.testing.assert_allclose(found, _plain_paths(cost, neighbours), atol=1e-5)


def test_shifts_with_the_other_sign_give_the_same_sums():
    cost = np.random.default_rng(1).random((len(HEXAGONAL.all), 11), np.float32)
    mirrored = aggregate_costs(np.ascontiguousarray(cost[:, ::-1]), HEXAGONAL, SLOPE, JUMP)
    np.testing.assert_allclose(
        mirrored[:, ::-1], aggregate_costs(cost, HEXAGONAL, SLOPE, JUMP), atol=1e-5
    )


def test_a_lens_without_a_match_takes_the_depth_of_its_neighbours():
    cost = np.ones((len(SQUARE.all), 11), np.float32)
    cost[:, 7] = 0
    cost[5] = 1
    assert aggregate_costs(cost, SQUARE, SLOPE, JUMP)[5].argmin() == 7


def test_pair_costs_are_averaged_over_the_neighbours_that_exist():
    directions = SQUARE.forward.shape[1]
    pair = np.random.default_rng(2).random((len(SQUARE.all), directions, 4), np.float32)
    found = average_pair_costs(pair, SQUARE)
    for lens in range(len(pair)):
        costs = [pair[lens, d] for d in range(directions) if SQUARE.forward[lens, d] >= 0]
        for d, other in enumerate(SQUARE.backward[lens]):
            if other >= 0:
                costs.append(pair[other, d])
        np.testing.assert_allclose(found[lens], np.mean(costs, axis=0), atol=1e-6)
    wanted = np.arange(len(pair)) % 3 == 0
    np.testing.assert_array_equal(average_pair_costs(pair, SQUARE, wanted), found[wanted])
