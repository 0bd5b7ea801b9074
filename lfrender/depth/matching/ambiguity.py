"""Ambiguity of a match: other shifts at which a lens correlates as well as at the chosen one.

Semi-global matching prefers shifts with a large overlap, since a match of few pixels is more often
chance. In a periodic texture that preference would hide that several shifts fit equally well. Here
shifts are therefore compared by correlation alone, averaged over the neighbours on the same
surface.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

__all__ = ["LEAST_WEIGHT", "measure_ambiguity"]

#: Overlap weight below which a correlation is not used.
LEAST_WEIGHT = np.float32(0.3)


@kernel(error_model="numpy", share=lambda cost, weight, rows, best, *_: len(best))
def _measure_ambiguity(begin, end, cost, weight, rows, best, wanted, tolerance, uniqueness):
    shifts = cost.shape[1]
    for lens in range(begin, end):
        uniqueness[lens] = 1.0
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
                if weight[k + move] >= LEAST_WEIGHT:
                    mean[k] += (1 - cost[other, k + move]) / weight[k + move]
                    count[k] += 1
        for k in range(shifts):
            mean[k] = mean[k] / count[k] if count[k] > 0 else np.float32(-1.0)
        top = mean[own]
        for k in range(max(0, own - 1), min(shifts, own + 2)):
            top = max(top, mean[k])
        mass = np.float32(0.0)
        # A difference of correlation that makes one shift e times as likely as another: poor
        # matches differ less clearly.
        temperature = max(np.float32(0.05), np.float32(0.5) * (1 - top))
        for side in (-1, 1):
            low = top
            k = own + side
            while 0 <= k < shifts and count[k] > 0:
                low = min(low, mean[k])
                last = k + side < 0 or k + side >= shifts or count[k + side] == 0
                # A correlation that still rises at the last shift with enough overlap counts as a
                # peak.
                peak = mean[k] > mean[k - side] and (last or mean[k] >= mean[k + side])
                if abs(k - own) > tolerance:
                    # Between two separate peaks it falls.
                    if peak and low < mean[k] - np.float32(0.1):
                        mass += np.exp((mean[k] - top) / temperature)
                        low = mean[k]
                    elif mean[k] > top:
                        mass += np.exp((mean[k] - top) / temperature) - 1
                k += side
        uniqueness[lens] = 1 / (1 + mass)


def measure_ambiguity(
    cost: NDArray[np.float32],
    weight: NDArray[np.float32],
    rows: NDArray[np.int32],
    best: NDArray[np.int64],
    wanted: NDArray[np.bool_],
    tolerance: int,
) -> NDArray[np.float32]:
    """Uniqueness (n,): the probability of the shift `best` (n,) among all peaks of the correlation,
    1 for lenses not matched.

    `cost` (n, k) is that before aggregation, `weight` (k,) that of the overlap, `rows` (n, m) the
    neighbours, and `tolerance` the number of steps that belong to one peak; lenses that are not
    `wanted` (n,) were not matched.
    """
    uniqueness = np.empty(len(best), np.float32)
    _measure_ambiguity(cost, weight, rows, best, wanted, tolerance, uniqueness)
    return uniqueness
