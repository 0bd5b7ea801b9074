"""How far an answer can be relied on: what its match leaves unexplained, how its pairs scatter, who confirms it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_neighbours, count_similar
from ...flat.texture import Texture
from .periodicity import sees_little_of_scene

__all__ = [
    "combine_confidence",
    "confirmed_by_neighbours",
    "correlates_poorly",
    "has_secondary_peak",
    "inflate_errors",
    "repeats_with_neighbours",
    "sees_same_content",
    "signal_share",
    "systematic_error",
]  # fmt: skip

# The part of the texture that a match leaves unexplained misleads all pairs of a lens together, which their scatter
# cannot show: factor of a standard error where all is explained, and what is added in squares for the share that is
# not. Measured on random planes and ray-traced scenes of `data_synth`.
_EXPLAINED, _MISLED = 0.95, 2.7
# Pairs of unrelated content scatter by this share of the pitch: a lens with such an error is as likely one of them.
_UNRELATED = 0.035
# A lens that explains less than this of its texture, and of whose neighbours fewer than the second share have its
# depth to this share of the pitch (or these px), may have met its match by chance.
_DOUBTFUL, _ALONE = 0.6, 0.3
_ALIKE, _ALIKE_PX = 0.03, 0.3
_HALF = 0.5
# Where most lenses are not torn, another shift must be twice as likely.
_TWICE = 1 / 3
# Correlation at another shift over that of the answer: below this on nearly nine lenses of ten with texture that does
# not repeat, above it on most others.
_ECHO = 0.3
# What one lens matches by chance all do where they show the same: there an echo must be as loud as this, for patch
# sizes below the second share of the pitch. Farther from zero waves beyond reach answer, with echoes of half and more.
_ECHO_ALIKE, _NEAR_ZERO = 0.6, 0.05
# Correlations at two shifts together over that of a perfect match: a tenth more than two depths can have.
_MORE_THAN_ALL = 1.1
# Of texture that is mostly noise, correlation tells no more about how much of it is explained.
_LEAST_SIGNAL = 0.1
# Lenses that explain this much of their texture confirm others, so many of them together.
_WELL, _CONFIRMING = 0.25, 2
# Where noise leaves so much of the contrast squared to explain, most lenses of a scene explain more than the second
# share of it: of captures and ray-traced scenes 0.58 and more, of textures that repeat beyond reach 0.3 to 0.75.
_CLEAR, _MOSTLY = 0.8, 0.55
# Where all lenses see nearly the same, planes explain 0.85 and more, and textures that repeat less than this.
_CLEAR_ALIKE, _MOSTLY_ALIKE = 0.5, 0.8
# Lenses that could not be measured on their pixels: less than even.
_UNMEASURED = 0.4


def signal_share(texture: Texture) -> NDArray:
    """(n,) share of the contrast squared of each lens that is no noise: what a right match may correlate at best."""
    noise = np.minimum(texture.noise / np.maximum(texture.statistics.contrast, 1e-12), 1)
    return np.asarray(np.maximum(1 - noise**2, _LEAST_SIGNAL))


def inflate_errors(error: NDArray, explained: NDArray) -> NDArray:
    """(n,) standard errors [px] that include what misleads all pairs of a lens together.

    Parameters
    ----------
    error : (n,) [px]
        From the scatter of the pairs; inf where unknown.
    explained : (n,)
        Share of the texture that the match explains, noise apart.
    """
    return np.hypot(_EXPLAINED * error, systematic_error(error, explained))


def systematic_error(error: NDArray | float, explained: NDArray) -> NDArray:
    """(n,) [px] the part of standard errors that all lenses of a surface may share, unseen in the scatter of pairs."""
    # Nothing is known of infinite errors, even where all is explained.
    return np.asarray(_MISLED * (1 - np.clip(explained, 0, 0.999)) * error)


def combine_confidence(
    confidence: NDArray, sizes: NDArray, error: NDArray, explained: NDArray, rows: NDArray[np.int32], pitch: float
) -> NDArray:
    """(n,) `confidence` in the optimum, less where the pairs of a lens or the lenses around it do not bear it out.

    Parameters
    ----------
    confidence : (n,)
        Of the search: that no other shift is the right one, given that one of them is.
    sizes, error : (n,) [px]
        Patch sizes and their `inflate_errors` standard errors.
    explained : (n,)
        As for `inflate_errors`.
    rows : (n, k) int32
        Neighbour rows, -1 where there is none.
    pitch : float [px]
    """
    share = np.where(np.isfinite(error), 1 / (1 + (error / (_UNRELATED * pitch)) ** 2), _UNMEASURED)
    like = count_similar(np.ones(len(rows), bool), sizes, rows, max(_ALIKE * pitch, _ALIKE_PX))
    alone = like < _ALONE * (rows >= 0).sum(1)
    return np.asarray(confidence * share * np.where(alone & (explained < _DOUBTFUL), _HALF, 1))


def correlates_poorly(explained: NDArray, signal: NDArray, resolved: NDArray[np.bool_], count_similar: bool) -> bool:
    """Whether most lenses of little noise match far worse than they could: at depths that are not theirs.

    Parameters
    ----------
    explained, signal : (n,)
        As for `inflate_errors` and `has_secondary_peak`.
    resolved : (n,) bool
    alike : bool
        All lenses see nearly the same.
    """
    enough, least = (_CLEAR_ALIKE, _MOSTLY_ALIKE) if count_similar else (_CLEAR, _MOSTLY)
    clear = resolved & (signal >= enough)
    return bool(2 * clear.sum() >= max(resolved.sum(), 1) and np.median(explained[clear]) < least)


def confirmed_by_neighbours(
    resolved: NDArray[np.bool_], sizes: NDArray, explained: NDArray, rows: NDArray[np.int32], pitch: float
) -> NDArray[np.bool_]:
    """(n,) bool: lenses with the depth of two resolved ones beside them that match well themselves.

    A faint or dark lens on a surface says too little for itself, but not something else.
    """
    good = resolved & (explained >= _WELL)
    return np.asarray(count_similar(good, sizes, rows, 2 * _ALIKE * pitch) >= _CONFIRMING)


def has_secondary_peak(matched: NDArray, echo: NDArray, signal: NDArray, same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose texture repeats, as far as they can tell.

    What a lens sees of two depths shares its contrast between them, so that the correlations add up to one at most.

    Parameters
    ----------
    matched, echo : (n,)
        Correlation at the chosen shift and at the best of the others.
    signal : (n,)
        What a right match may correlate at best.
    same : (n,) bool
        Lenses as `sees_same_content`.
    """
    loud = echo > np.where(same, _ECHO_ALIKE, _ECHO) * matched
    return np.asarray(loud & (matched + echo > _MORE_THAN_ALL * signal))


