"""Semi-global matching on the lattice of lenses (Hirschmueller 2008, section 2.2)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ...flat.neighbours import Neighbours

__all__ = ["aggregate_costs", "average_pair_costs"]

# Labels that a vector loop takes at a time.
_LANES = 16


@kernel(error_model="numpy", fastmath=FAST, share=lambda *given: len(given[3]))
def _lens_costs(begin, end, pair, forward, backward, lenses, out):
    """Mean pair cost of each of the `lenses` over all neighbours that it has, in the directions of
    `pair`.
    """
    for n in range(begin, end):
        lens = lenses[n]
        count = 0
        for k in range(out.shape[1]):
            out[n, k] = 0.0
        for d in range(pair.shape[1]):
            if forward[lens, d] >= 0:
                count += 1
                for k in range(out.shape[1]):
                    out[n, k] += pair[lens, d, k]
            other = backward[lens, d]
            if other >= 0:
                count += 1
                for k in range(out.shape[1]):
                    out[n, k] += pair[other, d, k]
        for k in range(out.shape[1]):
            out[n, k] = out[n, k] / count if count else 1.0


def average_pair_costs(
    pair: NDArray[np.float32], neighbours: Neighbours, wanted: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """(m, k) float32 mean cost with all neighbours, of each of the `wanted` (n,) lenses, all by
    default, from the costs `pair` (n, d, k) with the neighbours forward, in all directions or the
    first ones.
    """
    lenses = np.arange(len(pair)) if wanted is None else np.flatnonzero(wanted)
    out = np.empty((len(lenses), pair.shape[2]), np.float32)
    _lens_costs(pair, neighbours.forward, neighbours.backward, lenses, out)
    return out


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _walk(cost, chain, slope, jump, total):
    """One path along the lenses of `chain`, added to `total`; the lower envelope of all messages by
    steps of 1, 2, 4
    ..."""
    labels = cost.shape[1]
    first = np.uint64(_LANES)
    message = np.full(labels + 2 * _LANES, np.inf, np.float32)
    other = message.copy()
    for k in range(np.uint64(labels)):
        message[first + k] = 0.0
    reach = min(labels - 1, int(jump / slope) + 1)
    for step in range(len(chain)):
        own = cost[chain[step]]
        summed = total[chain[step]]
        low = np.float32(np.inf)
        for k in range(np.uint64(labels)):
            message[first + k] += own[k]
            summed[k] += message[first + k]
        for k in range(np.uint64(labels)):
            low = min(low, message[first + k])
        for k in range(np.uint64(labels)):
            message[first + k] = min(message[first + k] - low, jump)
        covered = 0
        shift = 1
        while covered < reach:
            left = np.uint64(_LANES - shift)
            right = np.uint64(_LANES + shift)
            price = np.float32(shift) * slope
            for k in range(np.uint64(labels)):
                other[first + k] = min(
                    message[first + k], min(message[left + k], message[right + k]) + price
                )
            message, other = other, message
            covered = covered + shift
            shift = min(2 * shift, _LANES)


@kernel(error_model="numpy", share=lambda cost, chains, starts, *_: len(starts) - 1)
def _walk_all(begin, end, cost, chains, starts, slope, jump, wanted, total):
    for c in range(begin, end):
        some = False
        for k in range(starts[c], starts[c + 1]):
            some = some or wanted[chains[k]]
        if some:
            _walk(cost, chains[starts[c] : starts[c + 1]], slope, jump, total)


def aggregate_costs(
    cost: NDArray[np.float32],
    neighbours: Neighbours,
    slope: float,
    jump: float,
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """(n, k) sum of the path costs from all lattice directions, for a `cost` (n, k) at evenly
    spaced shifts.

    A step of one shift costs `slope`, a depth edge at most `jump`; lenses that are not `wanted`
    (n,) may lack paths.
    """
    wanted = np.ones(len(cost), bool) if wanted is None else wanted
    total = np.zeros_like(cost)
    for chains, starts in neighbours.chains:
        _walk_all(cost, chains, starts, np.float32(slope), np.float32(jump), wanted, total)
    return total
