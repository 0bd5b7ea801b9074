"""What lenses answer to the question for their depth: searched, measured on their pixels, and judged."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..data.depth_map import DepthMap
from ..flat.gray_flat import downsample
from ..flat.lens_graph import join_opposite, restrict_neighbours
from ..flat.texture import Texture
from .matching.matcher import Matcher, MatchResult, match_lenses
from .presets import Preset
from .refinement.lens_plane import LensFits
from .refinement.neighbour_prior import refine_patch_sizes
from .refinement.quadratic_fit import fit_quadratic
from .refinement.smoothing import smooth_fits, smooth_fits_far
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
from .validity.uncertainty import correlates_poorly, inflate_errors, signal_share, systematic_error

__all__ = ["DEFAULT_RATIO", "LensEstimates", "LensSet", "PreviousEstimates", "estimate_lenses"]

# What lenses keep, and where that stands in `PreviousEstimates`.
_KEPT = {
    "patch_size": "filled_patch_size", "standard_error": "standard_error", "confidence": "confidence",
    "reason": "reason", "guess": "filled_patch_size",
}  # fmt: skip
# Lenses that blur unlike each other are compared on a flat of about this pitch [px].
_BLURRED_PITCH = 25.0
# Bends are looked at whose square exceeds so many times its variance, and believed at twice as many, by lenses that
# share as much with others as up to the second share of the pitch: beyond, their rims alone would tell.
_BENT, _SHARING = 3.0, 0.45
# Lenses turn to another depth that is, to this share of the pitch, that of others, and that explains this share of what
# the first does: of lenses with one depth whose pairs agree better on another, that is the right one for 26 of 27, and
# for one of five if it explains less.
_OCCURRING, _AS_WELL = 0.03, 0.8
# A scene without any texture is drawn at this s / D: from the middle of the microimages. Its sign makes no difference.
DEFAULT_RATIO = 0.25


@dataclass(frozen=True)
class LensSet:
    """Lenses that are asked, all of a flat or some with those beside them, and those of them that are matched.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    indices : (n, 2) int
        On the lattice.
    near : (n,) bool
        Lenses with a new answer.
    active : (n,) bool
        Those of them to match.
    sample : (n,) bool, optional
        Lenses that tell which depths occur, see `match_lenses`.
    """

    texture: Texture
    forward: NDArray[np.int32]
    backward: NDArray[np.int32]
    indices: NDArray[np.int64]
    near: NDArray[np.bool_]
    active: NDArray[np.bool_]
    sample: NDArray[np.bool_] | None

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

    def of(self, rows: NDArray[np.int64]) -> LensSet:
        """Some of them, as if there were no others."""
        forward, backward = (restrict_neighbours(rows, half) for half in (self.forward, self.backward))
        sample = None if self.sample is None else self.sample[rows]
        return LensSet(
            self.texture.select(rows), forward, backward, self.indices[rows], self.near[rows], self.active[rows], sample
        )


@dataclass(frozen=True)
class PreviousEstimates:
    """Answers that lenses keep.

    Parameters
    ----------
    kept : (n,) bool
    filled_patch_size, standard_error, confidence, reason : (n,)
        As `DepthMap`.
    """

    kept: NDArray[np.bool_]
    filled_patch_size: NDArray[np.float32]
    standard_error: NDArray[np.float32]
    confidence: NDArray[np.float32]
    reason: NDArray[np.int8]

    @classmethod
    def by(cls, before: DepthMap, kept: NDArray[np.bool_]) -> PreviousEstimates:
        """Those of an earlier depth map."""
        return cls(kept, before.filled_patch_size, before.standard_error, before.confidence, before.reason)

    def of(self, rows: NDArray[np.int64]) -> PreviousEstimates:
        """Those of some lenses."""
        return PreviousEstimates(*(getattr(self, field.name)[rows] for field in fields(self)))

    def recurring(self, resolved: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], bool] | None:
        """As `find_periodic_texture` of lenses that are `resolved` (n,) now, where that is known from before.

        Where most of them have been asked before, and nothing repeated in what they saw, nothing does.
        """
        known = self.kept & (self.reason == 0)
        if known.sum() <= (resolved & ~self.kept).sum() or (self.reason[self.kept] == 2).any():
            return None
        # Where the scene may repeat, the confidence of all lenses has been cut to this.
        return np.zeros(len(resolved), bool), bool(self.confidence[known].max() <= CLASSIFY.sure)


@dataclass(frozen=True)
class LensEstimates:
    """What lenses answer.

    Parameters
    ----------
    patch_size, standard_error, confidence : (n,) [px]
        Also of unresolved lenses.
    reason : (n,) int8
        As `DepthMap`.
    astray : (n,) [px]
        Part of each error that all lenses of a surface may share.
    guess : (n,) [px]
        Patch size to draw unresolved lenses with, where those beside them tell nothing else.
    second : (n,) float32 [px]
        Next best patch size of lenses with texture; NaN where there is none.
    found : Found
    alone : LensFits
        What each lens that was asked says for itself: what it measures, or kept; its error is infinite where it is
        unresolved.
    """

    patch_size: NDArray
    standard_error: NDArray
    confidence: NDArray
    reason: NDArray[np.int8]
    systematic_error: NDArray
    guess: NDArray
    second: NDArray[np.float32]
    found: MatchResult
    alone: LensFits

    @property
    def resolved(self) -> NDArray[np.bool_]:
        return self.reason == 0

    @property
    def filled_patch_size(self) -> NDArray[np.float32]:
        """(n,) float32 [px]: the answers of resolved lenses, and guesses of the others."""
        return np.where(self.resolved, self.patch_size, self.guess).astype(np.float32)

    def pooled(self, lenses: LensSet, kept: NDArray[np.bool_] | None, bends: bool) -> LensEstimates:
        """These with what the lenses on the same surface say as well; those that are `kept` stay.

        With `bends`, lenses on bent surfaces are measured at their centres first.
        """
        wanted = self.resolved if kept is None else self.resolved & ~kept
        flat, neighbours = lenses.texture.flat, lenses.neighbours
        where = flat.centres, lenses.pitch, flat.radius, neighbours
        pool = partial(smooth_fits, *where)
        # Those that are kept have been freed of what they show of bends.
        freed = (~wanted).astype(np.float32)
        joint = pool(self.alone, wanted, freed)
        # Lenses of unlike blur differ by more than their patch sizes.
        if bends and flat.lens_type is None:
            doubted = wanted & (np.abs(self.alone.patch_size) < _SHARING * lenses.pitch)
            asked = np.where(doubted, np.clip(joint.curvature_significance / _BENT - 1, 0, 1), 0).astype(np.float32)
            alone, centred = fit_quadratic(flat, neighbours, self.alone, asked, _usual_contrast(lenses.texture))
            joint = pool(alone, wanted, np.maximum(freed, centred)) if centred.any() else joint
        fits = smooth_fits_far(*where, joint, wanted)
        known = wanted & np.isfinite(fits.standard_error)
        return replace(
            self,
            patch_size=np.where(known, fits.patch_size, self.patch_size),
            standard_error=np.where(known, fits.standard_error, self.standard_error),
        )

    def among(self, count: int, rows: NDArray[np.int64], earlier: PreviousEstimates | None) -> LensEstimates:
        """These as those of the lenses at `rows` of `count`; the others are blank, or as they were."""
        blank = {
            "patch_size": np.nan, "standard_error": np.inf, "confidence": 0, "reason": 1, "systematic_error": np.inf,
            "guess": np.nan, "second": np.nan,
        }  # fmt: skip
        whole = {}
        for name, value in blank.items():
            some = getattr(self, name)
            whole[name] = np.full(count, value, some.dtype)
            if earlier is not None and name in _KEPT:
                whole[name][:] = getattr(earlier, _KEPT[name])
            whole[name][rows] = some
        return LensEstimates(**whole, found=self.found, alone=self.alone)


def estimate_lenses(
    lenses: LensSet, setting: Preset, earlier: PreviousEstimates | None = None, sizes: NDArray[np.float32] | None = None
) -> LensEstimates:
    """Search the depth of lenses, measure it on the pixels of every pair, and judge it.

    `sizes` (m,) [px] are patch sizes that occur, as found elsewhere, see `match_lenses`.
    """
    texture, near, pitch, neighbours = lenses.texture, lenses.near, lenses.pitch, lenses.neighbours
    known = None if earlier is None else np.where(near, np.nan, earlier.filled_patch_size).astype(np.float32)
    matcher = Matcher(texture, lenses.forward, lenses.backward, setting)
    found = match_lenses(matcher, lenses.active, texture.clear, lenses.sample, known, sizes)
    like_shading = looks_like_shading(texture.clear & near, found, texture.statistics.contrast, pitch)
    doubtful = texture.faint | like_shading
    textured = near & ((texture.clear & ~doubtful) | (doubtful & match_proves_texture(found, pitch)))
    maybe = near & doubtful & ~textured & match_suggests_texture(found)
    wanted = textured | maybe
    telling = (wanted | ~near) & (np.minimum(found.confidence, found.uniqueness) >= CLASSIFY.sure)
    occurring = found.patch_size[telling] if sizes is None else sizes
    alone, refined, error, found = _refined(lenses, setting, found, wanted, occurring)
    textured |= maybe & shift_exceeds_shading(refined, error, pitch)
    textured &= ~(like_shading & shift_may_be_zero(refined, error))
    signal = signal_share(texture)
    explained = found.normalised_correlation / signal
    astray = systematic_error(error, explained)
    reason, error, sure = classify_lenses(
        textured, found, refined, error, signal, texture.flat.centres, neighbours, pitch
    )
    depths, shown, told = refined, reason == 0, None
    if earlier is not None:
        # Those that keep their answer see the same scene.
        told = earlier.recurring(shown)
        depths, shown = (
            np.where(earlier.kept, earlier.filled_patch_size, refined),
            shown | (earlier.kept & (earlier.reason == 0)),
        )
    again, perhaps = told or find_periodic_texture(texture.flat, lenses.indices, depths, shown)
    little = sees_little_of_scene(texture.flat.centres, depths, shown, pitch)
    perhaps = perhaps or correlates_poorly(explained, signal, reason == 0, little)
    reason[again] = 2
    sure = CLASSIFY.sure * sure if perhaps else sure
    alone = replace(
        alone, standard_error=np.where(reason == 0, inflate_errors(alone.standard_error, explained), np.inf)
    )
    guess = found.patch_size
    if earlier is not None and known is not None:
        refined = np.where(earlier.kept, earlier.filled_patch_size, refined)
        error = np.where(earlier.kept, earlier.standard_error, error)
        sure = np.where(earlier.kept, earlier.confidence, sure)
        reason = np.where(earlier.kept, earlier.reason, reason)
        guess = np.where(np.isfinite(known), known, guess)
        alone = replace(
            alone,
            patch_size=np.where(earlier.kept, earlier.filled_patch_size, alone.patch_size),
            standard_error=np.where(
                earlier.kept, np.where(earlier.reason == 0, earlier.standard_error, np.inf), alone.standard_error
            ),
        )
    guess = _within_reach(guess, refined, reason, pitch)
    second = np.where(textured, found.second, np.nan).astype(np.float32)
    return LensEstimates(refined, error, sure, reason, astray, guess, second, found, alone)


def _refined(
    lenses: LensSet, setting: Preset, found: MatchResult, wanted: NDArray[np.bool_], occurring: NDArray[np.float32]
) -> tuple[LensFits, NDArray, NDArray, MatchResult]:
    """What lenses measure alone, their patch sizes and errors (n,) [px] with those around them, and what they found.

    Of the lenses `wanted`; for the others what was found, and inf. Some turn to the next best value that they found,
    if it is one of those `occurring` (m,) [px].
    """
    texture = lenses.texture
    scale = _usual_contrast(texture)
    # Where one lens is more blurred than the next, finer detail than this tells the difference and not the depth.
    factor = max(1, round(lenses.pitch / _BLURRED_PITCH)) if texture.flat.lens_type is not None else 1
    first = np.where(wanted, found.patch_size / factor, np.nan).astype(np.float32)
    like = wanted & occurs_among(found.second, occurring, _OCCURRING * lenses.pitch)
    second = np.where(like & (found.second_normalised >= _AS_WELL * found.normalised_correlation), found.second, np.nan)
    found_by = refine_patch_sizes(
        downsample(texture.flat, factor),
        lenses.forward,
        lenses.backward,
        first,
        (second / factor).astype(np.float32),
        scale,
        texture.noise / factor,
        setting.iterations,
        setting.last_step,
    )
    alone, by_pixels = (fits.larger(factor) for fits in found_by)
    measured = np.isfinite(by_pixels.patch_size)
    refined = np.where(measured, by_pixels.patch_size, found.patch_size)
    turned = np.abs(alone.patch_size - second) < np.abs(alone.patch_size - found.patch_size)
    return alone, refined, np.where(measured, by_pixels.standard_error, np.inf), found.swap_second(turned)


def _usual_contrast(texture: Texture) -> NDArray[np.float32]:
    """(n,) float32 difference of brightness beyond which two pixels hardly show the same point."""
    return np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast).astype(np.float32)


def _within_reach(guess: NDArray, refined: NDArray, reason: NDArray[np.int8], pitch: float) -> NDArray:
    """First guesses of unresolved lenses; those without texture that end where no depth is resolvable start anew.

    Costs that are all alike have their minimum at an end of the range. Drawn there, a blank place would be read at
    the rims of microimages.
    """
    astray = (reason == 1) & (np.abs(guess) > CLASSIFY.resolvable * pitch)
    known = refined[reason == 0]
    return np.where(astray, np.median(known) if known.size else DEFAULT_RATIO * pitch, guess)
