"""The search: which signed shift lets each lens agree with its neighbours, all of them or those that occur."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat, downsample
from ...flat.lens_graph import dilate_mask, join_opposite
from ...flat.microimages import OverlapMasks, Strips, extract_strips
from ...flat.texture import FIXED_PATTERN_CONTRAST, LensStatistics, Texture, measure_statistics
from ...runtime.cache import cached
from ..presets import Preset
from .ambiguity import measure_ambiguity, overlap_weights
from .cost_volume import compute_pair_costs, half_weight_area, overlap_masks
from .local_match import probe
from .peaks import confidence, find_second_minimum, fit_parabola, least
from .sgm import aggregate_costs, average_pair_costs

__all__ = ["MatchResult", "Matcher", "match_lenses"]


# The search reaches a little beyond the last resolvable shift, so that it has a rising flank on both sides.
_SEARCHED = 0.82
# Prices of semi-global matching in units of the match cost (0 perfect, 1 unrelated). On ray-traced and real flats a
# slant costs little at half the price, and at double the price depth edges begin to suffer.
_SLOPE_PER_PIXEL, _JUMP = 0.07, 0.8
# Radii [px] below which microimages have no row to spare, and no shift either.
_NO_ROW_TO_SPARE, _LEAST_RADIUS, _TINY_STEP = 7.0, 4.0, 0.5
# A second depth is tried on the pixels when it matches the lens at most this much worse, and the first leaves
# this much unexplained.
_SECOND, _UNEXPLAINED = 0.3, 0.2
# A match that leaves more than this unexplained may have a better one where nobody has looked.
MISFIT = 0.35
# Of fewer lenses than this share microimages are cut out for these and their neighbours alone.
_FEW = 0.2
# Where pairs agree clearly better on the next best value, it is the right one for this share of the lenses.
_TURNED = np.float32(0.6)
# Beyond the last pixel that is shared no correlation is anything.
_LEAST_TRUST = np.float32(0.02)
# Lenses that match as well at another shift are torn; texture repeats where this share of them is.
_TORN, _REPEATED = 0.5, 0.2
# A sampled lens tells a range of depths that occurs when its match is half explained or better.
_TELLING = 0.5
# Lattice directions in which lenses are probed: detail along one of them shows no shift there.
_PROBED = 2
# Ranges reach so far beyond the depths of the samples [share of the pitch]: the depths between two samples.
_MARGIN = 0.12
# A range needs so many samples: a single one is more likely a false match, and the check finds what is there.
_SUPPORT = 2


@dataclass(frozen=True)
class MatchResult:
    """Answers of the search for every lens, patch sizes in px of the flat.

    Parameters
    ----------
    patch_size, confidence : (n,) float32
        Best value and the probability that it is the right optimum.
    evidence : (n,) float32
        Correlation of the lens with its neighbours there, 0..1.
    explained : (n,) float32
        The same over what the pixels that they share let it be at most.
    rivals : (n,) float32
        Probability of the best value among all that correlate as well, whatever neighbours share there.
    matched, echo : (n,) float32
        Correlation over what it can be at most, at the best value and at the best of those others, 0 where there is
        none; pooled with the lenses around it.
    second : (n,) float32
        Next best value, NaN where no other comes near.
    second_evidence, second_explained : (n,) float32
        As `correlation` and `normalised_correlation`, at the next best value.
    step : float
        Between the values that were tried.
    untried : float
        Share of the shifts of all matched lenses that were left out.
    """

    patch_size: NDArray[np.float32]
    confidence: NDArray[np.float32]
    correlation: NDArray[np.float32]
    normalised_correlation: NDArray[np.float32]
    uniqueness: NDArray[np.float32]
    primary_peak: NDArray[np.float32]
    secondary_peak: NDArray[np.float32]
    second: NDArray[np.float32]
    second_correlation: NDArray[np.float32]
    second_normalised: NDArray[np.float32]
    step: float
    skipped_share: float

    def swap_second(self, lenses: NDArray[np.bool_]) -> MatchResult:
        """These with the best and the next best value of some `lenses` (n,) exchanged."""
        return replace(
            self,
            patch_size=np.where(lenses, self.second, self.patch_size),
            second=np.where(lenses, self.patch_size, self.second),
            correlation=np.where(lenses, self.second_correlation, self.correlation),
            second_correlation=np.where(lenses, self.correlation, self.second_correlation),
            normalised_correlation=np.where(lenses, self.second_normalised, self.normalised_correlation),
            second_normalised=np.where(lenses, self.normalised_correlation, self.second_normalised),
            confidence=np.where(lenses, np.minimum(_TURNED, self.confidence), self.confidence),
        )


class Matcher:
    """A flat made as small as the preset asks for, and the shifts to try on it.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    setting : Preset
    asked : (n,) bool, optional
        Lenses that will be matched; all may be by default.
    """

    def __init__(
        self,
        texture: Texture,
        forward: NDArray[np.int32],
        backward: NDArray[np.int32],
        setting: Preset,
        asked: NDArray[np.bool_] | None = None,
    ) -> None:
        self.factor = max(1, round(texture.flat.pitch / setting.search_pitch))
        wanted = None if asked is None else dilate_mask(asked, join_opposite(forward, backward))
        self.gray: GrayFlat = downsample(texture.flat, self.factor, wanted)
        self.statistics: LensStatistics = texture.statistics
        if self.factor > 1:
            self.statistics = measure_statistics(self.gray, wanted=wanted)
        # Of tiny microimages every row is needed, and every half pixel: the depth that few pixels share is biased.
        row_step = 1 if self.gray.radius < _NO_ROW_TO_SPARE else setting.row_step
        self.step = setting.step if self.factor > 1 else max(setting.step, setting.full_step)
        self.step = min(self.step, _TINY_STEP) if self.gray.radius < _LEAST_RADIUS else self.step
        side = int(np.ceil(_SEARCHED * self.gray.pitch / self.step))
        self.shifts = (np.arange(-side, side + 1) * self.step).astype(np.float32)
        self.forward, self.backward = forward, backward
        self._noise, self._row_step = texture.noise / self.factor, row_step

    @cached_property
    def rows(self) -> NDArray[np.int32]:
        """(n, 2 d) neighbour rows in all directions, -1 where there is none."""
        return join_opposite(self.forward, self.backward)

    @cached_property
    def trust(self) -> NDArray[np.float32]:
        """(k,) float32: share of a correlation that is believed at each shift, for the pixels that are shared there."""
        return overlap_weights(self.gray, self.forward, self.shifts, half_weight_area(self.gray))

    def downscaled(self, texture: Texture) -> Texture:
        """The texture it was made of, on the smaller flat that it matches."""
        return replace(texture, flat=self.gray, statistics=self.statistics, noise=self._noise)

    def _strips(self, active: NDArray[np.bool_]) -> Strips:
        """The microimages of the `active` lenses and of those beside them."""
        wanted = None
        if active.sum() < _FEW * len(active):
            wanted = dilate_mask(active, self.rows)
        return extract_strips(self.gray, self.statistics.mean, self._row_step, wanted)

    @cached_property
    def _masks(self) -> OverlapMasks:
        strips = extract_strips(self.gray, self.statistics.mean, self._row_step, np.zeros(len(self.gray.centres), bool))
        return overlap_masks(strips, self.gray, self.forward, self.shifts)

    def pairs(
        self,
        active: NDArray[np.bool_],
        which: NDArray[np.int64] | None = None,
        done: NDArray[np.bool_] | None = None,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """(n, d, k) float32 costs of the pairs of all `active` lenses, as `compute_pair_costs`."""
        return compute_pair_costs(
            self.gray, self.forward, self.statistics.mean, self.statistics.contrast, active, self.shifts, self._noise,
            FIXED_PATTERN_CONTRAST, self._row_step, which, done, out, self._strips(active), self._masks,
        )  # fmt: skip

    def probe(
        self, active: NDArray[np.bool_], about: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """(n,) float32 costs of the `active` lenses at what is expected `about` each, [px] how far beside it the
        least costs lie, and the standard error of that for one pair.

        Pairs in two directions tell whether a lens shows what is expected; the third adds little.
        """
        forward, backward = (_probed(rows) for rows in (self.forward, self.backward))
        return probe(self.gray, forward, backward, self.statistics, active, about, self._noise, self._strips(active))

    def costs(self, pair: NDArray[np.float32], wanted: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """(m, k) float32: mean over the pairs of each lens, or of each of the `wanted` (n,)."""
        return average_pair_costs(pair, self.forward, self.backward, wanted)

    def populated(self, sizes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(k,) bool: shifts near those that belong to patch sizes (m,) [px of the flat] of other lenses."""
        best = np.rint(sizes / (self.factor * self.step)).astype(int) + len(self.shifts) // 2
        return _near(np.bincount(np.clip(best, 0, len(self.shifts) - 1), minlength=len(self.shifts)), self)

    def repeats(self, cost: NDArray[np.float32]) -> bool:
        """Whether many lenses, of these costs (m, k), match as well at another shift: their texture repeats."""
        best, alone = cost.argmin(1), np.empty((len(cost), 0), np.int32)
        rivals, *_ = measure_ambiguity(cost, self.trust, alone, best, np.ones(len(cost), bool), self.tolerance())
        return bool(len(cost) and (rivals < _TORN).mean() > _REPEATED)

    def tolerance(self) -> int:
        """Steps that belong to one optimum."""
        return max(1, round(1.5 / self.step))


