"""Ambiguity of a match: other shifts at which a lens correlates as well as at the chosen one.

Semi-global matching prefers shifts with a large overlap, since a match of few pixels is more often chance. In a
periodic texture that preference would hide that several shifts fit equally well. Here shifts are therefore compared by
correlation alone, averaged over the neighbours on the same surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

from ...flat.gray_flat import GrayFlat
from .cost_volume import mean_steps
from .settings import AMBIGUITY, AmbiguitySettings

__all__ = ["measure_ambiguity", "overlap_weights"]


def overlap_weights(gray: GrayFlat, rows: NDArray[np.int32], shifts: NDArray[np.float32], half: float) -> NDArray:
    """(k,) float32: weight of a correlation for the overlap at `shifts` (k,) [px of `gray`], mean over the directions.

    `rows` (n, d) are the neighbours; an overlap of `half` [px^2] has half weight.
    """
    weight = np.zeros(len(shifts))
    steps = mean_steps(gray, rows)
    for step in map(np.linalg.norm, steps):
        x = np.minimum(np.abs(shifts) * step / (2 * gray.pitch * gray.radius), 1)
        area = 2 * gray.radius**2 * (np.arccos(x) - x * np.sqrt(1 - x * x))
        weight += area / (area + half)
    return (weight / max(len(steps), 1)).astype(np.float32)


@kernel(error_model="numpy", share=lambda cost, weight, rows, best, *_: len(best))
def _measure_ambiguity(
    begin, end, cost, weight, rows, best, wanted, tolerance, settings, uniqueness, primary, secondary
):
    least_temperature, temperature_share, dip, least_weight = settings
    shifts = cost.shape[1]
    for lens in range(begin, end):
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
    """Compare the shift `best` (n,) of each lens with all other peaks of its correlation, whatever their overlap.

    `cost` (n, k) is that before aggregation, `weight` (k,) as `overlap_weights`, `rows` (n, m) the neighbours, and
    `tolerance` the number of steps that belong to one peak. Lenses that are not `wanted` (n,) were not matched.

    Returns the uniqueness (n,), the probability of the chosen shift among all peaks (1 for lenses that were not
    matched), and the correlation over its overlap weight (n,) there and at the highest other peak (0 if there is none).
    """
    uniqueness, primary, secondary = (np.empty(len(best), np.float32) for _ in range(3))
    _measure_ambiguity(cost, weight, rows, best, wanted, tolerance, settings, uniqueness, primary, secondary)
    return uniqueness, primary, secondary
