"""Confidence and standard errors of lenses: from unmatched texture, the scatter of pairs, neighbours, and other peaks.

Correlations here are normalised: by what a correct match reaches with this noise and overlap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_neighbours, count_similar
from ...flat.texture import Texture
from .settings import CLASSIFY, ClassifySettings

__all__ = [
    "combine_confidence", "confirmed_by_neighbours", "correlates_poorly", "has_secondary_peak", "inflate_errors",
    "repeats_with_neighbours", "signal_share", "systematic_error",
]  # fmt: skip


def signal_share(texture: Texture, settings: ClassifySettings = CLASSIFY) -> NDArray:
    """(n,) share of the variance of each lens that is not noise: the largest correlation of a correct match."""
    noise = np.minimum(texture.noise / np.maximum(texture.statistics.contrast, 1e-12), 1)
    return np.asarray(np.maximum(1 - noise**2, settings.least_correlation))


def inflate_errors(error: NDArray, correlation: NDArray, settings: ClassifySettings = CLASSIFY) -> NDArray:
    """(n,) standard errors [px] including what all pairs of a lens have wrong in common.

    Parameters
    ----------
    error : (n,) [px]
        From the scatter of the pairs; inf where unknown.
    correlation : (n,)
        Normalised, of the match.
    settings : ClassifySettings
    """
    return np.hypot(settings.matched_factor * error, systematic_error(error, correlation, settings))


def systematic_error(error: NDArray | float, correlation: NDArray, settings: ClassifySettings = CLASSIFY) -> NDArray:
    """(n,) [px] the part of standard errors that all lenses of a surface may share, unseen in the scatter of pairs."""
    # Infinite errors stay infinite, even if all texture is matched.
    return np.asarray(settings.unmatched_factor * (1 - np.clip(correlation, 0, 0.999)) * error)


def combine_confidence(
    confidence: NDArray, error: NDArray, pitch: float, settings: ClassifySettings = CLASSIFY
) -> NDArray:
    """(n,) `confidence` in the match, reduced if pairs scatter, or could not be measured.

    Parameters
    ----------
    confidence : (n,)
        Of the search: that no other shift is the right one, given that one of them is.
    error : (n,) [px]
        Standard errors, see `inflate_errors`.
    pitch : float [px]
    settings : ClassifySettings
    """
    unrelated = settings.unrelated_error * pitch
    return np.asarray(confidence / (1 + (np.where(np.isfinite(error), error, unrelated) / unrelated) ** 2))


def correlates_poorly(
    correlation: NDArray,
    signal: NDArray,
    resolved: NDArray[np.bool_],
    alike: bool,
    settings: ClassifySettings = CLASSIFY,
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
    settings : ClassifySettings
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
    settings: ClassifySettings = CLASSIFY,
) -> NDArray[np.bool_]:
    """(n,) bool: lenses, maybe faint ones, with the depth of two resolved neighbours that match well themselves."""
    good = resolved & (correlation >= settings.shared)
    similar = count_similar(good, sizes, rows, settings.same_surface * pitch)
    return np.asarray(similar > settings.alone)


def has_secondary_peak(
    primary: NDArray, secondary: NDArray, signal: NDArray, settings: ClassifySettings = CLASSIFY
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that correlate at two shifts as only periodic texture does.

    Two depths in one lens share its contrast, so that their correlations add up to one at most.

    Parameters
    ----------
    primary, secondary : (n,)
        Correlation at the chosen shift and at the best of the others.
    signal : (n,)
        As `signal_share`.
    settings : ClassifySettings
    """
    high = secondary > settings.secondary_peak * primary
    return np.asarray(high & (primary + secondary > settings.both_peaks * signal))


def repeats_with_neighbours(
    resolved: NDArray[np.bool_],
    uniqueness: NDArray,
    secondary: NDArray[np.bool_],
    occurring: NDArray[np.bool_],
    rows: NDArray[np.int32],
    settings: ClassifySettings = CLASSIFY,
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
    settings : ClassifySettings
    """
    ambiguous = resolved & ((uniqueness < settings.sure) | secondary)
    beside = count_neighbours(ambiguous, rows)
    if 2 * ambiguous.sum() >= resolved.sum():
        return ambiguous | (resolved & (2 * beside >= (rows >= 0).sum(1)))
    together = 2 * beside >= rows.shape[1]
    return ambiguous & together & ~occurring
