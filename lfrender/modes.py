"""From match costs to answers: which lenses are resolved, how sure, and what fills the others."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["confidence", "fill", "parabola_peak", "second_best"]

# Cost difference that makes one shift e times as likely as another (measured on simulated scenes).
_TEMPERATURE = 0.05
_FILL_ROUNDS = 24


def confidence(total: NDArray[np.float32], best: NDArray[np.int64], paths: int, tolerance: int) -> NDArray[np.float32]:
    """Posterior probability that the true shift lies within `tolerance` steps of the chosen one.

    Parameters
    ----------
    total : (n, k) float32
        Aggregated cost, the sum over `paths` paths.
    best : (n,) int
        Chosen shift of each lens, that of the least cost.
    """
    lens = np.arange(len(total))
    energy = (total - total[lens, best][:, None]) / np.float32(paths * _TEMPERATURE)
    mass = np.exp(-energy)
    sums = np.concatenate([np.zeros((len(mass), 1), np.float32), np.cumsum(mass, 1)], 1)
    low = np.maximum(best - tolerance, 0)
    high = np.minimum(best + tolerance + 1, total.shape[1])
    return ((sums[lens, high] - sums[lens, low]) / sums[:, -1]).astype(np.float32)


def parabola_peak(total: NDArray[np.float32], best: NDArray[np.int64]) -> NDArray[np.float32]:
    """(n,) float32: offset of the minimum from `best`, in steps, of the parabola through three costs."""
    inner = np.clip(best, 1, total.shape[1] - 2)
    lens = np.arange(len(total))
    left, middle, right = (total[lens, inner + d] for d in (-1, 0, 1))
    bend = left - 2 * middle + right
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.where(bend > 1e-9, 0.5 * (left - right) / bend, 0.0)
    return np.where(inner == best, np.clip(offset, -0.5, 0.5), 0.0).astype(np.float32)


@njit(cache=True, nogil=True, parallel=True)
def _smooth(values, unknown, neighbours, gap, out):
    """Mean of the neighbours of each unknown lens that differ from it by `gap` at most."""
    for u in prange(len(unknown)):
        lens = unknown[u]
        total = np.float32(0.0)
        count = 0
        for k in range(neighbours.shape[1]):
            other = neighbours[lens, k]
            if other >= 0 and abs(values[other] - values[lens]) <= gap:
                total += values[other]
                count += 1
        if count:
            out[lens] = total / count


def fill(
    values: NDArray[np.float32], known: NDArray[np.bool_], neighbours: NDArray[np.int32], gap: float
) -> NDArray[np.float32]:
    """Smooth the values of unknown lenses toward their neighbours on the same side of depth edges.

    Parameters
    ----------
    values : (n,) float32 [px]
        Patch sizes; those of unknown lenses are first guesses.
    known : (n,) bool
        Lenses to leave alone.
    neighbours : (n, k) int32
        Neighbour rows, -1 where there is none.
    gap : float [px]
        Values further apart belong to different surfaces.
    """
    result = values.copy()
    unknown = np.flatnonzero(~known)
    if unknown.size == 0:
        return result
    for _ in range(_FILL_ROUNDS):
        before = result.copy()
        _smooth(before, unknown, neighbours, np.float32(gap), result)
    return result


@njit(cache=True, nogil=True, parallel=True)
def _second_best(cost, best, apart, index, value):
    for lens in prange(len(cost)):
        at, least = 0, np.float32(np.inf)
        own = cost[lens]
        for k in range(1, len(own) - 1):
            lowest = own[k] <= own[k - 1] and own[k] < own[k + 1]
            if lowest and own[k] < least and abs(k - best[lens]) >= apart:
                at, least = k, own[k]
        index[lens], value[lens] = at, least


def second_best(
    cost: NDArray[np.float32], best: NDArray[np.int64], apart: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The lowest local minimum of each lens's own cost at least `apart` steps from its best shift.

    A lens across a depth edge matches at both depths; the second is in its own cost, not in the
    aggregated one.

    Parameters
    ----------
    cost : (n, k) float32
        Cost of each lens before aggregation.
    best : (n,) int
        Chosen shift of each lens.

    Returns
    -------
    index : (n,) int
    value : (n,) float32
        Cost there, inf where there is no other minimum.
    """
    index, value = np.empty(len(cost), np.int64), np.empty(len(cost), np.float32)
    _second_best(cost, best, apart, index, value)
    return index, value
