"""Search of the signed shift of every lens: matching costs on a reduced flat, and semi-global matching.

Either all shifts are tried, or only those near depths that occur: in a sparse sample of lenses, or as found elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat, downsample
from ...flat.lens_graph import dilate_mask, join_opposite
from ...flat.microimages import OverlapMasks, Strips, extract_strips
from ...flat.texture import FIXED_PATTERN, LensStatistics, Texture, measure_statistics
from ...runtime.cache import cached
from ..presets import Preset
from .ambiguity import measure_ambiguity, overlap_weights
from .cost_volume import compute_pair_costs, half_weight_area, overlap_masks
from .local_match import match_locally
from .peaks import confidence, find_second_minimum, fit_parabola
from .settings import AMBIGUITY, SEARCH, SearchSettings
from .sgm import aggregate_costs, average_pair_costs

__all__ = ["MatchResult", "Matcher", "match_lenses"]

# Lattice directions of `Matcher.match_locally`: two show a shift of any detail, a third adds little.
_LOCAL_DIRECTIONS = 2


@dataclass(frozen=True)
class MatchResult:
    """Result of the search for every lens; patch sizes in px of the flat."""

    patch_size: NDArray[np.float32]  # (n,) best value
    confidence: NDArray[np.float32]  # (n,) probability that it is the right minimum
    # (n,) mean correlation with the neighbours there, 0..1, weighted down for a small overlap
    correlation: NDArray[np.float32]
    normalised_correlation: NDArray[np.float32]  # (n,) the same without that weight
    # (n,) probability of the best value among all that correlate as well, whatever their overlap
    uniqueness: NDArray[np.float32]
    # (n,) normalised correlation at the best value and at the highest other peak (0 where there is none), mean
    # with the neighbours on the same surface.
    primary_peak: NDArray[np.float32]
    secondary_peak: NDArray[np.float32]
    second: NDArray[np.float32]  # (n,) second-best value, NaN where no other comes near
    # (n,) as `correlation` and `normalised_correlation`, at the second-best value
    second_correlation: NDArray[np.float32]
    second_normalised: NDArray[np.float32]
    step: float  # between the values that were tried
    skipped_share: float  # share of the shifts of all matched lenses that were not tried

    def swap_second(self, lenses: NDArray[np.bool_], settings: SearchSettings = SEARCH) -> MatchResult:
        """The second-best value of some `lenses` (n,) as their best one."""
        limited = np.minimum(settings.swapped_confidence, self.confidence)
        return replace(
            self,
            patch_size=np.where(lenses, self.second, self.patch_size),
            second=np.where(lenses, self.patch_size, self.second),
            correlation=np.where(lenses, self.second_correlation, self.correlation),
            normalised_correlation=np.where(lenses, self.second_normalised, self.normalised_correlation),
            confidence=np.where(lenses, limited, self.confidence),
        )


class Matcher:
    """A flat reduced as the preset asks, and the shifts to try on it.

    `forward` and `backward` (n, d) are neighbour rows in `d` directions and in their opposites, -1 where there is none;
    `lenses` (n,) those that will be matched, all by default.
    """

    def __init__(
        self,
        texture: Texture,
        forward: NDArray[np.int32],
        backward: NDArray[np.int32],
        preset: Preset,
        lenses: NDArray[np.bool_] | None = None,
        settings: SearchSettings = SEARCH,
    ) -> None:
        self.settings = settings
        self.factor = max(1, round(texture.flat.pitch / preset.search_pitch))
        wanted = None if lenses is None else dilate_mask(lenses, join_opposite(forward, backward))
        self.gray: GrayFlat = downsample(texture.flat, self.factor)
        self.statistics: LensStatistics = texture.statistics
        if self.factor > 1:
            self.statistics = measure_statistics(self.gray, wanted=wanted)
        radius = self.gray.radius
        self._row_step = 1 if radius < settings.small_radius else preset.row_step
        self.step = preset.step if self.factor > 1 else max(preset.step, preset.full_step)
        side = int(np.ceil(settings.max_ratio * self.gray.pitch / self.step))
        self.shifts = (np.arange(-side, side + 1) * self.step).astype(np.float32)
        self.forward, self.backward = forward, backward
        self._noise = texture.noise / self.factor
        #: Steps that belong to one minimum.
        self.tolerance = max(1, round(1.5 / self.step))

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """(n, 2 d) neighbour rows in all directions, -1 where there is none."""
        return join_opposite(self.forward, self.backward)

    @cached_property
    def overlap_weight(self) -> NDArray[np.float32]:
        """(k,) float32: weight of a correlation at each shift for the overlap there."""
        return overlap_weights(self.gray, self.forward, self.shifts, half_weight_area(self.gray))

    def downscaled(self, texture: Texture) -> Texture:
        """The texture of the reduced flat."""
        return replace(texture, flat=self.gray, statistics=self.statistics, noise=self._noise)

    def _strips(self, active: NDArray[np.bool_]) -> Strips:
        """The microimages of the `active` lenses and of their neighbours."""
        wanted = dilate_mask(active, self.neighbours)
        return extract_strips(self.gray, self.statistics.mean, self._row_step, wanted)

    @cached_property
    def _masks(self) -> OverlapMasks:
        strips = extract_strips(self.gray, self.statistics.mean, self._row_step, np.zeros(len(self.gray.centres), bool))
        return overlap_masks(strips, self.gray, self.forward, self.shifts)

    def pair_costs(
        self,
        active: NDArray[np.bool_],
        which: NDArray[np.int64] | None = None,
        done: NDArray[np.bool_] | None = None,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """(n, d, k) float32 costs of the pairs of all `active` lenses, as `compute_pair_costs`."""
        return compute_pair_costs(
            self.gray, self.forward, self.statistics.mean, self.statistics.contrast, active, self.shifts, self._noise,
            FIXED_PATTERN, self._row_step, which, done, out, self._strips(active), self._masks,
        )  # fmt: skip

    def lens_costs(self, pair: NDArray[np.float32], wanted: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """(m, k) float32: mean over the pairs of each lens, or of each of the `wanted` (n,)."""
        return average_pair_costs(pair, self.forward, self.backward, wanted)

    def match_locally(
        self, active: NDArray[np.bool_], expected: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Cost, offset and error (n,) of the `active` lenses at `expected` (n,) [px of the reduced flat], as
        `local_match.match_locally`."""
        forward, backward = (_local_directions(rows) for rows in (self.forward, self.backward))
        strips = self._strips(active)
        return match_locally(self.gray, forward, backward, self.statistics, active, expected, self._noise, strips)

    def shifts_of(self, sizes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """(k,) bool: shifts near those of patch sizes (m,) [px of the flat]."""
        best = np.rint(sizes / (self.factor * self.step)).astype(int) + len(self.shifts) // 2
        return self.shifts_near(np.clip(best, 0, len(self.shifts) - 1))

    def shifts_near(self, best: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) bool: shifts near some (m,)."""
        margin = max(self.tolerance, int(np.ceil(self.settings.range_margin * self.gray.pitch / self.step)))
        found = np.bincount(best, minlength=len(self.shifts)) > 0
        return np.convolve(found, np.ones(2 * margin + 1, int), "same") > 0

    def is_periodic(self, cost: NDArray[np.float32]) -> bool:
        """Whether many lenses, of these costs (m, k), match as well at another shift."""
        best, alone = cost.argmin(1), np.empty((len(cost), 0), np.int32)
        unique, *_ = measure_ambiguity(cost, self.overlap_weight, alone, best, np.ones(len(cost), bool), self.tolerance)
        return bool(len(cost) and (unique < 0.5).mean() > self.settings.periodic_share)


def _local_directions(rows: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, d) neighbour rows in the first directions only; cached, as `neighbour_rows`."""
    return cached(rows, "local directions", lambda: np.ascontiguousarray(rows[:, :_LOCAL_DIRECTIONS]))


def match_lenses(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    sample: NDArray[np.bool_] | None,
    known: NDArray[np.float32] | None = None,
    sizes: NDArray[np.float32] | None = None,
) -> MatchResult:
    """Find the signed shift of every lens, by semi-global matching on the lattice.

    Matches the `active` lenses (n,), of which those that are `clear` have a sure texture. A `sample` (n,) of them is
    matched at all shifts first, the others then only near the depths of these, unless they do not match there; without
    it all shifts are tried. `sizes` (m,) [px of the flat] are depths that occur, as found elsewhere, instead of those
    of a sample. `known` (n,) [px of the flat] are patch sizes that only take part in the aggregation; NaN elsewhere.
    """
    settings, step, factor = matcher.settings, matcher.step, matcher.factor
    pair, skipped = _match_pairs(matcher, active, clear, sample, sizes)
    cost = matcher.lens_costs(pair)
    wanted = None
    if known is not None:
        settled = np.isfinite(known)
        wanted = ~settled
        away = np.abs(matcher.shifts - known[settled, None] / factor)
        cost[settled] = np.minimum(away / np.float32(matcher.tolerance * step), 1)
    prices = settings.slope_price * step, settings.jump_price
    total = aggregate_costs(cost, matcher.forward, matcher.backward, *prices, wanted)
    best = total.argmin(1)
    own = cost[np.arange(len(best)), best]
    other, other_cost = find_second_minimum(cost, best, max(2, round(2 / step)))
    has_second = other_cost < own + settings.second_cost
    second = (matcher.shifts[other] + fit_parabola(cost, other) * step) * factor
    weight = np.maximum(matcher.overlap_weight, AMBIGUITY.least_weight)
    unique, primary, secondary = measure_ambiguity(
        cost, matcher.overlap_weight, matcher.neighbours, best, active, matcher.tolerance
    )
    return MatchResult(
        patch_size=((matcher.shifts[best] + fit_parabola(total, best) * step) * factor).astype(np.float32),
        confidence=confidence(total, best, 2 * matcher.forward.shape[1], matcher.tolerance),
        correlation=1 - own,
        normalised_correlation=((1 - own) / weight[best]).astype(np.float32),
        uniqueness=unique,
        primary_peak=primary,
        secondary_peak=secondary,
        second=np.where(has_second, second, np.nan).astype(np.float32),
        second_correlation=1 - other_cost,
        second_normalised=((1 - other_cost) / weight[other]).astype(np.float32),
        step=step * factor,
        skipped_share=skipped,
    )


def _match_pairs(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    sample: NDArray[np.bool_] | None,
    sizes: NDArray[np.float32] | None,
) -> tuple[NDArray[np.float32], float]:
    """Pair costs of all active lenses at the shifts that may matter, and the share of them that was not tried."""
    if sample is None and sizes is None:
        return matcher.pair_costs(active), 0.0
    settings = matcher.settings
    if sizes is not None:
        sample = np.zeros_like(active)
    assert sample is not None
    pair = matcher.pair_costs(sample)
    if sizes is not None:
        tried = matcher.shifts_of(sizes)
    else:
        cost = matcher.lens_costs(pair, sample)
        if matcher.is_periodic(cost):
            return matcher.pair_costs(active, done=sample, out=pair), 0.0
        tried = matcher.shifts_near(cost.argmin(1)[cost.min(1) < settings.misfit_cost])
    if tried.all():
        return matcher.pair_costs(active, done=sample, out=pair), 0.0
    matcher.pair_costs(active, which=np.flatnonzero(tried), done=sample, out=pair)
    cost = np.where(tried, matcher.lens_costs(pair), np.float32(np.inf))
    best, lowest = cost.argmin(1), cost.min(1)
    # A minimum at the end of a range may continue beyond it.
    end = tried & ~(np.roll(tried, 1) & np.roll(tried, -1))
    end[[0, -1]] = False
    doubtful = clear & active & ~sample & ((lowest > settings.misfit_cost) | end[best])
    matcher.pair_costs(doubtful, which=np.flatnonzero(~tried), done=sample, out=pair)
    skipped = (active & ~sample & ~doubtful).sum() * (~tried).sum()
    return pair, float(skipped / max(1, active.sum() * len(tried)))
