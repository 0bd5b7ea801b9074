"""Which lenses are resolved, the reason why the others are not, errors and confidence: from
matches, fits, neighbours.

Normalised correlations are over what a correct match reaches with this noise and overlap.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_similar
from ...flat.shading import LARGEST_SHADING
from ...flat.texture import Texture
from ..matching.matcher import MatchResult
from ..same_surface import TOLERANCE, same_surface

__all__ = [
    "LEAST_CORRELATION",
    "RESOLVABLE",
    "SHADING_REACH",
    "SURE",
    "classify_lenses",
    "correlates_poorly",
    "inflate_errors",
    "looks_like_shading",
    "match_proves_texture",
    "match_suggests_texture",
    "occurs_among",
    "shift_exceeds_shading",
    "signal_share",
]

#: [pitch] beyond this patch size neighbouring microimages share too little.
RESOLVABLE = 0.75
#: Confidence and uniqueness of resolved lenses, and the factor of a confidence in doubt.
SURE = 0.5
#: Correlation of a match that proves faint texture; of lenses without any one in a hundred has this
#: and `_PROVEN`.
LEAST_CORRELATION = 0.12
_PROVEN = 0.95
#: [pitch] shading matches at smaller patch sizes too.
SHADING_REACH = 0.2
# [pitch] neighbours at the same depth; half of it for one depth anywhere.
_SAME = 1.5 * TOLERANCE
# Correlation below which a lens shares no content with its neighbours, and that unrelated content
# reaches somewhere.
_SHARED = 0.25
_BY_CHANCE = 0.4

# Number of neighbours of each lens, among some (n,), with its patch size to a gap [pitch].
_Similar = Callable[..., NDArray[np.int64]]


def classify_lenses(
    textured: NDArray[np.bool_],
    match: MatchResult,
    refined: NDArray,
    error: NDArray,
    signal: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
) -> tuple[NDArray[np.int8], NDArray, NDArray]:
    """Reason, standard error and confidence of every lens, as `DepthMap`.

    Of `textured` lenses (n,) by their match, their sub-pixel patch sizes `refined` with standard
    `error` (n,) [px], their `signal_share` (n,), and the rows (n, k) of their neighbours.
    """

    def similar(among: NDArray[np.bool_], gap: float = _SAME) -> NDArray[np.int64]:
        return count_similar(among, refined, neighbours, gap * pitch)

    size = np.abs(refined)
    unsure = match.confidence < SURE
    # Of large patch sizes and faint matches pairs, or two neighbours, must agree; at the border,
    # where a lens has few pairs, one neighbour must confirm what they agree on.
    agree = error <= 0.5 * TOLERANCE * pitch
    confirmed = similar(agree, TOLERANCE) > np.where(agree, 0, 1)
    agree = (agree & (neighbours >= 0).all(1)) | confirmed
    hardly = (size > 0.6 * pitch) | (match.correlation < LEAST_CORRELATION)
    unshared = (
        (size > RESOLVABLE * pitch) | (unsure & (match.correlation < _SHARED)) | (hardly & ~agree)
    )
    reason = np.select([~textured, unshared, unsure], [1, 3, 2], 0).astype(np.int8)
    # Lenses that share too few pixels for a fit, and have no neighbour at their depth: the search
    # alone prefers shifts at which more pixels are shared.
    measured = np.isfinite(error)
    reason[(reason == 0) & ~measured & (similar(measured) == 0)] = 2
    reason[_may_match_by_chance(reason == 0, match, refined, signal, similar, pitch)] = 3
    error = inflate_errors(error, match.normalised_correlation / signal)
    sure = np.where(textured, np.minimum(match.confidence, match.uniqueness), 0)
    # Pairs of unrelated content have this standard error.
    unrelated = 0.035 * pitch
    return (
        reason,
        error,
        sure / (1 + (np.where(np.isfinite(error), error, unrelated) / unrelated) ** 2),
    )


def _may_match_by_chance(
    resolved: NDArray[np.bool_],
    match: MatchResult,
    refined: NDArray,
    signal: NDArray,
    similar: _Similar,
    pitch: float,
) -> NDArray[np.bool_]:
    """Lenses that match no better than unrelated content may, without two better neighbours at
    their depth.

    Unless most lenses match better, and some of those at that depth.
    """
    sure = resolved & (match.correlation >= _BY_CHANCE)
    if 2 * sure.sum() > resolved.sum():
        resolved = resolved & ~occurs_among(refined, refined[sure], 0.5 * _SAME * pitch)
    better = resolved & (match.correlation >= _SHARED * signal)
    return resolved & (match.correlation < _BY_CHANCE) & (similar(better) <= 1)


def signal_share(texture: Texture) -> NDArray:
    """(n,) share of the variance of each lens that is not noise: the largest correlation of a
    correct match.
    """
    noise = np.minimum(texture.noise / np.maximum(texture.statistics.contrast, 1e-12), 1)
    return np.asarray(np.maximum(1 - noise**2, LEAST_CORRELATION))


def inflate_errors(error: NDArray, correlation: NDArray) -> NDArray:
    """(n,) standard errors [px], with what all pairs of a lens have wrong in common, by the
    normalised `correlation` (n,).
    """
    return np.hypot(0.95, 2.7 * (1 - np.clip(correlation, 0, 0.999))) * error


def correlates_poorly(correlation: NDArray, signal: NDArray, resolved: NDArray[np.bool_]) -> bool:
    """Whether most `resolved` lenses (n,) of little noise match far worse than they could: depths
    are likely wrong.

    Medians of the normalised `correlation` (n,) are 0.58 on captures, 0.3 to 0.75 on periodic
    textures.
    """
    clear = resolved & (signal >= 0.8)
    return bool(2 * clear.sum() >= max(resolved.sum(), 1) and np.median(correlation[clear]) < 0.55)


def occurs_among(values: NDArray, known: NDArray, gap: float) -> NDArray[np.bool_]:
    """Which `values` occur among the `known` ones, in a two-hundredth of the lenses, within `gap`;
    false matches do not.
    """
    least = max(1, int(np.ceil(0.005 * len(known))))
    ordered = np.append(np.sort(known), np.full(least, np.inf, known.dtype))
    return np.asarray(
        ordered[np.searchsorted(ordered[:-least], values - gap) + least - 1] < values + gap
    )


def shift_exceeds_shading(
    refined: NDArray, error: NDArray, neighbours: NDArray[np.int32], pitch: float
) -> NDArray[np.bool_]:
    """Lenses whose pairs agree on a shift, together with their neighbours; shading, which stays
    with its lens, has none. Smaller shifts than 0.005 pitches may be errors of the lattice.
    """
    rows = np.column_stack([np.arange(len(refined)), neighbours])
    sizes = refined[rows]
    variance = np.where(rows >= 0, np.square(error[rows]), np.inf)
    like = same_surface(sizes, refined[:, None], 3 * error[:, None]) & np.isfinite(variance)
    weight = np.where(like, 1 / np.maximum(variance, 1e-12), 0)
    total = np.maximum(weight.sum(1), 1e-12)
    mean = (weight * sizes).sum(1) / total
    # Neighbours share pairs: half of their variance is common to all.
    spread = np.sqrt(0.5 * (1 + like.sum(1)) / total)
    # It differs from zero by eight standard errors.
    agree = (spread <= 0.002 * pitch) & (np.abs(mean) >= 8 * spread)
    return np.asarray(agree & (np.abs(mean) >= 0.005 * pitch))


def looks_like_shading(
    clear: NDArray[np.bool_], match: MatchResult, contrast: NDArray[np.float32], pitch: float
) -> NDArray[np.bool_]:
    """Those of the `clear` lenses that show no more than shading may: little contrast (white = 1),
    near zero.

    Toward its border the main lens cuts microimages, each a little differently, so that no average
    of others removes it. A depth near zero that occurs among the other lenses is the scene's.
    """
    size = match.patch_size
    little = clear & (contrast <= LARGEST_SHADING) & (np.abs(size) < SHADING_REACH * pitch)
    return np.asarray(little & ~occurs_among(size, size[clear & ~little], 0.5 * _SAME * pitch))


def match_suggests_texture(match: MatchResult) -> NDArray[np.bool_]:
    """Lenses whose match would prove texture if it were not near zero."""
    return (match.confidence >= _PROVEN) & (match.correlation >= LEAST_CORRELATION)


def match_proves_texture(match: MatchResult, pitch: float) -> NDArray[np.bool_]:
    """Lenses whose match alone proves that they have texture; near zero, where shading matches too,
    a better one.
    """
    far = np.abs(match.patch_size) >= SHADING_REACH * pitch
    return match_suggests_texture(match) & (far | (match.correlation >= 0.5))
