"""Other shifts that match as well: of a texture that repeats, or where neighbours share too little to tell.

Semi-global matching favours shifts at which microimages share many pixels, as it must for want of better knowledge: a
match over few of them is more often chance. But where one shift explains no more of the light than another, that
favour is no evidence. So shifts are compared here by correlation alone, pooled over the lenses on one surface.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat
from .cost_volume import mean_steps

__all__ = ["measure_ambiguity", "overlap_weights"]

# Difference of the pooled correlations that makes one shift e times as likely as another, at least, and as a share of
# what the best leaves unexplained: a poor match is hardly better than one that is a little poorer.
_TEMPERATURE, _UNEXPLAINED = np.float32(0.05), np.float32(0.5)
# Between two optima the correlation must fall below that of the worse one by this much.
_DIP = np.float32(0.1)
# Where this much of a correlation was left by the few pixels that are shared, they tell nothing.
_LEAST_TRUST = np.float32(0.3)


def overlap_weights(gray: GrayFlat, rows: NDArray[np.int32], shifts: NDArray[np.float32], half: float) -> NDArray:
    """(k,) float32: share of a correlation that is believed at `shifts` [px of `gray`], mean over the directions.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    shifts : (k,) float32 [px of `gray`]
    half : float [px^2]
        So many shared pixels are half believed.
    """
    trust = np.zeros(len(shifts))
    steps = mean_steps(gray, rows)
    for step in map(np.linalg.norm, steps):
        x = np.minimum(np.abs(shifts) * step / (2 * gray.pitch * gray.radius), 1)
        area = 2 * gray.radius**2 * (np.arccos(x) - x * np.sqrt(1 - x * x))
        trust += area / (area + half)
    return (trust / max(len(steps), 1)).astype(np.float32)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _without_rivals(cost, trust, rows, best, wanted, apart, out, matched, echo):
    shifts = cost.shape[1]
    for lens in prange(len(best)):
        out[lens] = 1.0
        matched[lens] = echo[lens] = 0.0
        if not wanted[lens]:
            continue
        own = best[lens]
        pooled = np.zeros(shifts, np.float32)
        count = np.zeros(shifts, np.float32)
        for r in range(-1, rows.shape[1]):
            other = np.int64(lens) if r < 0 else np.int64(rows[lens, r])
            if other < 0 or not wanted[other] or abs(best[other] - own) > apart:
                continue
            # Lenses of a slanted surface are laid over each other.
            move = best[other] - own
            for k in range(max(0, -move), min(shifts, shifts - move)):
                if trust[k + move] >= _LEAST_TRUST:
                    pooled[k] += (1 - cost[other, k + move]) / trust[k + move]
                    count[k] += 1
        for k in range(shifts):
            pooled[k] = pooled[k] / count[k] if count[k] > 0 else np.float32(-1.0)
        top = pooled[own]
        for k in range(max(0, own - 1), min(shifts, own + 2)):
            top = max(top, pooled[k])
        mass = np.float32(0.0)
        loudest = np.float32(0.0)
        temperature = max(_TEMPERATURE, _UNEXPLAINED * (1 - top))
        for side in (-1, 1):
            low = top
            k = own + side
            while 0 <= k < shifts and count[k] > 0:
                low = min(low, pooled[k])
                last = k + side < 0 or k + side >= shifts or count[k + side] == 0
                # What still rises where too few pixels are shared to look on is an optimum as well.
                peak = pooled[k] > pooled[k - side] and (last or pooled[k] >= pooled[k + side])
                if abs(k - own) > apart:
                    if peak and low < pooled[k] - _DIP:
                        mass += np.exp((pooled[k] - top) / temperature)
                        low = pooled[k]
                        loudest = max(loudest, pooled[k])
                    elif pooled[k] > top:
                        mass += np.exp((pooled[k] - top) / temperature) - 1
                        loudest = pooled[k]
                k += side
        out[lens] = 1 / (1 + mass)
        matched[lens], echo[lens] = top, loudest


def measure_ambiguity(
    cost: NDArray[np.float32],
    trust: NDArray[np.float32],
    rows: NDArray[np.int32],
    best: NDArray[np.int64],
    wanted: NDArray[np.bool_],
    apart: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """How each chosen shift stands beside all others that correlate in their own right, whatever they share.

    Parameters
    ----------
    cost : (n, k) float32
        Of each lens at each shift, before aggregation.
    trust : (k,) float32
        As `overlap_weights`.
    rows : (n, m) int32
        Neighbour rows, -1 where there is none.
    best : (n,) int
        Chosen shift of each lens.
    wanted : (n,) bool
        Lenses that were matched; the others get 1.
    apart : int
        Steps that belong to one optimum.

    Returns
    -------
    probability : (n,) float32
        Of the chosen shift.
    matched, echo : (n,) float32
        Correlation over what the shared pixels let it be: at the chosen shift, and at the best of the others, 0 where
        there is no other.
    """
    probability, matched, echo = (np.empty(len(best), np.float32) for _ in range(3))
    _without_rivals(cost, trust, rows, best, wanted, apart, probability, matched, echo)
    return probability, matched, echo
