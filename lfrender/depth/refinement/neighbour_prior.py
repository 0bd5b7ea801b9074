"""Sub-pixel patch size of each lens from its pairs, combined with the patch size that its neighbours predict.

The prediction is used twice: as another start value for doubtful lenses, and as a prior for all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import join_opposite
from ..same_surface import same_surface
from .lens_plane import LensFits, fit_lens_planes
from .pair_fit import fit_pairs
from .settings import NeighbourPriorSettings

__all__ = ["refine_patch_sizes"]

_DEFAULT = NeighbourPriorSettings()


@njit(cache=True, nogil=True)
def _median(values, count, ordered):
    """Median of the first `count` values, by insertion into `ordered`: the fastest way for so few."""
    for k in range(count):
        value = values[k]
        at = k
        while at > 0 and ordered[at - 1] > value:
            ordered[at] = ordered[at - 1]
            at -= 1
        ordered[at] = value
    return np.float32(0.5) * (ordered[(count - 1) // 2] + ordered[count // 2])


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", share=lambda centres, *_: len(centres))
def _predict(
    begin, end, centres, pitch, neighbours, sizes, errors, slants, usable_error, outlier, about, reach, means, spreads
):
    """Fill `means` and `spreads` with the mean and standard deviation of what neighbours predict within `reach` of
    `about`; NaN where no neighbour has an error below `usable_error`, the deviation also where fewer than three do."""
    most = neighbours.shape[1]
    for lens in range(begin, end):
        means[lens] = spreads[lens] = np.nan
        values, apart = np.empty(most, np.float32), np.empty(most, np.float32)
        ordered = np.empty(most, np.float32)
        count = 0
        for k in range(most):
            other = neighbours[lens, k]
            if other < 0 or not errors[other] < usable_error:
                continue
            # Over a plane 1 / s is linear in X, with the slant D * grad(1 / s) * s.
            ex, ey = centres[other, 0] - centres[lens, 0], centres[other, 1] - centres[lens, 1]
            value = sizes[other] / (1 - (slants[other, 0] * ex + slants[other, 1] * ey) / pitch)
            if same_surface(value, about[lens], reach):
                values[count] = value
                count += 1
        if count == 0:
            continue
        median = _median(values, count, ordered)
        for k in range(count):
            apart[k] = abs(values[k] - median)
        limit = max(outlier, np.float32(3 * 1.48) * _median(apart, count, ordered))
        total = squares = np.float32(0.0)
        kept = 0
        for k in range(count):
            if same_surface(values[k], median, limit):
                total += values[k] - median
                squares += square(values[k] - median)
                kept += 1
        means[lens] = median + total / kept
        if kept > 2:
            spreads[lens] = np.sqrt(max((squares - total * total / kept) / (kept - 1), np.float32(0.0)))


def _predicted(
    gray: GrayFlat,
    neighbours: NDArray[np.int32],
    fits: LensFits,
    about: NDArray[np.float32],
    reach: float,
    settings: NeighbourPriorSettings,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Patch size (n,) [px] that neighbours, extended as planes, predict within `reach` of `about`, and its error."""
    means, spreads = np.empty(len(about), np.float32), np.empty(len(about), np.float32)
    _predict(
        gray.centres, np.float32(gray.pitch), neighbours, fits.patch_size, fits.standard_error, fits.slant,
        np.float32(settings.usable_error), np.float32(settings.outlier), about, np.float32(reach), means, spreads,
    )  # fmt: skip
    return means, np.hypot(spreads, np.float32(settings.least_spread))


def refine_patch_sizes(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    start: NDArray[np.float32],
    second: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float | None = None,
    settings: NeighbourPriorSettings = _DEFAULT,
) -> tuple[LensFits, LensFits]:
    """Sub-pixel patch size of each lens from its own pairs, and the same with the prior of its neighbours.

    Doubtful lenses are fitted again from what their neighbours predict, from a larger patch size where matches are
    biased, and from the second-best match; the fit with the smaller error is kept. The best match is the mean over all
    pairs, including those in which one lens is occluded, so that pairs may agree better on the second-best one.

    Parameters
    ----------
    gray : GrayFlat
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    start : (n,) float32 [px]
        Start values; NaN for lenses to leave out.
    second : (n,) float32 [px]
        Other values that may be right, far from the first; NaN where there is none.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly show the same point.
    noise : float
        Standard deviation of a pixel.
    iterations : int
        Of each fit of a pair, at most.
    last_step : float [px of `gray`], optional
        As `fit_pairs`.
    settings : NeighbourPriorSettings
    """
    neighbours = join_opposite(forward, backward)

    def fit(start: NDArray[np.float32]) -> LensFits:
        pairs = fit_pairs(gray, forward, start, scale, noise, iterations, last_step)
        return fit_lens_planes(gray, forward, backward, pairs, start)

    first = fit(start)
    predicted, _ = _predicted(gray, neighbours, first, start, settings.nearby_start * gray.pitch, settings)
    near = np.abs(predicted - first.patch_size) < np.maximum(settings.tolerated, first.standard_error)
    settled = (first.standard_error < settings.doubtful_error) | near
    own = first if settled.all() else _better_of(first, fit(np.where(settled, np.nan, predicted).astype(np.float32)))
    far = np.abs(start) > settings.far_patch_size * gray.pitch
    larger = start + np.sign(start) * settings.bias * gray.pitch
    for other, possible in ((larger, far), (second, np.isfinite(second))):
        doubtful = (own.standard_error >= settings.doubtful_error) & possible
        if doubtful.any():
            again = fit(np.where(doubtful, other, np.nan).astype(np.float32))
            own = _better_of(own, again, settings.clearly_better)
    prior = _predicted(gray, neighbours, own, own.patch_size, np.inf, settings)
    return own, _combine(own, *prior, settings.correlation)


def _better_of(one: LensFits, other: LensFits, share: float = 1.0) -> LensFits:
    """For each lens the other fit if its error is less than a `share` of the first one's."""
    better = other.standard_error < np.float32(share) * one.standard_error
    return LensFits(
        np.where(better, other.patch_size, one.patch_size),
        np.where(better, other.standard_error, one.standard_error),
        np.where(better[:, None], other.slant, one.slant),
        np.where(better, other.slant_error, one.slant_error),
    )


def _combine(
    own: LensFits, predicted: NDArray[np.float32], spread: NDArray[np.float32], correlation: float
) -> LensFits:
    """Weighted mean of own and predicted patch sizes if they differ by less than three standard deviations."""
    error = own.standard_error
    with np.errstate(invalid="ignore"):
        agree = np.abs(predicted - own.patch_size) < 3 * np.hypot(spread, error)
        weight = np.where(agree & np.isfinite(error), error**2 / (error**2 + spread**2), 0)
        joint = (1 - weight) ** 2 * error**2 + weight**2 * spread**2
        joint += 2 * np.float32(correlation) * weight * (1 - weight) * error * spread
        patch_size = np.where(weight > 0, own.patch_size + weight * (predicted - own.patch_size), own.patch_size)
        return LensFits(
            patch_size.astype(np.float32),
            np.where(weight > 0, np.sqrt(joint), error).astype(np.float32),
            own.slant,
            own.slant_error,
        )
