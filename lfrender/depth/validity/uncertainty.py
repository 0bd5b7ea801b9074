"""Confidence and standard errors of lenses, from unmatched texture and the scatter of pairs.

Correlations here are normalised: by what a correct match reaches with this noise and overlap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.texture import Texture
from .settings import CLASSIFY, ClassifySettings

__all__ = [
    "combine_confidence", "correlates_poorly", "inflate_errors", "signal_share", "systematic_error",
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