def _probed(rows: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, d) neighbour rows in the directions in which lenses are probed; shared, as `neighbour_rows`."""
    return cached(rows, "probed", lambda: np.ascontiguousarray(rows[:, :_PROBED]))


def match_lenses(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    sample: NDArray[np.bool_] | None,
    known: NDArray[np.float32] | None = None,
    sizes: NDArray[np.float32] | None = None,
) -> MatchResult:
    """Match signed shifts, lenses supporting each other.

    Parameters
    ----------
    matcher : Matcher
    active, clear : (n,) bool
        Lenses to match, and those of them that clearly carry texture.
    sample : (n,) bool, optional
        Lenses that are matched at all shifts first; the others then only where some of these have their depth,
        unless that leaves them without a match. None matches all lenses at all shifts.
    known : (n,) float32 [px of the flat], optional
        Patch sizes of lenses that need no answer, to support their neighbours; NaN elsewhere.
    sizes : (m,) float32 [px of the flat], optional
        Patch sizes that occur, as found elsewhere, instead of those of a `sample`.
    """
    pair, untried = _all_pairs(matcher, active, clear, sample, sizes)
    cost = matcher.costs(pair)
    step = matcher.step
    wanted = None
    if known is not None:
        settled = np.isfinite(known)
        wanted = ~settled
        away = np.abs(matcher.shifts - known[settled, None] / matcher.factor)
        cost[settled] = np.minimum(away / np.float32(matcher.tolerance() * step), 1)
    total = aggregate_costs(cost, matcher.forward, matcher.backward, _SLOPE_PER_PIXEL * step, _JUMP, wanted)
    best, _ = least(total)
    own = cost[np.arange(len(best)), best]
    other, other_cost = find_second_minimum(cost, best, max(2, round(2 / step)))
    rival = (own > _UNEXPLAINED) & (other_cost < own + _SECOND)
    factor, shifts, trust = matcher.factor, matcher.shifts, np.maximum(matcher.trust, _LEAST_TRUST)
    rivals, matched, echo = measure_ambiguity(cost, matcher.trust, matcher.rows, best, active, matcher.tolerance())
    return MatchResult(
        patch_size=((shifts[best] + fit_parabola(total, best) * step) * factor).astype(np.float32),
        confidence=confidence(total, best, 2 * matcher.forward.shape[1], matcher.tolerance()),
        correlation=1 - own,
        normalised_correlation=((1 - own) / trust[best]).astype(np.float32),
        uniqueness=rivals,
        primary_peak=matched,
        secondary_peak=echo,
        second=np.where(rival, (shifts[other] + fit_parabola(cost, other) * step) * factor, np.nan).astype(np.float32),
        second_correlation=1 - other_cost,
        second_normalised=((1 - other_cost) / trust[other]).astype(np.float32),
        step=step * factor,
        skipped_share=untried,
    )


def _all_pairs(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    sample: NDArray[np.bool_] | None,
    sizes: NDArray[np.float32] | None,
) -> tuple[NDArray[np.float32], float]:
    """Pair costs of all active lenses where it matters, and the share of the work that was left out."""
    if sample is None and sizes is None:
        return matcher.pairs(active), 0.0
    if sizes is not None:
        sample = np.zeros_like(active)
    assert sample is not None
    pair = matcher.pairs(sample)
    if sizes is None and matcher.repeats(matcher.costs(pair, sample)):
        return matcher.pairs(active, done=sample, out=pair), 0.0
    populated = _occurring(matcher.costs(pair, sample), matcher) if sizes is None else matcher.populated(sizes)
    if populated.all():
        return matcher.pairs(active, done=sample, out=pair), 0.0
    matcher.pairs(active, which=np.flatnonzero(populated), done=sample, out=pair)
    best, lowest = least(matcher.costs(pair), populated)
    # A least value at the end of a range goes on beyond it.
    end = populated & ~(np.roll(populated, 1) & np.roll(populated, -1))
    end[[0, -1]] = False
    doubtful = clear & active & ~sample & ((lowest > MISFIT) | end[best])
    matcher.pairs(doubtful, which=np.flatnonzero(~populated), done=sample, out=pair)
    spared = (active & ~sample & ~doubtful).sum() * (~populated).sum()
    return pair, float(spared / max(1, active.sum() * len(populated)))


def _occurring(cost: NDArray[np.float32], matcher: Matcher) -> NDArray[np.bool_]:
    """(k,) bool: shifts near those that sampled lenses (m, k) agree with their neighbours at."""
    best = cost.argmin(1)[cost.min(1) < _TELLING]
    return _near(np.bincount(best, minlength=cost.shape[1]), matcher)


def _near(count: NDArray[np.int64], matcher: Matcher) -> NDArray[np.bool_]:
    """(k,) bool: shifts near those that lenses have, by their number (k,)."""
    near = matcher.tolerance()
    margin = max(near, int(np.ceil(_MARGIN * matcher.gray.pitch / matcher.step)))
    votes = np.convolve(count, np.ones(2 * near + 1, int), "same")
    at = (count > 0) & (votes >= _SUPPORT)
    return np.convolve(at, np.ones(2 * margin + 1, int), "same") > 0
