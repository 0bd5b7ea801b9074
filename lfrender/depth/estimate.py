"""Patch size of lenses: searched over all shifts, refined on the pixels of every pair, classified and smoothed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..data.depth_map import DepthMap
from ..flat.lens_graph import join_opposite
from ..flat.texture import Texture
from .matching.matcher import Matcher, MatchResult, match_lenses
from .presets import Preset
from .refinement.lens_plane import LensFits, fit_lens_planes
from .refinement.pair_fit import fit_pairs
from .refinement.settings import REFINEMENT, RefinementSettings
from .refinement.smoothing import smooth_fits, smooth_fits_far
from .settings import ESTIMATE, EstimateSettings
from .validity.classify import (
    classify_lenses,
    looks_like_shading,
    match_proves_texture,
    match_suggests_texture,
    occurs_among,
    shift_exceeds_shading,
    shift_may_be_zero,
)
from .validity.periodicity import find_periodic_texture, sees_little_of_scene
from .validity.settings import CLASSIFY
from .validity.uncertainty import correlates_poorly, inflate_errors, signal_share

__all__ = ["LensEstimates", "LensSet", "estimate_lenses"]


@dataclass(frozen=True)
class LensSet:
    """The lenses of a flat, and which of them to estimate."""

    texture: Texture
    # (n, d) int32: Neighbour rows in `d` directions and in their opposites, -1 where there is none
    forward: NDArray[np.int32]
    backward: NDArray[np.int32]
    indices: NDArray[np.int64]  # (n, 2) on the lattice
    updated: NDArray[np.bool_]  # (n,) lenses that do not keep a depth from before
    active: NDArray[np.bool_]  # (n,) those of them to match
    sample: NDArray[np.bool_] | None  # (n,) lenses that show which depths occur, see `match_lenses`

    @property
    def pitch(self) -> float:
        return self.texture.flat.pitch

    @property
    def centres(self) -> NDArray[np.float64]:
        """(n, 2) float64 [px]."""
        return self.texture.flat.centres.astype(np.float64)

    @property
    def neighbours(self) -> NDArray[np.int32]:
        """(n, 2 d) int32 neighbour rows in all directions."""
        return join_opposite(self.forward, self.backward)

    @property
    def usual_contrast(self) -> NDArray[np.float32]:
        """(n,) float32 difference of brightness beyond which two pixels hardly show the same point."""
        return np.maximum(3 * self.texture.noise, 0.5 * self.texture.statistics.contrast).astype(np.float32)


@dataclass(frozen=True)
class LensEstimates:
    """Estimates of lenses."""

    patch_size: NDArray  # (n,) [px] this and the next two also of unresolved lenses
    standard_error: NDArray
    confidence: NDArray
    reason: NDArray[np.int8]  # (n,) as `DepthMap`
    # (n,) [px] patch size to fill unresolved lenses with, unless smoothing toward their neighbours changes it
    guess: NDArray
    # (n,) [px] second-best patch size of lenses with texture; NaN where there is none
    second: NDArray[np.float32]
    match: MatchResult
    # Measurement of each lens without smoothing, or what it keeps; with an infinite error where it is unresolved.
    own_fits: LensFits

    @property
    def resolved(self) -> NDArray[np.bool_]:
        return self.reason == 0

    @property
    def filled_patch_size(self) -> NDArray[np.float32]:
        """(n,) float32 [px]: patch sizes of resolved lenses, and guesses of the others."""
        return np.where(self.resolved, self.patch_size, self.guess).astype(np.float32)

    def smooth(self, lenses: LensSet) -> LensEstimates:
        """Smooth over the lenses on the same surface; those that keep their depth stay."""
        wanted = self.resolved & lenses.updated
        flat, neighbours = lenses.texture.flat, lenses.neighbours
        near = smooth_fits(flat, neighbours, self.own_fits, wanted)
        fits = smooth_fits_far(flat, neighbours, *near, wanted)
        known = wanted & np.isfinite(fits.standard_error)
        return replace(
            self,
            patch_size=np.where(known, fits.patch_size, self.patch_size),
            standard_error=np.where(known, fits.standard_error, self.standard_error),
        )

    def keep(self, kept: NDArray[np.bool_], before: DepthMap) -> LensEstimates:
        """With what the lenses that are `kept` (n,) had before."""
        error = np.where(before.reason == 0, before.standard_error, np.inf)
        own = replace(
            self.own_fits,
            patch_size=np.where(kept, before.filled_patch_size, self.own_fits.patch_size),
            standard_error=np.where(kept, error, self.own_fits.standard_error),
        )
        return replace(
            self,
            patch_size=np.where(kept, before.filled_patch_size, self.patch_size),
            standard_error=np.where(kept, before.standard_error, self.standard_error),
            confidence=np.where(kept, before.confidence, self.confidence),
            reason=np.where(kept, before.reason, self.reason),
            guess=np.where(kept, before.filled_patch_size, self.guess),
            own_fits=own,
        )

    def limit_guesses(self, pitch: float, settings: EstimateSettings = ESTIMATE) -> LensEstimates:
        """Replace guesses beyond the resolvable range, of lenses without texture, by the median of the resolved ones.

        Costs that are all alike have their minimum at an end of the range, where only rims of microimages overlap.
        """
        beyond = (self.reason == 1) & (np.abs(self.guess) > CLASSIFY.resolvable * pitch)
        known = self.patch_size[self.resolved]
        default = np.median(known) if known.size else settings.default_ratio * pitch
        return replace(self, guess=np.where(beyond, default, self.guess))


def estimate_lenses(
    lenses: LensSet,
    preset: Preset,
    before: DepthMap | None = None,
    sizes: NDArray[np.float32] | None = None,
    settings: EstimateSettings = ESTIMATE,
) -> LensEstimates:
    """Search the patch size of lenses, refine it on the pixels of every pair, and classify the result.

    Lenses that are not `updated` keep what they had `before`. `sizes` (m,) [px] are patch sizes that occur, as found
    elsewhere, see `match_lenses`.
    """
    texture, updated, pitch = lenses.texture, lenses.updated, lenses.pitch
    known = None if before is None else np.where(updated, np.nan, before.filled_patch_size).astype(np.float32)
    matcher = Matcher(texture, lenses.forward, lenses.backward, preset)
    match = match_lenses(matcher, lenses.active, texture.clear, lenses.sample, known, sizes)
    like_shading = looks_like_shading(texture.clear & updated, match, texture.statistics.contrast, pitch)
    doubtful = texture.faint | like_shading
    textured = updated & ((texture.clear & ~doubtful) | (doubtful & match_proves_texture(match, pitch)))
    perhaps = updated & doubtful & ~textured & match_suggests_texture(match)
    wanted = textured | perhaps
    reliable = (wanted | ~updated) & (np.minimum(match.confidence, match.uniqueness) >= CLASSIFY.sure)
    occurring = match.patch_size[reliable] if sizes is None else sizes
    own, match = _refine(lenses, preset, match, wanted, occurring)
    measured = np.isfinite(own.patch_size)
    refined = np.where(measured, own.patch_size, match.patch_size)
    error = np.where(measured, own.standard_error, np.inf)
    textured |= perhaps & shift_exceeds_shading(refined, error, lenses.neighbours, pitch)
    textured &= ~(like_shading & shift_may_be_zero(refined, error))
    estimates = _classify(lenses, match, textured, own, refined, error, before)
    if before is not None:
        estimates = estimates.keep(~updated, before)
    return estimates.limit_guesses(pitch, settings)


def _refine(
    lenses: LensSet,
    preset: Preset,
    match: MatchResult,
    wanted: NDArray[np.bool_],
    occurring: NDArray[np.float32],
    settings: RefinementSettings = REFINEMENT,
) -> tuple[LensFits, MatchResult]:
    """Refine the lenses `wanted` (n,) on their pixels.

    Registration finds the optimum next to its start, so lenses are fitted from up to three; the fit with the smallest
    error is kept. Where neighbours share few pixels the search falls short: they start from a larger patch size, too.
    The search takes the mean over all pairs, also those with one lens occluded: a second-best match that is one of
    those `occurring` (m,) [px] may be right.
    """
    texture = lenses.texture

    def fit(start: NDArray[np.float32]) -> LensFits:
        pairs = fit_pairs(
            texture.flat, lenses.forward, start, lenses.usual_contrast, texture.noise, preset.iterations,
            preset.last_step,
        )  # fmt: skip
        return fit_lens_planes(texture.flat, lenses.forward, lenses.backward, pairs, start)

    first = np.where(wanted, match.patch_size, np.nan).astype(np.float32)
    far = np.abs(first) > settings.far_patch_size * lenses.pitch
    larger = np.where(far, first + np.sign(first) * np.float32(settings.bias * lenses.pitch), np.float32(np.nan))
    as_good = match.second_normalised >= ESTIMATE.second_share * match.normalised_correlation
    as_good &= wanted & occurs_among(match.second, occurring, 0.5 * CLASSIFY.same_surface * lenses.pitch)
    second = np.where(as_good, match.second, np.float32(np.nan))
    own = fit(first)
    for start in (larger, second):
        if np.isfinite(start).any():
            own = own.better_of(fit(start))
    swapped = np.abs(own.patch_size - second) < np.abs(own.patch_size - match.patch_size)
    return own, match.swap_second(swapped)


def _classify(
    lenses: LensSet,
    match: MatchResult,
    textured: NDArray[np.bool_],
    own: LensFits,
    refined: NDArray,
    error: NDArray,
    before: DepthMap | None,
) -> LensEstimates:
    """Decide which lenses are resolved, with errors and confidence, from their match and refined patch sizes (n,)."""
    texture, pitch, centres = lenses.texture, lenses.pitch, lenses.texture.flat.centres
    signal = signal_share(texture)
    explained = match.normalised_correlation / signal
    reason, error, sure = classify_lenses(textured, match, refined, error, signal, centres, lenses.neighbours, pitch)
    depths, shown, known = refined, reason == 0, None
    if before is not None:
        # Kept lenses show the same scene.
        kept = ~lenses.updated
        known = _known_periodicity(kept, before, shown)
        depths = np.where(kept, before.filled_patch_size, refined)
        shown = shown | (kept & (before.reason == 0))
    periodic, perhaps = known or find_periodic_texture(texture.flat, lenses.indices, depths, shown)
    little = sees_little_of_scene(centres, depths, shown, pitch)
    perhaps = perhaps or correlates_poorly(explained, signal, reason == 0, little)
    reason[periodic] = 2
    sure = CLASSIFY.sure * sure if perhaps else sure
    own_error = np.where(reason == 0, inflate_errors(own.standard_error, explained), np.inf)
    second = np.where(textured, match.second, np.nan).astype(np.float32)
    own = replace(own, standard_error=own_error)
    return LensEstimates(refined, error, sure, reason, match.patch_size, second, match, own)


def _known_periodicity(
    kept: NDArray[np.bool_], before: DepthMap, resolved: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], bool] | None:
    """As `find_periodic_texture` of lenses that are `resolved` (n,) now, where that is known from `before`.

    It is if most of them have `kept` their depth, and none of these was periodic.
    """
    known = kept & (before.reason == 0)
    if known.sum() <= (resolved & ~kept).sum() or (before.reason[kept] == 2).any():
        return None
    # Where the scene may be periodic, the confidence of all lenses has been limited to this.
    return np.zeros(len(resolved), bool), bool(before.confidence[known].max() <= CLASSIFY.sure)
