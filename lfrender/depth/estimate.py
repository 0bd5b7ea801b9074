"""Patch size of lenses: searched over all shifts, refined on the pixels of every pair, classified
and smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..flat.texture import Texture
from .matching.matcher import Matcher, MatchResult, match_lenses
from .presets import Preset
from .refinement.lens_plane import LensFits, fit_lenses
from .refinement.smoothing import smooth_fits
from .region import Part
from .validity.classify import (
    RESOLVABLE,
    SURE,
    classify_lenses,
    correlates_poorly,
    inflate_errors,
    looks_like_shading,
    match_proves_texture,
    match_suggests_texture,
    shift_exceeds_shading,
    signal_share,
)
from .validity.periodicity import find_periodic_texture

__all__ = ["LensEstimates", "LensSet", "estimate_lenses"]


@dataclass(frozen=True)
class LensSet:
    """The lenses of a part, and which of them to match."""

    part: Part
    texture: Texture
    active: NDArray[np.bool_]  # (n,) lenses to match
    sample: NDArray[np.bool_] | None  # (n,) lenses that show which depths occur, see `match_lenses`
    sizes: NDArray[np.float32] | None  # (m,) [px] depths that occur, if known from elsewhere

    @property
    def pitch(self) -> float:
        return self.texture.flat.pitch


@dataclass(frozen=True)
class LensEstimates:
    """Estimates of lenses."""

    patch_size: NDArray  # (n,) [px] this and the next two also of unresolved lenses
    standard_error: NDArray
    confidence: NDArray
    reason: NDArray[np.int8]  # (n,) as `DepthMap`
    guess: NDArray  # (n,) [px] patch size to fill unresolved lenses with
    # (n,) [px] second-best patch size of lenses with texture; NaN where there is none
    second: NDArray[np.float32]
    match: MatchResult
    # Measurement of each lens without smoothing, or what it keeps; with an infinite error where it
    # is unresolved.
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
        wanted = self.resolved & lenses.part.updated
        fits = smooth_fits(lenses.texture.flat, lenses.part.neighbours, self.own_fits, wanted)
        known = wanted & np.isfinite(fits.standard_error)
        return replace(
            self,
            patch_size=np.where(known, fits.patch_size, self.patch_size),
            standard_error=np.where(known, fits.standard_error, self.standard_error),
        )

    def keep(self, part: Part) -> LensEstimates:
        """With what the lenses of the part that are not estimated had before."""
        before = part.before
        if before is None:
            return self

        def where(new: NDArray, old: NDArray) -> NDArray:
            return np.where(part.updated, new, old)

        size = before.filled_patch_size
        error = np.where(before.reason == 0, before.standard_error, np.inf)
        own = self.own_fits
        return replace(
            self,
            patch_size=where(self.patch_size, size),
            standard_error=where(self.standard_error, before.standard_error),
            confidence=where(self.confidence, before.confidence),
            reason=where(self.reason, before.reason),
            guess=where(self.guess, size),
            own_fits=replace(
                own,
                patch_size=where(own.patch_size, size),
                standard_error=where(own.standard_error, error),
            ),
        )


def estimate_lenses(lenses: LensSet, preset: Preset) -> LensEstimates:
    """Search the patch size of lenses, refine it on the pixels of every pair, and classify the
    result.
    """
    texture = lenses.texture
    updated = lenses.part.updated
    pitch = lenses.pitch
    matcher = Matcher(texture, lenses.part.neighbours, preset)
    known = lenses.part.kept_sizes
    match = match_lenses(matcher, lenses.active, texture.clear, known, lenses.sample, lenses.sizes)
    like_shading = looks_like_shading(
        texture.clear & updated, match, texture.statistics.contrast, pitch
    )
    doubtful = texture.faint | like_shading
    textured = updated & (
        (texture.clear & ~doubtful) | (doubtful & match_proves_texture(match, pitch))
    )
    perhaps = updated & doubtful & ~textured & match_suggests_texture(match)
    own = _refine(
        lenses, preset, np.where(textured | perhaps, match.patch_size, np.nan).astype(np.float32)
    )
    measured = np.isfinite(own.patch_size)
    refined = np.where(measured, own.patch_size, match.patch_size)
    error = np.where(measured, own.standard_error, np.inf)
    textured |= perhaps & shift_exceeds_shading(refined, error, lenses.part.neighbours.all, pitch)
    textured &= ~like_shading | (np.abs(refined) >= 8 * error)
    return _classify(lenses, match, textured, own, refined, error).keep(lenses.part)


def _refine(lenses: LensSet, preset: Preset, first: NDArray[np.float32]) -> LensFits:
    """Fits of lenses to their pixels from the patch sizes `first` (n,) [px]; NaN leaves a lens out.

    Where neighbours share few pixels the fit falls short: it starts from a larger patch size too,
    the better one counts.
    """
    texture = lenses.texture
    pitch = lenses.pitch
    contrast = texture.statistics.contrast

    def fit(start: NDArray[np.float32]) -> LensFits:
        return fit_lenses(
            texture.flat, lenses.part.neighbours, start, contrast, texture.noise, preset
        )

    far = np.abs(first) > 0.4 * pitch
    larger = np.where(far, first + np.sign(first) * np.float32(0.06 * pitch), np.float32(np.nan))
    return fit(first).better_of(fit(larger)) if far.any() else fit(first)


def _classify(
    lenses: LensSet,
    match: MatchResult,
    textured: NDArray[np.bool_],
    own: LensFits,
    refined: NDArray,
    error: NDArray,
) -> LensEstimates:
    """Decide which lenses are resolved, with errors and confidence, from their match and refined
    patch sizes (n,).
    """
    texture = lenses.texture
    pitch = lenses.pitch
    neighbours = lenses.part.neighbours
    signal = signal_share(texture)
    explained = match.normalised_correlation / signal
    reason, error, sure = classify_lenses(
        textured, match, refined, error, signal, neighbours.all, pitch
    )
    # Lenses that keep their depth show the same scene.
    part = lenses.part
    depths = np.where(part.updated, refined, part.kept_sizes)
    shown = (reason == 0) | part.kept_resolved
    periodic, perhaps = find_periodic_texture(texture.flat, neighbours.indices, depths, shown)
    perhaps = perhaps or correlates_poorly(explained, signal, reason == 0)
    reason[periodic] = 2
    own_error = np.where(reason == 0, inflate_errors(own.standard_error, explained), np.inf)
    second = np.where(textured, match.second, np.nan).astype(np.float32)
    own = replace(own, standard_error=own_error)
    # Beyond this places are seen by no lens: without texture, costs may be least at an end of the
    # range.
    guess = np.clip(match.patch_size, -RESOLVABLE * pitch, RESOLVABLE * pitch)
    return LensEstimates(
        refined, error, SURE * sure if perhaps else sure, reason, guess, second, match, own
    )
