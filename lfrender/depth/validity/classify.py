"""Which lenses are resolved, and the reason why the others are not, from matches, sub-pixel fits and neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_similar
from ...flat.shading import LARGEST_SHADING
from ..matching.matcher import MatchResult
from ..same_surface import TOLERANCE, same_surface
from .periodicity import sees_little_of_scene
from .settings import CLASSIFY, ClassifySettings
from .uncertainty import (
    combine_confidence,
    confirmed_by_neighbours,
    has_secondary_peak,
    inflate_errors,
    repeats_with_neighbours,
)

__all__ = [
    "classify_lenses", "initial_reasons", "looks_like_shading", "match_proves_texture", "match_suggests_texture",
    "occurs_among", "shift_exceeds_shading", "shift_may_be_zero",
]  # fmt: skip


def classify_lenses(
    textured: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    error: NDArray,
    signal: NDArray[np.float32],
    centres: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
    settings: ClassifySettings = CLASSIFY,
) -> tuple[NDArray[np.int8], NDArray, NDArray]:
    """Reason, standard error and confidence of every lens, as `DepthMap`.

    Parameters
    ----------
    textured : (n,) bool
    found : MatchResult
    refined, error : (n,) [px]
        Sub-pixel patch sizes and standard errors.
    signal : (n,)
        As `signal_share`.
    centres : (n, 2) [px]
    neighbours : (n, k) int32
        Neighbour rows, -1 where there is none.
    pitch : float [px]
    settings : ClassifySettings
    """
    pairs_agree = _pairs_agree(refined, error, neighbours, pitch, settings)
    reason = initial_reasons(textured, found, refined, pairs_agree, pitch, settings)
    reason[(reason == 0) & _unmeasured(refined, error, neighbours, pitch, settings)] = 2
    reason[_may_match_by_chance(reason == 0, found, refined, signal, neighbours, pitch, settings)] = 3
    correlation = found.normalised_correlation / signal
    beside = confirmed_by_neighbours(reason == 0, refined, correlation, neighbours, pitch, settings)
    reason[(reason > 1) & beside & (np.abs(refined) <= settings.resolvable * pitch)] = 0
    secondary = has_secondary_peak(found.primary_peak, found.secondary_peak, signal, settings)
    if sees_little_of_scene(centres, refined, reason == 0, pitch):
        # Near zero all lenses see the same content, and match by chance alike.
        secondary &= np.abs(refined) > TOLERANCE * pitch
    single = (reason == 0) & (found.uniqueness >= settings.sure) & ~secondary
    occurring = _occurs(refined, refined[single], pitch, settings)
    reason[repeats_with_neighbours(reason == 0, found.uniqueness, secondary, occurring, neighbours, settings)] = 2
    blank = (reason > 1) & (found.correlation < settings.shared) & (signal < settings.faint_signal)
    for _ in range(2):
        reason[blank] = 1
        blank |= _alone_and_weak(reason == 0, found, refined, signal, neighbours, pitch, settings)
    reason[blank] = 1
    error = inflate_errors(error, correlation, settings)
    sure = np.where(textured & ~blank, np.minimum(found.confidence, found.uniqueness), 0)
    return reason, error, combine_confidence(sure, error, pitch, settings)


def _pairs_agree(
    refined: NDArray, error: NDArray, neighbours: NDArray[np.int32], pitch: float, settings: ClassifySettings
) -> NDArray[np.bool_]:
    """Lenses whose pairs agree, and those that two such neighbours confirm; at the border, where a lens has few pairs,
    one neighbour must confirm what they agree on."""
    agree = error <= 0.5 * TOLERANCE * pitch
    confirming = count_similar(agree, refined, neighbours, TOLERANCE * pitch)
    whole = (neighbours >= 0).all(1)
    return np.asarray((agree & whole) | (confirming > np.where(agree, 0, settings.alone)))


def _unmeasured(
    refined: NDArray, error: NDArray, neighbours: NDArray[np.int32], pitch: float, settings: ClassifySettings
) -> NDArray[np.bool_]:
    """Lenses that share too few pixels with any other for a fit, and have no neighbour at their depth.

    The search alone is biased toward shifts at which more pixels are shared.
    """
    measured = np.isfinite(error)
    if measured.all():
        return ~measured
    similar = count_similar(measured, refined, neighbours, settings.same_surface * pitch)
    return np.asarray(~measured & (similar == 0))


def _may_match_by_chance(
    resolved: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    signal: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
    settings: ClassifySettings,
) -> NDArray[np.bool_]:
    """Lenses that match no better than unrelated content may, without two better neighbours at their depth.

    If most lenses match better than that, depths that occur among those are accepted for the others.
    """
    sure = resolved & (found.correlation >= settings.by_chance)
    if 2 * sure.sum() > resolved.sum():
        resolved = resolved & ~_occurs(refined, refined[sure], pitch, settings)
    better = resolved & (found.correlation >= settings.shared * signal)
    similar = count_similar(better, refined, neighbours, settings.same_surface * pitch)
    return np.asarray(resolved & (found.correlation < settings.by_chance) & (similar <= settings.alone))


def _alone_and_weak(
    resolved: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    signal: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
    settings: ClassifySettings,
) -> NDArray[np.bool_]:
    """Lenses whose depth hardly any neighbour has, and whose texture is as weak as their match.

    What stands alone in front of something has an outline. On blank walls noise and file coding match somewhere.
    """
    if not resolved.any():
        return resolved
    similar = count_similar(resolved, refined, neighbours, settings.same_surface * pitch)
    # Contrasts over the noise, as squares, compared with those of typical lenses.
    share = np.float32(1) - signal
    weak = settings.weak_contrast**2 * share > np.median(share[resolved])
    proven = (found.confidence >= settings.proven_confidence) & (found.correlation >= settings.by_chance)
    return np.asarray(resolved & (similar <= settings.alone) & weak & ~proven)


def initial_reasons(
    textured: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    pairs_agree: NDArray[np.bool_],
    pitch: float,
    settings: ClassifySettings = CLASSIFY,
) -> NDArray[np.int8]:
    """(n,) int8: as `DepthMap.reason`, 0 for resolved lenses, from each lens alone."""
    size, unsure = np.abs(refined), found.confidence < settings.sure
    little = found.correlation < settings.shared
    hardly = (size > settings.hardly_shared * pitch) | (found.correlation < settings.least_correlation)
    unshared = (size > settings.resolvable * pitch) | (unsure & little) | (hardly & ~pairs_agree)
    return np.select([~textured, unshared, unsure], [1, 3, 2], 0).astype(np.int8)


def occurs_among(
    values: NDArray[np.float32], known: NDArray[np.float32], gap: float, settings: ClassifySettings = CLASSIFY
) -> NDArray[np.bool_]:
    """Which `values` occur among the `known` ones, within `gap`; false matches of a periodic texture do not."""
    least = max(1, int(np.ceil(settings.occurring_share * len(known))))
    ordered = np.append(np.sort(known), np.full(least, np.inf, known.dtype))
    return np.asarray(ordered[np.searchsorted(ordered[:-least], values - gap) + least - 1] < values + gap)


def _occurs(values: NDArray, known: NDArray, pitch: float, settings: ClassifySettings) -> NDArray[np.bool_]:
    return occurs_among(values, known, 0.5 * settings.same_surface * pitch, settings)


def shift_exceeds_shading(
    refined: NDArray,
    error: NDArray,
    neighbours: NDArray[np.int32],
    pitch: float,
    settings: ClassifySettings = CLASSIFY,
) -> NDArray[np.bool_]:
    """Lenses whose pairs agree on a shift, together with their neighbours; shading, which stays with its lens, has
    none."""
    rows = np.column_stack([np.arange(len(refined)), neighbours])
    sizes, variance = refined[rows], np.where(rows >= 0, np.square(error[rows]), np.inf)
    like = same_surface(sizes, refined[:, None], 3 * error[:, None]) & np.isfinite(variance)
    weight = np.where(like, 1 / np.maximum(variance, 1e-12), 0)
    total = np.maximum(weight.sum(1), 1e-12)
    mean = (weight * sizes).sum(1) / total
    # Neighbours share pairs: half of their variance is common to all.
    spread = np.sqrt(0.5 * (1 + like.sum(1)) / total)
    agree = (spread <= settings.still_error * pitch) & ~shift_may_be_zero(mean, spread, settings)
    return np.asarray(agree & (np.abs(mean) >= settings.still * pitch))


def shift_may_be_zero(refined: NDArray, error: NDArray, settings: ClassifySettings = CLASSIFY) -> NDArray[np.bool_]:
    """Lenses whose shift does not differ significantly from zero."""
    return np.asarray(np.abs(refined) < settings.still_sigmas * error)


def looks_like_shading(
    clear: NDArray[np.bool_],
    found: MatchResult,
    contrast: NDArray[np.float32],
    pitch: float,
    settings: ClassifySettings = CLASSIFY,
) -> NDArray[np.bool_]:
    """Those of the `clear` lenses that show no more than shading may: little contrast (white = 1), near zero.

    Toward the border of a flat the main lens cuts microimages, each a little differently, so that no average of others
    removes it. A depth near zero that occurs among the other lenses is the scene's.
    """
    size = found.patch_size
    little = clear & (contrast <= LARGEST_SHADING) & (np.abs(size) < settings.shading_reach * pitch)
    return np.asarray(little & ~_occurs(size, size[clear & ~little], pitch, settings))


def match_proves_texture(found: MatchResult, pitch: float, settings: ClassifySettings = CLASSIFY) -> NDArray[np.bool_]:
    """Lenses whose match alone proves that they have texture."""
    near_zero = np.abs(found.patch_size) < settings.shading_reach * pitch
    enough = np.where(near_zero, settings.shading_correlation, settings.least_correlation)
    return (found.confidence >= settings.proven_confidence) & (found.correlation >= enough)


def match_suggests_texture(found: MatchResult, settings: ClassifySettings = CLASSIFY) -> NDArray[np.bool_]:
    """Lenses whose match would prove texture if it were not near zero."""
    return (found.confidence >= settings.proven_confidence) & (found.correlation >= settings.least_correlation)