def sees_same_content(centres: NDArray, sizes: NDArray, resolved: NDArray[np.bool_], pitch: float) -> NDArray[np.bool_]:
    """(n,) bool: lenses with a patch size near zero, where all together see little more of the scene than one.

    Parameters
    ----------
    centres, sizes : (n, 2), (n,) [px]
        Centres and patch sizes of lenses.
    resolved : (n,) bool
    pitch : float [px]
    """
    near_zero = np.abs(sizes) <= _NEAR_ZERO * pitch
    return near_zero & (near_zero.any() and sees_little_of_scene(centres, sizes, resolved, pitch))


def repeats_with_neighbours(
    resolved: NDArray[np.bool_],
    rivals: NDArray,
    echoes: NDArray[np.bool_],
    occurring: NDArray[np.bool_],
    rows: NDArray[np.int32],
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that match at another shift as well, as half of the flat or of their neighbours do.

    Their texture repeats; a single one is more likely chance. Which of its shifts is the right one cannot be told from
    which of them matches best: at the right one neighbours may share less, and differ by the shading of their rims.

    Parameters
    ----------
    resolved : (n,) bool
    rivals : (n,)
        Probability of each answer among those that correlate as well.
    echoes : (n,) bool
        Lenses as `has_secondary_peak`.
    occurring : (n,) bool
        Lenses whose depth occurs among those without a rival. It tells for the others where most have none.
    rows : (n, k) int32
        Neighbour rows, -1 where there is none.
    """
    torn = resolved & ((rivals < _HALF) | echoes)
    beside = count_neighbours(torn, rows)
    if 2 * torn.sum() >= resolved.sum():
        return torn | (resolved & (2 * beside >= (rows >= 0).sum(1)))
    together = 2 * beside >= rows.shape[1]
    return torn & together & ((rivals < _TWICE) | echoes) & ~occurring
