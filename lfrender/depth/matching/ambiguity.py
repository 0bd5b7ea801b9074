"""Ambiguity of a match: other shifts at which a lens correlates as well as at the chosen one.

Semi-global matching prefers shifts with a large overlap, since a match of few pixels is more often chance. In a
periodic texture that preference would hide that several shifts fit equally well. Here shifts are therefore compared by
correlation alone, averaged over the neighbours on the same surface.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat
from .cost_volume import mean_steps
from .settings import AMBIGUITY, AmbiguitySettings

__all__ = ["measure_ambiguity", "overlap_weights"]


def overlap_weights(gray: GrayFlat, rows: NDArray[np.int32], shifts: NDArray[np.float32], half: float) -> NDArray:
    """(k,) float32: weight of a correlation for the overlap at each shift, mean over the directions.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    shifts : (k,) float32 [px of `gray`]
    half : float [px^2]
        Overlap with half weight.
    """
    weight = np.zeros(len(shifts))
    steps = mean_steps(gray, rows)
    for step in map(np.linalg.norm, steps):
        x = np.minimum(np.abs(shifts) * step / (2 * gray.pitch * gray.radius), 1)
        area = 2 * gray.radius**2 * (np.arccos(x) - x * np.sqrt(1 - x * x))
        weight += area / (area + half)
    return (weight / max(len(steps), 1)).astype(np.float32)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _measure_ambiguity(cost, weight, rows, best, wanted, tolerance, settings, uniqueness, primary, secondary):
    least_temperature, temperature_share, dip, least_weight = settings
    shifts = cost.shape[1]
    for lens in prange(len(best)):
        uniqueness[lens] = 1.0
        primary[lens] = secondary[lens] = 0.0
        if not wanted[lens]:
            continue
        own = best[lens]
        mean = np.zeros(shifts, np.float32)
        count = np.zeros(shifts, np.float32)
        for r in range(-1, rows.shape[1]):
            other = np.int64(lens) if r < 0 else np.int64(rows[lens, r])
            if other < 0 or not wanted[other] or abs(best[other] - own) > tolerance:
                continue
            # On a slanted surface the best shifts are aligned first.
            move = best[other] - own
            for k in range(max(0, -move), min(shifts, shifts - move)):
                if weight[k + move] >= least_weight:
                    mean[k] += (1 - cost[other, k + move]) / weight[k + move]
                    count[k] += 1
        for k in range(shifts):
            mean[k] = mean[k] / count[k] if count[k] > 0 else np.float32(-1.0)
        top = mean[own]
        for k in range(max(0, own - 1), min(shifts, own + 2)):
            top = max(top, mean[k])
        mass = np.float32(0.0)
        highest = np.float32(0.0)
        temperature = max(least_temperature, temperature_share * (1 - top))
        for side in (-1, 1):
            low = top
            k = own + side
            while 0 <= k < shifts and count[k] > 0:
                low = min(low, mean[k])
                last = k + side < 0 or k + side >= shifts or count[k + side] == 0
                # A correlation that still rises at the last shift with enough overlap counts as a peak.
                peak = mean[k] > mean[k - side] and (last or mean[k] >= mean[k + side])
                if abs(k - own) > tolerance:
                    if peak and low < mean[k] - dip:
                        mass += np.exp((mean[k] - top) / temperature)
                        low = mean[k]
                        highest = max(highest, mean[k])
                    elif mean[k] > top:
                        mass += np.exp((mean[k] - top) / temperature) - 1
                        highest = mean[k]
                k += side
        uniqueness[lens] = 1 / (1 + mass)
        primary[lens], secondary[lens] = top, highest


def measure_ambiguity(
    cost: NDArray[np.float32],
    weight: NDArray[np.float32],
    rows: NDArray[np.int32],
    best: NDArray[np.int64],
    wanted: NDArray[np.bool_],
    tolerance: int,
    settings: AmbiguitySettings = AMBIGUITY,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Compare each chosen shift with all other peaks of the correlation, whatever their overlap.

    Parameters
    ----------
    cost : (n, k) float32
        Of each lens at each shift, before aggregation.
    weight : (k,) float32
        As `overlap_weights`.
    rows : (n, m) int32
        Neighbour rows, -1 where there is none.
    best : (n,) int
        Chosen shift of each lens.
    wanted : (n,) bool
        Lenses that were matched; the others get 1.
    tolerance : int
        Steps that belong to one peak.
    settings : AmbiguitySettings

    Returns
    -------
    uniqueness : (n,) float32
        Probability of the chosen shift among all peaks.
    primary, secondary : (n,) float32
        Correlation over its overlap weight: at the chosen shift, and at the highest other peak, 0 where there is none.
    """
    uniqueness, primary, secondary = (np.empty(len(best), np.float32) for _ in range(3))
    _measure_ambiguity(cost, weight, rows, best, wanted, tolerance, settings, uniqueness, primary, secondary)
    return uniqueness, primary, secondary
