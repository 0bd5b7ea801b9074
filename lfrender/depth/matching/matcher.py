"""Search of the signed shift of every lens: matching costs on a reduced flat, and semi-global
matching.

Either all shifts are tried, or only those near depths that occur: in a sparse sample of lenses, or
as found elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import dilate_mask
from ...flat.microimages import OverlapMasks, Strips, allocate_strips, extract_strips
from ...flat.neighbours import Neighbours
from ...flat.texture import Texture, measure_statistics
from ..presets import Preset
from ..same_surface import TOLERANCE
from .ambiguity import LEAST_WEIGHT, measure_ambiguity
from .cost_volume import (
    Shifts,
    compute_pair_costs,
    half_weight_area,
    overlap_area,
    overlap_masks,
    pair_terms,
    pairs_of,
    shifts_from_zero,
)
from .sgm import aggregate_costs, average_pair_costs

__all__ = ["MatchResult", "Matcher", "fit_parabola", "match_lenses", "sample_lenses"]

# Cost above which a lens may match better at a shift that was not tried.
_MISFIT = 0.4


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
    second: NDArray[np.float32]  # (n,) second-best value, NaN where no other comes near
    skipped_share: float  # share of the shifts of all matched lenses that were not tried


class Matcher:
    """A flat reduced as the preset asks, and the shifts to try on it, for some of the `lenses`
    (n,).
    """

    def __init__(
        self,
        texture: Texture,
        neighbours: Neighbours,
        preset: Preset,
        lenses: NDArray[np.bool_] | None = None,
    ) -> None:
        self.neighbours = neighbours
        self.factor = max(1, round(texture.flat.pitch / preset.search_pitch))
        self.gray = texture.flat.downsampled(self.factor)
        self.statistics = texture.statistics
        if self.factor > 1:
            wanted = None if lenses is None else dilate_mask(lenses, neighbours.all)
            self.statistics = measure_statistics(self.gray, wanted=wanted)
        # Small microimages are matched in every row.
        self._row_step = 1 if self.gray.radius < 7 else preset.row_step
        self.step = preset.step if self.factor > 1 else max(preset.step, preset.full_step)
        # A little beyond the largest patch size that can be resolved, so that its minimum has two
        # flanks.
        side = int(np.ceil(0.82 * self.gray.pitch / self.step))
        self.shifts = (np.arange(-side, side + 1) * self.step).astype(np.float32)
        self._noise = texture.noise / self.factor
        #: Steps that belong to one minimum.
        self.tolerance = max(1, round(1.5 / self.step))
        #: Price of semi-global matching for a step between neighbours; at twice the price depth
        #: edges suffer.
        self.slope_price = 0.07 * self.step

    @cached_property
    def overlap_weight(self) -> NDArray[np.float32]:
        """(k,) float32: weight of a correlation at each shift for the overlap there, mean over the
        directions.
        """
        area = overlap_area(self.gray, self.neighbours.steps, self.shifts)
        return np.asarray((area / (area + half_weight_area(self.gray))).mean(0), np.float32)

    @cached_property
    def _strips(self) -> Strips:
        return allocate_strips(self.gray, self.statistics.mean, self._row_step)

    @cached_property
    def _masks(self) -> OverlapMasks:
        return overlap_masks(self._strips, self.gray, self.neighbours.steps, self.shifts)

    def extract(self, active: NDArray[np.bool_]) -> Strips:
        """The microimages, those of the `active` lenses and of their neighbours cut out."""
        extract_strips(self._strips, self.gray, dilate_mask(active, self.neighbours.all))
        return self._strips

    def pair_costs(
        self,
        active: NDArray[np.bool_],
        which: NDArray[np.int64] | None = None,
        done: NDArray[np.bool_] | None = None,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """(n, d, k) float32 costs of the pairs of all `active` lenses, as `compute_pair_costs`."""
        shifts = shifts_from_zero(self.shifts, self.gray.pitch)
        if which is not None:
            shifts = shifts._replace(which=which)
        terms = pair_terms(self.gray, self.statistics, self._noise)
        rows = pairs_of(self.neighbours.forward, active, done)
        return compute_pair_costs(terms, self.extract(active), self._masks, rows, shifts, out)

    def lens_costs(
        self, pair: NDArray[np.float32], wanted: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float32]:
        """(m, k) float32: mean over the pairs of each lens, or of each of the `wanted` (n,)."""
        return average_pair_costs(pair, self.neighbours, wanted)

    def marked_costs(
        self,
        wanted: NDArray[np.bool_],
        marked: NDArray[np.float32],
        shifts: NDArray[np.float32],
        half_weight: float,
    ) -> NDArray[np.float32]:
        """(m, k) float32 costs of the `marked` pixels of each of the `wanted` lenses (n,) at these
        `shifts` (k,) [px]: mean over the better half of the neighbours that show some of them.

        The cost is 1 where a single neighbour does; an overlap of `half_weight` [px^2] has half
        weight. `marked` is as `chosen` of `compute_pair_costs`.
        """
        terms = pair_terms(self.gray, self.statistics, self._noise)._replace(
            doubts=np.zeros(len(wanted), np.float32),
            shading=np.float32(0),
            half_weight=np.float32(half_weight),
        )
        strips = self.extract(wanted)
        steps = self.neighbours.steps
        masks = overlap_masks(strips, self.gray, np.concatenate([steps, -steps]), shifts)
        rows = np.where(wanted[:, None], self.neighbours.all, np.int32(-1))
        out = np.full((*rows.shape, len(shifts)), np.inf, np.float32)
        tried = shifts_from_zero(shifts, self.gray.pitch)
        compute_pair_costs(terms, strips, masks, rows, tried, out, marked)
        costs = out[wanted].swapaxes(0, 1).copy()
        _sort_first_axis(costs)
        shown = np.isfinite(costs).sum(0)
        better = np.maximum((shown + 1) // 2, 1)
        total = np.take_along_axis(costs.cumsum(0), better[None] - 1, 0)[0]
        return np.where(shown >= 2, total / better.astype(np.float32), np.float32(1))

    def match_locally(
        self, active: NDArray[np.bool_], expected: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Match the `active` lenses at `expected` patch sizes (n,) [px of the flat], and half a
        pixel to both sides.

        Returns the cost (n,) there, the offset (n,) [px of the search] from there to the minimum of
        a parabola, 0.75 at most, and its standard error (n,), infinite where it has none.
        """
        at = (expected / np.float32(self.factor)).astype(np.float32)
        strips = self.extract(active)
        tried = np.arange(at.min() - 1, at.max() + 2, dtype=np.float32)
        masks = overlap_masks(strips, self.gray, self.neighbours.steps[:2], tried)
        # Doubts are those at the expected patch sizes.
        shifts = Shifts(np.array([-0.5, 0, 0.5], np.float32), np.ones(3, np.float32), np.arange(3))
        terms = pair_terms(self.gray, self.statistics, self._noise, at)
        rows = pairs_of(self.neighbours.two_directions, active)
        costs = compute_pair_costs(terms, strips, masks, rows, shifts)
        left, cost, right = average_pair_costs(costs, self.neighbours).T
        bend = np.maximum(left - (cost + cost) + right, np.float32(1e-12))
        # The cost bends by the mean square of the slopes over the variance of a lens, times the
        # weight of the overlap; a pair errs by the noise of both its microimages over the root of
        # the sum of these squares.
        area = overlap_area(self.gray, self.neighbours.steps[:2], at).mean(0) + half_weight_area(
            self.gray
        )
        energy = area / self._row_step * self.statistics.contrast**2 * bend / 0.5**2
        error = (np.sqrt(2) * self._noise / np.sqrt(np.maximum(energy, 1e-12))).astype(np.float32)
        return np.ascontiguousarray(cost), np.clip((left - right) / (4 * bend), -0.75, 0.75), error

    def shifts_near(self, best: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(k,) bool: shifts near some (m,); beyond sampled depths there are others between two
        samples.
        """
        margin = max(self.tolerance, int(np.ceil(2 * TOLERANCE * self.gray.pitch / self.step)))
        found = np.bincount(best, minlength=len(self.shifts)) > 0
        return np.convolve(found, np.ones(2 * margin + 1, int), "same") > 0

    def is_periodic(self, cost: NDArray[np.float32]) -> bool:
        """Whether more than a fifth of the lenses, of these costs (m, k), match as well at another
        shift.
        """
        best = cost.argmin(1)
        alone = np.empty((len(cost), 0), np.int32)
        unique = measure_ambiguity(
            cost, self.overlap_weight, alone, best, np.ones(len(cost), bool), self.tolerance
        )
        return bool(len(cost) and (unique < 0.5).mean() > 0.2)


def _sort_first_axis(values: NDArray[np.float32]) -> None:
    """Sort a few rows (d, ...) at each place, by odd-even transposition: NumPy takes ten times as
    long for so short an axis.
    """
    count = len(values)
    for turn in range(count):
        for k in range(turn % 2, count - 1, 2):
            low = np.minimum(values[k], values[k + 1])
            np.maximum(values[k], values[k + 1], out=values[k + 1])
            values[k] = low


def fit_parabola(total: NDArray[np.float32], best: NDArray[np.int64]) -> NDArray[np.float32]:
    """(n,) float32: offset of the minimum from `best`, in steps, of the parabola through three
    costs.
    """
    lens = np.arange(len(best))
    last = total.shape[1] - 1
    left, middle, right = (total[lens, np.clip(best + k, 0, last)] for k in (-1, 0, 1))
    bend = left - (middle + middle) + right
    fitted = (best > 0) & (best < last) & (bend > 1e-9)
    return np.where(
        fitted, np.clip((left - right) / (2 * np.where(fitted, bend, 1)), -0.5, 0.5), 0
    ).astype(np.float32)


def _confidence(
    total: NDArray[np.float32], best: NDArray[np.int64], paths: int, tolerance: int
) -> NDArray[np.float32]:
    """(n,) posterior probability that the true shift lies within `tolerance` steps of the `best`
    (n,).

    A difference of 0.05 per path in the cost `total` (n, k) makes one shift e times as likely as
    another.
    """
    mass = np.exp((total.min(1, keepdims=True) - total) / np.float32(0.05 * paths))
    inside = np.abs(np.arange(total.shape[1]) - best[:, None]) <= tolerance
    return np.asarray((mass * inside).sum(1) / mass.sum(1))


def _find_second_minimum(
    cost: NDArray[np.float32], best: NDArray[np.int64], distance: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The lowest other local minimum of the `cost` (n, k) of each lens, `distance` steps away, and
    the cost there, or inf.

    A lens across a depth edge matches at both depths; aggregation would hide the second.
    """
    lowest = np.full(cost.shape, np.float32(np.inf))
    inner = cost[:, 1:-1]
    other = np.abs(np.arange(1, cost.shape[1] - 1) - best[:, None]) >= distance
    here = other & (inner <= cost[:, :-2]) & (inner < cost[:, 2:])
    lowest[:, 1:-1][here] = inner[here]
    index = lowest.argmin(1)
    return index, lowest[np.arange(len(cost)), index]


def match_lenses(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    known: NDArray[np.float32],
    sample: NDArray[np.bool_] | None = None,
    sizes: NDArray[np.float32] | None = None,
) -> MatchResult:
    """Find the signed shift of every `active` lens (n,), by semi-global matching on the lattice.

    `known` (n,) [px] patch sizes only take part in the aggregation; NaN elsewhere. A `sample` (n,)
    is matched at all shifts first, the others then only near the depths of these, or `sizes` (m,)
    [px] found elsewhere, unless `clear` ones do not match there; without either all shifts are
    tried.
    """
    step = matcher.step
    factor = matcher.factor
    neighbours = matcher.neighbours
    pair, skipped = _match_pairs(matcher, active, clear, sample, sizes)
    cost = matcher.lens_costs(pair)
    settled = np.isfinite(known)
    away = np.abs(matcher.shifts - known[settled, None] / factor)
    cost[settled] = np.minimum(away / np.float32(matcher.tolerance * step), 1)
    # A depth edge costs 0.8; set, as the price of slopes, on ray-traced and real flats.
    total = aggregate_costs(cost, neighbours, matcher.slope_price, 0.8, ~settled)
    best = total.argmin(1)
    own = cost[np.arange(len(best)), best]
    other, other_cost = _find_second_minimum(cost, best, max(2, round(2 / step)))
    second = (matcher.shifts[other] + fit_parabola(cost, other) * step) * factor
    weight = np.maximum(matcher.overlap_weight, LEAST_WEIGHT)
    unique = measure_ambiguity(
        cost, matcher.overlap_weight, neighbours.all, best, active, matcher.tolerance
    )
    return MatchResult(
        patch_size=((matcher.shifts[best] + fit_parabola(total, best) * step) * factor).astype(
            np.float32
        ),
        confidence=_confidence(total, best, neighbours.all.shape[1], matcher.tolerance),
        correlation=1 - own,
        normalised_correlation=((1 - own) / weight[best]).astype(np.float32),
        uniqueness=unique,
        second=np.where(other_cost < own + 0.3, second, np.nan).astype(np.float32),
        skipped_share=skipped,
    )


def _match_pairs(
    matcher: Matcher,
    active: NDArray[np.bool_],
    clear: NDArray[np.bool_],
    sample: NDArray[np.bool_] | None,
    sizes: NDArray[np.float32] | None,
) -> tuple[NDArray[np.float32], float]:
    """Pair costs of all active lenses at the shifts that may matter, and the share of them that was
    not tried.
    """
    if sizes is not None:
        sample = np.zeros_like(active)
    if sample is None:
        return matcher.pair_costs(active), 0.0
    pair = matcher.pair_costs(sample)
    if sizes is not None:
        best = (
            np.rint(sizes / (matcher.factor * matcher.step)).astype(int) + len(matcher.shifts) // 2
        )
        tried = matcher.shifts_near(np.clip(best, 0, len(matcher.shifts) - 1))
    else:
        cost = matcher.lens_costs(pair, sample)
        tried = matcher.shifts_near(cost.argmin(1)[cost.min(1) < _MISFIT])
        if matcher.is_periodic(cost):
            tried[:] = True
    if tried.all():
        return matcher.pair_costs(active, done=sample, out=pair), 0.0
    matcher.pair_costs(active, which=np.flatnonzero(tried), done=sample, out=pair)
    cost = np.where(tried, matcher.lens_costs(pair), np.float32(np.inf))
    best = cost.argmin(1)
    lowest = cost.min(1)
    # A minimum at the end of a range may continue beyond it.
    end = tried & ~(np.roll(tried, 1) & np.roll(tried, -1))
    end[[0, -1]] = False
    doubtful = clear & active & ~sample & ((lowest > _MISFIT) | end[best])
    matcher.pair_costs(doubtful, which=np.flatnonzero(~tried), done=sample, out=pair)
    skipped = (active & ~sample & ~doubtful).sum() * (~tried).sum()
    return pair, float(skipped / max(1, active.sum() * len(tried)))


def sample_lenses(
    indices: NDArray[np.int64], candidates: NDArray[np.bool_], count: int
) -> NDArray[np.bool_]:
    """(n,) bool: about `count` of the candidates, evenly spread and of all lens types; all where
    they are few.
    """
    spacing = candidates.sum() / count
    if spacing < 2:
        return candidates
    # No multiple of three, which would sample only one lens type of multi-focus arrays.
    i = int(np.sqrt(spacing))
    i -= i % 3 == 0
    j = int(spacing / i)
    return candidates & (indices % (i, j - (j % 3 == 0)) == 0).all(1)
