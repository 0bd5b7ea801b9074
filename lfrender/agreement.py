"""Agreement between neighbouring lenses: semi-global matching on the lattice."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .fastmath import FAST
from .remembered import remembered

__all__ = ["aggregate", "lens_costs"]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _lens_costs(pair, forward, backward, out):
    """Mean pair cost of each lens over all neighbours that it has."""
    half = forward.shape[1]
    for lens in prange(len(out)):
        count = 0
        for k in range(out.shape[1]):
            out[lens, k] = 0.0
        for d in range(half):
            if forward[lens, d] >= 0:
                count += 1
                for k in range(out.shape[1]):
                    out[lens, k] += pair[lens, d, k]
            other = backward[lens, d]
            if other >= 0:
                count += 1
                for k in range(out.shape[1]):
                    out[lens, k] += pair[other, d, k]
        for k in range(out.shape[1]):
            out[lens, k] = out[lens, k] / count if count else 1.0


def lens_costs(
    pair: NDArray[np.float32], forward: NDArray[np.int32], backward: NDArray[np.int32]
) -> NDArray[np.float32]:
    """(n, k) float32 cost of each lens and shift: the mean over its pairs with all neighbours."""
    out = np.empty((len(pair), pair.shape[2]), np.float32)
    _lens_costs(pair, forward, backward, out)
    return out


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _walk(cost, chain, slope, jump, total):
    """One path of semi-global matching along the lenses of `chain`, added to `total`."""
    labels = cost.shape[1]
    message = np.zeros(labels, np.float32)
    for step in range(len(chain)):
        lens = chain[step]
        low = np.float32(np.inf)
        for k in range(labels):
            message[k] += cost[lens, k]
            total[lens, k] += message[k]
            low = min(low, message[k])
        for k in range(labels):
            message[k] = min(message[k] - low, jump)
        for k in range(1, labels):
            message[k] = min(message[k], message[k - 1] + slope)
        for k in range(labels - 2, -1, -1):
            message[k] = min(message[k], message[k + 1] + slope)


@njit(cache=True, nogil=True, parallel=True)
def _walk_all(cost, chains, starts, slope, jump, wanted, total):
    for c in prange(len(starts) - 1):
        some = False
        for k in range(starts[c], starts[c + 1]):
            some = some or wanted[chains[k]]
        if not some:
            continue
        _walk(cost, chains[starts[c] : starts[c + 1]], slope, jump, total)


_Chains = tuple[NDArray[np.int32], NDArray[np.int64]]


def _all_chains(forward: NDArray[np.int32], backward: NDArray[np.int32]) -> list[_Chains]:
    """`_chains` in all directions and their opposites."""
    pairs = [(forward[:, d], backward[:, d]) for d in range(forward.shape[1])]
    return [_chains(*turned) for pair in pairs for turned in (pair, pair[::-1])]


@njit(cache=True, nogil=True)
def _follow(following, before, order, starts):
    """Fill `order` with all straight rows of lenses, one after the other, `starts` with where each begins."""
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


def _chains(forward: NDArray[np.int32], backward: NDArray[np.int32]) -> _Chains:
    """All straight rows of lenses in one lattice direction, one after the other, and where each starts."""
    order, starts = np.empty(len(forward), np.int32), np.empty(len(forward) + 1, np.int64)
    chains = _follow(np.ascontiguousarray(forward), np.ascontiguousarray(backward), order, starts)
    return order, starts[: chains + 1].copy()


def aggregate(
    cost: NDArray[np.float32],
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    slope: float,
    jump: float,
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Sum of path costs from all lattice directions (Hirschmueller, Semi-Global Matching, 2008, section 2.2).

    Parameters
    ----------
    cost : (n, k) float32
        Cost of each lens at each of k evenly spaced shifts.
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    slope : float
        Price of a step of one shift between neighbours.
    jump : float
        Largest price between neighbours: a depth edge.
    wanted : (n,) bool, optional
        Lenses whose sums are asked for; those of others may lack paths.
    """
    wanted = np.ones(len(cost), bool) if wanted is None else wanted
    total = np.zeros_like(cost)
    # Rows of lenses belong to the lattice, and neighbour rows live as long as that.
    found, other = remembered(forward, "chains", lambda: (_all_chains(forward, backward), backward))
    for chains, starts in found if other is backward else _all_chains(forward, backward):
        _walk_all(cost, chains, starts, np.float32(slope), np.float32(jump), wanted, total)
    return total
