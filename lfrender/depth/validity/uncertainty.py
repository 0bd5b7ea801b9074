"""Confidence and standard errors of lenses: from unmatched texture, the scatter of pairs, neighbours, and other peaks.

Correlations here are normalised: by what a correct match reaches with this noise and overlap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_neighbours, count_similar
from ...flat.texture import Texture
from .periodicity import sees_little_of_scene
from .settings import UncertaintySettings

__all__ = [
    "combine_confidence", "confirmed_by_neighbours", "correlates_poorly", "has_secondary_peak", "inflate_errors",
    "repeats_with_neighbours", "sees_same_content", "signal_share", "systematic_error",
]  # fmt: skip

_DEFAULT = UncertaintySettings()


def signal_share(texture: Texture, settings: UncertaintySettings = _DEFAULT) -> NDArray:
    """(n,) share of the variance of each lens that is not noise: the largest correlation of a correct match."""
    noise = np.minimum(texture.noise / np.maximum(texture.statistics.contrast, 1e-12), 1)
    return np.asarray(np.maximum(1 - noise**2, settings.least_signal))


def inflate_errors(error: NDArray, correlation: NDArray, settings: UncertaintySettings = _DEFAULT) -> NDArray:
    """(n,) standard errors [px] including what all pairs of a lens have wrong in common.

    Parameters
    ----------
    error : (n,) [px]
        From the scatter of the pairs; inf where unknown.
    correlation : (n,)
        Normalised, of the match.
    settings : UncertaintySettings
    """
    return np.hypot(settings.matched_factor * error, systematic_error(error, correlation, settings))


def systematic_error(error: NDArray | float, correlation: NDArray, settings: UncertaintySettings = _DEFAULT) -> NDArray:
    """(n,) [px] the part of standard errors that all lenses of a surface may share, unseen in the scatter of pairs."""
    # Infinite errors stay infinite, even if all texture is matched.
    return np.asarray(settings.unmatched_factor * (1 - np.clip(correlation, 0, 0.999)) * error)


def combine_confidence(
    confidence: NDArray,
    sizes: NDArray,
    error: NDArray,
    correlation: NDArray,
    rows: NDArray[np.int32],
    pitch: float,
    settings: UncertaintySettings = _DEFAULT,
) -> NDArray:
    """(n,) `confidence` in the match, reduced if pairs scatter or few neighbours have the same depth.

    Parameters
    ----------
    confidence : (n,)
        Of the search: that no other shift is the right one, given that one of them is.
    sizes, error : (n,) [px]
        Patch sizes and their standard errors, see `inflate_errors`.
    correlation : (n,)
        Normalised, of the match.
    rows : (n, k) int32
        Neighbour rows, -1 where there is none.
    pitch : float [px]
    settings : UncertaintySettings
    """
    related = 1 / (1 + (error / (settings.unrelated_error * pitch)) ** 2)
    related = np.where(np.isfinite(error), related, settings.unmeasured)
    tolerance = max(0.5 * settings.same_surface * pitch, settings.least_same_surface)
    alone = count_similar(np.ones(len(rows), bool), sizes, rows, tolerance) < settings.alone * (rows >= 0).sum(1)
    chance = alone & (correlation < settings.doubtful)
    return np.asarray(confidence * related * np.where(chance, settings.chance, 1))


def correlates_poorly(
    correlation: NDArray,
    signal: NDArray,
    resolved: NDArray[np.bool_],
    alike: bool,
    settings: UncertaintySettings = _DEFAULT,
) -> bool:
    """Whether most lenses of little noise match far worse than they could: their depths are likely wrong.

    Parameters
    ----------
    correlation : (n,)
        Normalised, of the matches.
    signal : (n,)
        As `signal_share`.
    resolved : (n,) bool
    alike : bool
        All lenses see nearly the same content.
    settings : UncertaintySettings
    """
    enough, least = settings.clear_signal, settings.clear_correlation
    if alike:
        enough, least = settings.clear_signal_alike, settings.clear_correlation_alike
    clear = resolved & (signal >= enough)
    return bool(2 * clear.sum() >= max(resolved.sum(), 1) and np.median(correlation[clear]) < least)


def confirmed_by_neighbours(
    resolved: NDArray[np.bool_],
    sizes: NDArray,
    correlation: NDArray,
    rows: NDArray[np.int32],
    pitch: float,
    settings: UncertaintySettings = _DEFAULT,
) -> NDArray[np.bool_]:
    """(n,) bool: lenses, maybe faint ones, with the depth of two resolved neighbours that match well themselves."""
    good = resolved & (correlation >= settings.confirming)
    similar = count_similar(good, sizes, rows, settings.same_surface * pitch)
    return np.asarray(similar >= settings.confirming_lenses)


def has_secondary_peak(
    primary: NDArray,
    secondary: NDArray,
    signal: NDArray,
    same: NDArray[np.bool_],
    settings: UncertaintySettings = _DEFAULT,
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that correlate at two shifts as only periodic texture does.

    Two depths in one lens share its contrast, so that their correlations add up to one at most.

    Parameters
    ----------
    primary, secondary : (n,)
        Correlation at the chosen shift and at the best of the others.
    signal : (n,)
        As `signal_share`.
    same : (n,) bool
        Lenses as `sees_same_content`.
    settings : UncertaintySettings
    """
    high = secondary > np.where(same, settings.secondary_peak_alike, settings.secondary_peak) * primary
    return np.asarray(high & (primary + secondary > settings.both_peaks * signal))


def sees_same_content(
    centres: NDArray,
    sizes: NDArray,
    resolved: NDArray[np.bool_],
    pitch: float,
    settings: UncertaintySettings = _DEFAULT,
) -> NDArray[np.bool_]:
    """(n,) bool: lenses with a patch size near zero, if all together see little more of the scene than one.

    Parameters
    ----------
    centres, sizes : (n, 2), (n,) [px]
        Centres and patch sizes of lenses.
    resolved : (n,) bool
    pitch : float [px]
    settings : UncertaintySettings
    """
    near_zero = np.abs(sizes) <= settings.near_zero * pitch
    return near_zero & (near_zero.any() and sees_little_of_scene(centres, sizes, resolved, pitch))


def repeats_with_neighbours(
    resolved: NDArray[np.bool_],
    uniqueness: NDArray,
    secondary: NDArray[np.bool_],
    occurring: NDArray[np.bool_],
    rows: NDArray[np.int32],
    settings: UncertaintySettings = _DEFAULT,
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that match at another shift as well, if half of the flat or of their neighbours do too.

    Their texture repeats; a single ambiguous lens is more likely chance. The best match need not be the right one: at
    the right one neighbours may share less, and differ by the shading of their rims.

    Parameters
    ----------
    resolved : (n,) bool
    uniqueness : (n,)
        Probability of each match among those that correlate as well.
    secondary : (n,) bool
        Lenses as `has_secondary_peak`.
    occurring : (n,) bool
        Lenses whose depth occurs among the unambiguous ones: these decide if they are more than half.
    rows : (n, k) int32
        Neighbour rows, -1 where there is none.
    settings : UncertaintySettings
    """
    ambiguous = resolved & ((uniqueness < settings.ambiguous) | secondary)
    beside = count_neighbours(ambiguous, rows)
    if 2 * ambiguous.sum() >= resolved.sum():
        return ambiguous | (resolved & (2 * beside >= (rows >= 0).sum(1)))
    together = 2 * beside >= rows.shape[1]
    return ambiguous & together & ((uniqueness < settings.clearly_ambiguous) | secondary) & ~occurring
