"""Minima of the matching cost: the best shift, its sub-step offset and probability, and the second best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from ...flat.lens_graph import count_similar
from ..same_surface import same_surface

__all__ = ["confidence", "fill_unresolved", "find_minimum", "find_second_minimum", "fit_parabola"]

# Cost difference, per path, that makes one shift e times as likely as another; measured on simulated scenes.
_TEMPERATURE = 0.05
# Rounds of smoothing that spread patch sizes over unresolved lenses.
_FILL_ROUNDS = 24
# Rounds in which guesses that stand alone are replaced before: pairs of them lose one at a time.
_OUTLIER_ROUNDS = 3
# exp of minus this does not show in single precision.
_NEGLIGIBLE = np.float32(24.0)


@njit(cache=True, nogil=True, error_model="numpy", share=lambda total, best, *_: len(best))
def _confidence(begin, end, total, best, scale, tolerance, out):
    for lens in range(begin, end):
        own = total[lens]
        least, at = own[best[lens]], best[lens]
        here = everywhere = np.float32(0.0)
        for k in range(len(own)):
            energy = (own[k] - least) / scale
            if energy > _NEGLIGIBLE:
                continue
            mass = np.exp(-energy)
            everywhere += mass
            if abs(k - at) <= tolerance:
                here += mass
        out[lens] = here / everywhere


@njit(cache=True, nogil=True, error_model="numpy", share=lambda cost, among, best, value: len(best))
def _find_minimum(begin, end, cost, among, best, value):
    for lens in range(begin, end):
        at, least = 0, np.float32(np.inf)
        own = cost[lens]
        for k in range(len(own)):
            if own[k] < least and (among.size == 0 or among[k]):
                at, least = k, own[k]
        best[lens], value[lens] = at, least


def find_minimum(
    cost: NDArray[np.float32], among: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Shift (n,) of the least cost (n, k) of each lens, the first of equals, and that cost; of those `among` (k,)."""
    best, value = np.empty(len(cost), np.int64), np.empty(len(cost), np.float32)
    _find_minimum(cost, np.empty(0, bool) if among is None else among, best, value)
    return best, value


def confidence(total: NDArray[np.float32], best: NDArray[np.int64], paths: int, tolerance: int) -> NDArray[np.float32]:
    """(n,) posterior probability that the true shift lies within `tolerance` steps of the `best` (n,).

    `total` (n, k) is the aggregated cost, a sum over so many `paths`, of which `best` is the minimum.
    """
    out = np.empty(len(total), np.float32)
    _confidence(total, best, np.float32(paths * _TEMPERATURE), tolerance, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy", share=lambda total, best, out: len(best))
def _fit_parabola(begin, end, total, best, out):
    half = np.float32(0.5)
    for lens in range(begin, end):
        at, own = best[lens], total[lens]
        out[lens] = 0.0
        if at < 1 or at > len(own) - 2:
            continue
        left, middle, right = own[at - 1], own[at], own[at + 1]
        bend = left - (middle + middle) + right
        if bend > 1e-9:
            out[lens] = min(max(half * (left - right) / bend, -half), half)


def fit_parabola(total: NDArray[np.float32], best: NDArray[np.int64]) -> NDArray[np.float32]:
    """(n,) float32: offset of the minimum from `best`, in steps, of the parabola through three costs."""
    out = np.empty(len(total), np.float32)
    _fit_parabola(total, best, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy", share=lambda values, unknown, *_: len(unknown))
def _smooth(begin, end, values, unknown, neighbours, gap, out):
    """Mean of the neighbours of each unknown lens that differ from it by `gap` at most, or its own value."""
    for u in range(begin, end):
        lens = unknown[u]
        total = np.float32(0.0)
        count = 0
        for k in range(neighbours.shape[1]):
            other = neighbours[lens, k]
            if other >= 0 and same_surface(values[other], values[lens], gap):
                total += values[other]
                count += 1
        out[lens] = total / count if count else values[lens]


def fill_unresolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], neighbours: NDArray[np.int32], gap: float
) -> NDArray[np.float32]:
    """Smooth the `values` (n,) [px] of lenses that are not `known` (n,), first guesses, toward their neighbours.

    Values that differ by more than `gap` [px] belong to different surfaces. A guess that hardly any neighbour has is
    replaced by the median of theirs.
    """
    result = values.copy()
    unknown = np.flatnonzero(~known)
    if unknown.size == 0:
        return result
    for _ in range(_OUTLIER_ROUNDS):
        similar = count_similar(np.ones(len(result), bool), result, neighbours, gap)
        alone = np.flatnonzero(~known & (similar <= 1) & (neighbours >= 0).any(1))
        around = np.where(neighbours[alone] >= 0, result[neighbours[alone]], np.nan)
        # The lower median is a value that one of them has, not the mean of two surfaces.
        result[alone] = np.nanquantile(around, 0.5, axis=1, method="lower") if len(alone) else 0
    other = result.copy()
    for _ in range(_FILL_ROUNDS):
        _smooth(result, unknown, neighbours, np.float32(gap), other)
        result, other = other, result
    return result


@njit(cache=True, nogil=True, error_model="numpy", share=lambda cost, *_: len(cost))
def _find_second_minimum(begin, end, cost, best, distance, index, value):
    for lens in range(begin, end):
        at, least = 0, np.float32(np.inf)
        own = cost[lens]
        for k in range(1, len(own) - 1):
            lowest = own[k] <= own[k - 1] and own[k] < own[k + 1]
            if lowest and own[k] < least and abs(k - best[lens]) >= distance:
                at, least = k, own[k]
        index[lens], value[lens] = at, least


def find_second_minimum(
    cost: NDArray[np.float32], best: NDArray[np.int64], distance: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The lowest other local minimum of the `cost` (n, k) of each lens, before aggregation, and the cost there.

    At least `distance` steps from the `best` (n,); inf where there is none. A lens across a depth edge matches at both
    depths; aggregation would hide the second.
    """
    index, value = np.empty(len(cost), np.int64), np.empty(len(cost), np.float32)
    _find_second_minimum(cost, best, distance, index, value)
    return index, value
