"""What the lenses around each lens expect of it: a second start for the doubtful, and support for all."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square

from ...flat.gray_flat import GrayFlat
from .lens_plane import LensFits, fit_lens_planes
from .pair_fit import LAST_STEP, fit_pairs

__all__ = ["refine_patch_sizes"]

# Lenses with a larger standard error [px] expect nothing of others; those above the second number are doubtful
# where they also differ from what is expected by more than the third.
_EXPECTING, _DOUBTFUL, _APART = np.float32(0.3), 0.15, 0.2
# Expectations farther from their median than three times their scatter, at least this [px], are of other surfaces.
_OUTLYING = np.float32(0.15)
# A second start may differ from the first by this share of the pitch: more would be another label, not an offset.
_OFFSET = 0.15
# Beyond this share of the pitch neighbours share less than half of what they show, and where texture is weak the search
# falls short of the right shift by about the second share. A start from there, or from another shift that matched, must
# clearly pay: its error must be less than the third share of the other's.
_LEANING, _LEAN, _CLEARLY = 0.45, 0.06, 0.7
# Neighbouring lenses share pairs: correlation of an expectation's error with the lens's own.
_SHARED = np.float32(0.5)
_LEAST_SPREAD = np.float32(0.01)


@njit(cache=True, nogil=True)
def _median(values, count, ordered):
    """Median of the first `count` values, which are put in order in `ordered`: of so few no general sort is as fast."""
    for k in range(count):
        value = values[k]
        at = k
        while at > 0 and ordered[at - 1] > value:
            ordered[at] = ordered[at - 1]
            at -= 1
        ordered[at] = value
    return np.float32(0.5) * (ordered[(count - 1) // 2] + ordered[count // 2])


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _expect(centres, pitch, forward, backward, sizes, errors, slants, about, reach, means, spreads):
    half = forward.shape[1]
    for lens in prange(len(centres)):
        means[lens] = spreads[lens] = np.nan
        values, apart = np.empty(2 * half, np.float32), np.empty(2 * half, np.float32)
        ordered = np.empty(2 * half, np.float32)
        count = 0
        for k in range(2 * half):
            other = forward[lens, k] if k < half else backward[lens, k - half]
            if other < 0 or not errors[other] < _EXPECTING:
                continue
            # Over a plane 1 / s is linear in X, with the slant D * grad(1 / s) * s.
            ex, ey = centres[other, 0] - centres[lens, 0], centres[other, 1] - centres[lens, 1]
            value = sizes[other] / (1 - (slants[other, 0] * ex + slants[other, 1] * ey) / pitch)
            if abs(value - about[lens]) < reach:
                values[count] = value
                count += 1
        if count == 0:
            continue
        median = _median(values, count, ordered)
        for k in range(count):
            apart[k] = abs(values[k] - median)
        limit = max(_OUTLYING, np.float32(3 * 1.48) * _median(apart, count, ordered))
        total = squares = np.float32(0.0)
        kept = 0
        for k in range(count):
            if abs(values[k] - median) <= limit:
                total += values[k] - median
                squares += square(values[k] - median)
                kept += 1
        means[lens] = median + total / kept
        if kept > 2:
            spreads[lens] = np.sqrt(max((squares - total * total / kept) / (kept - 1), np.float32(0.0)))


def _expected(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    lenses: LensFits,
    about: NDArray[np.float32],
    reach: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Patch size that the neighbours of each lens, carried on as planes, expect of it, and its standard deviation.

    Only what lies within `reach` of `about` counts. NaN where there is nothing; the deviation also
    where fewer than three neighbours agree.
    """
    means, spreads = np.empty(len(about), np.float32), np.empty(len(about), np.float32)
    _expect(
        gray.centres, np.float32(gray.pitch), forward, backward, lenses.patch_size, lenses.standard_error,
        lenses.slant, about, np.float32(reach), means, spreads,
    )  # fmt: skip
    return means, np.hypot(spreads, _LEAST_SPREAD)


def refine_patch_sizes(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    start: NDArray[np.float32],
    second: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float = LAST_STEP,
) -> tuple[LensFits, LensFits]:
    """Sub-pixel patch size of each lens from its own pixels, and then with the lenses around it.

    Where a fit is doubtful and the neighbours expect something else nearby, a second fit starts from
    there and the more certain one is kept. Where it is still doubtful and another value matched nearly as well, on
    which the pairs agree clearly better, that is kept: the search takes the mean over all pairs, also over those of
    which one lens shows what hides the scene from the other. At last each lens is weighed with what its neighbours
    expect of it.

    Parameters
    ----------
    gray : GrayFlat
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    start : (n,) float32 [px]
        First values; NaN for lenses to leave alone.
    second : (n,) float32 [px]
        Other values that may be right, far from the first; NaN where there is none.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly count as the same point.
    noise : float
        Standard deviation of a pixel.
    iterations : int
        Of each fit of a pair, at most.
    last_step : float [px of `gray`]
        As `fit_pairs`.
    """

    def fit(start: NDArray[np.float32]) -> LensFits:
        pairs = fit_pairs(gray, forward, start, scale, noise, iterations, last_step)
        return fit_lens_planes(gray, forward, backward, pairs, start)

    first = fit(start)
    expected, _ = _expected(gray, forward, backward, first, start, _OFFSET * gray.pitch)
    tolerated = np.maximum(_APART, first.standard_error)
    settled = (first.standard_error < _DOUBTFUL) | (np.abs(expected - first.patch_size) < tolerated)
    own = first if settled.all() else _surer(first, fit(np.where(settled, np.nan, expected).astype(np.float32)))
    leaning = (own.standard_error >= _DOUBTFUL) & (np.abs(start) > _LEANING * gray.pitch)
    if leaning.any():
        farther = np.where(leaning, start + np.sign(start) * _LEAN * gray.pitch, np.nan).astype(np.float32)
        own = _surer(own, fit(farther), _CLEARLY)
    torn = (own.standard_error >= _DOUBTFUL) & np.isfinite(second)
    if torn.any():
        own = _surer(own, fit(np.where(torn, second, np.nan).astype(np.float32)), _CLEARLY)
    return own, _supported(own, *_expected(gray, forward, backward, own, own.patch_size, np.inf))


def _surer(one: LensFits, other: LensFits, share: float = 1.0) -> LensFits:
    """Of each lens the other answer where its error is less than a `share` of that of the one."""
    better = other.standard_error < np.float32(share) * one.standard_error
    return LensFits(
        np.where(better, other.patch_size, one.patch_size),
        np.where(better, other.standard_error, one.standard_error),
        np.where(better[:, None], other.slant, one.slant),
        np.where(better, other.slant_error, one.slant_error),
    )


def _supported(own: LensFits, expected: NDArray[np.float32], spread: NDArray[np.float32]) -> LensFits:
    """Weighted mean of own and expected values where they do not contradict each other."""
    error = own.standard_error
    with np.errstate(invalid="ignore"):
        agree = np.abs(expected - own.patch_size) < 3 * np.hypot(spread, error)
        weight = np.where(agree & np.isfinite(error), error**2 / (error**2 + spread**2), 0)
        joint = (1 - weight) ** 2 * error**2 + weight**2 * spread**2
        joint += 2 * _SHARED * weight * (1 - weight) * error * spread
        patch_size = np.where(weight > 0, own.patch_size + weight * (expected - own.patch_size), own.patch_size)
        return LensFits(
            patch_size.astype(np.float32),
            np.where(weight > 0, np.sqrt(joint), error).astype(np.float32),
            own.slant,
            own.slant_error,
        )
