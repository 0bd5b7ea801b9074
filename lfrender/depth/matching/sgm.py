"""Semi-global matching on the lattice of lenses (Hirschmueller 2008, section 2.2)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ...runtime.cache import cached

__all__ = ["aggregate_costs", "average_pair_costs"]

# Labels that a vector loop takes at a time.
_LANES = 16


@kernel(error_model="numpy", fastmath=FAST, share=lambda *given: len(given[4]))
def _lens_costs(begin, end, pair, forward, backward, lenses, out):
    """Mean pair cost of each of the `lenses` over all neighbours that it has."""
    half = forward.shape[1]
    for n in range(begin, end):
        lens, count = lenses[n], 0
        for k in range(out.shape[1]):
            out[n, k] = 0.0
        for d in range(half):
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
    pair: NDArray[np.float32],
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """(m, k) float32 mean cost with all neighbours, of each of the `wanted` (n,) lenses, all by default."""
    lenses = np.arange(len(pair)) if wanted is None else np.flatnonzero(wanted)
    out = np.empty((len(lenses), pair.shape[2]), np.float32)
    _lens_costs(pair, forward, backward, lenses, out)
    return out


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _relax(message, other, places, shift, price):
    """The least of each message and those `shift` labels beside it plus the `price`, in `other`."""
    here, left, right = np.uint64(_LANES), np.uint64(_LANES - shift), np.uint64(_LANES + shift)
    for k in range(np.uint64(places)):
        other[here + k] = min(message[here + k], min(message[left + k], message[right + k]) + price)


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _walk(cost, chain, slope, jump, total):
    """One path along the lenses of `chain`, added to `total`.

    The lower envelope of all messages is found in steps of 1, 2, 4, ... labels, for all labels at once: a scan along
    the labels could not be vectorised.
    """
    labels, first = cost.shape[1], np.uint64(_LANES)
    places = (labels + _LANES - 1) // _LANES * _LANES
    message, other = np.full(places + 2 * _LANES, np.inf, np.float32), np.full(places + 2 * _LANES, np.inf, np.float32)
    lows = np.empty(_LANES, np.float32)
    for k in range(np.uint64(labels)):
        message[first + k] = 0.0
    reach = min(labels - 1, int(jump / slope) + 1)
    for step in range(len(chain)):
        own, summed = cost[chain[step]], total[chain[step]]
        for k in range(np.uint64(labels)):
            message[first + k] += own[k]
            summed[k] += message[first + k]
        lows[:] = np.inf
        for k in range(labels, places):
            message[_LANES + k] = np.inf
        for bunch in range(_LANES, _LANES + places, _LANES):
            for k in range(first):
                lows[k] = min(lows[k], message[np.uint64(bunch) + k])
        low = lows[0]
        for k in range(1, _LANES):
            low = min(low, lows[k])
        for k in range(np.uint64(places)):
            message[first + k] = min(message[first + k] - low, jump)
        covered, shift = 0, 1
        while covered < reach:
            _relax(message, other, places, shift, np.float32(shift) * slope)
            message, other = other, message
            covered, shift = covered + shift, min(2 * shift, _LANES)


@kernel(error_model="numpy", share=lambda cost, chains, starts, *_: len(starts) - 1)
def _walk_all(begin, end, cost, chains, starts, slope, jump, wanted, total):
    for c in range(begin, end):
        some = False
        for k in range(starts[c], starts[c + 1]):
            some = some or wanted[chains[k]]
        if not some:
            continue
        _walk(cost, chains[starts[c] : starts[c + 1]], slope, jump, total)


@kernel
def _follow(following, before, order, starts):
    """Fill `order` with all straight rows of lenses in turn, `starts` with the start of each; return their number."""
    count = chains = 0
    for first in range(len(following)):
        if before[first] >= 0:
            continue
        starts[chains] = count
        chains += 1
        lens = first
        while lens >= 0:
            order[count] = lens
            count += 1
            lens = following[lens]
    starts[chains] = count
    return chains


def _paths(forward: NDArray[np.int32], backward: NDArray[np.int32]) -> list[tuple[NDArray, NDArray]]:
    """Straight rows of lenses, one after the other, and where each starts, in all lattice directions and opposites."""
    found = []
    for d in range(forward.shape[1]):
        ahead, behind = (np.ascontiguousarray(rows[:, d]) for rows in (forward, backward))
        for following, before in ((ahead, behind), (behind, ahead)):
            order, starts = np.empty(len(forward), np.int32), np.empty(len(forward) + 1, np.int64)
            count = _follow(following, before, order, starts)
            found.append((order, starts[: count + 1].copy()))
    return found


def aggregate_costs(
    cost: NDArray[np.float32],
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    slope: float,
    jump: float,
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """(n, k) sum of the path costs from all lattice directions, for a `cost` (n, k) at evenly spaced shifts.

    A step of one shift between neighbours costs `slope`, a depth edge at most `jump`. Sums of lenses that are not
    `wanted` (n,) may lack paths.
    """
    wanted = np.ones(len(cost), bool) if wanted is None else wanted
    total = np.zeros_like(cost)
    # Cached with the neighbour rows, which live as long as the lattice.
    found, other = cached(forward, "chains", lambda: (_paths(forward, backward), backward))
    for chains, starts in found if other is backward else _paths(forward, backward):
        _walk_all(cost, chains, starts, np.float32(slope), np.float32(jump), wanted, total)
    return total
