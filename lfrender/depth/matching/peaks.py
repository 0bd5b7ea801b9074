"""Minima of the matching cost: the best shift, its sub-step offset and probability, and the second best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_similar
from ..same_surface import same_surface

__all__ = ["confidence", "fill_unresolved", "find_second_minimum", "fit_parabola"]

# Cost difference, per path, that makes one shift e times as likely as another; measured on simulated scenes.
_TEMPERATURE = 0.05
# Rounds of smoothing that spread patch sizes over unresolved lenses.
_FILL_ROUNDS = 24
# Rounds in which guesses that stand alone are replaced before: pairs of them lose one at a time.
_OUTLIER_ROUNDS = 3


def confidence(total: NDArray[np.float32], best: NDArray[np.int64], paths: int, tolerance: int) -> NDArray[np.float32]:
    """(n,) posterior probability that the true shift lies within `tolerance` steps of the `best` (n,).

    `total` (n, k) is the aggregated cost, a sum over so many `paths`, of which `best` is the minimum.
    """
    mass = np.exp((total.min(1, keepdims=True) - total) / np.float32(paths * _TEMPERATURE))
    inside = np.abs(np.arange(total.shape[1]) - best[:, None]) <= tolerance
    return np.asarray((mass * inside).sum(1) / mass.sum(1))


def fit_parabola(total: NDArray[np.float32], best: NDArray[np.int64]) -> NDArray[np.float32]:
    """(n,) float32: offset of the minimum from `best`, in steps, of the parabola through three costs."""
    lens, last = np.arange(len(best)), total.shape[1] - 1
    left, middle, right = (total[lens, np.clip(best + k, 0, last)] for k in (-1, 0, 1))
    bend = left - (middle + middle) + right
    fitted = (best > 0) & (best < last) & (bend > 1e-9)
    return np.where(fitted, np.clip((left - right) / (2 * np.where(fitted, bend, 1)), -0.5, 0.5), 0).astype(np.float32)


def fill_unresolved(
    values: NDArray[np.float32], known: NDArray[np.bool_], neighbours: NDArray[np.int32], gap: float
) -> NDArray[np.float32]:
    """Smooth the `values` (n,) [px] of lenses that are not `known` (n,), first guesses, toward their neighbours.

    Values that differ by more than `gap` [px] belong to different surfaces. A guess that hardly any neighbour has is
    replaced by the median of theirs.
    """
    result = values.copy()
    for _ in range(_OUTLIER_ROUNDS):
        similar = count_similar(np.ones(len(result), bool), result, neighbours, gap)
        alone = np.flatnonzero(~known & (similar <= 1) & (neighbours >= 0).any(1))
        around = np.where(neighbours[alone] >= 0, result[neighbours[alone]], np.nan)
        # The lower median is a value that one of them has, not the mean of two surfaces.
        result[alone] = np.nanquantile(around, 0.5, axis=1, method="lower") if len(alone) else 0
    unknown = np.flatnonzero(~known)
    rows = neighbours[unknown]
    for _ in range(_FILL_ROUNDS):
        around, own = result[rows], result[unknown]
        alike = (rows >= 0) & same_surface(around, own[:, None], np.float32(gap))
        count = alike.sum(1)
        result[unknown] = np.where(count > 0, np.where(alike, around, 0).sum(1) / np.maximum(count, 1), own)
    return result


def find_second_minimum(
    cost: NDArray[np.float32], best: NDArray[np.int64], distance: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The lowest other local minimum of the `cost` (n, k) of each lens, before aggregation, and the cost there.

    At least `distance` steps from the `best` (n,); inf where there is none. A lens across a depth edge matches at both
    depths; aggregation would hide the second.
    """
    lowest = np.full(cost.shape, np.float32(np.inf))
    inner = cost[:, 1:-1]
    other = np.abs(np.arange(1, cost.shape[1] - 1) - best[:, None]) >= distance
    here = other & (inner <= cost[:, :-2]) & (inner < cost[:, 2:])
    lowest[:, 1:-1][here] = inner[here]
    index = lowest.argmin(1)
    return index, lowest[np.arange(len(cost)), index]
