"""Which lenses are resolved, and why the others are not: from what each measures, and those around it."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ...flat.lens_graph import count_similar
from ...flat.shading import MAX_SHADING_CONTRAST
from ..matching.matcher import MatchResult
from .uncertainty import (
    combine_confidence,
    confirmed_by_neighbours,
    has_secondary_peak,
    inflate_errors,
    repeats_with_neighbours,
    sees_same_content,
)

__all__ = [
    "AGREED",
    "LEAST_EVIDENCE",
    "RESOLVABLE",
    "SHADED_REACH",
    "SURE",
    "classify_lenses",
    "initial_reasons",
    "looks_like_shading",
    "match_proves_texture",
    "match_suggests_texture",
    "occurs_among",
    "shift_exceeds_shading",
    "shift_may_be_zero",
]  # fmt: skip

# Beyond this share of the pitch neighbouring microimages share too little to tell (GEOMETRY.md).
RESOLVABLE = 0.75
SURE = 0.5
# A second depth is one where this share of the lenses has its first: a depth that no lens sees alone is more likely a
# false match.
_POPULATED = 0.005
# Faint texture is believed when the answer is this sure and the lens itself correlates this much there: of lenses
# without texture one in a hundred does.
_PROVEN, LEAST_EVIDENCE = 0.95, 0.12
# Shading correlates as well, with a patch size near zero: within this share of the pitch it takes more.
SHADED_REACH, _EVIDENCE_NEAR_ZERO = 0.2, 0.5
# Shading stays with its lens, but for errors of the lattice [share of the pitch]. A shift beyond these, of so many
# standard errors, and on which pairs agree to the second share of the pitch, is texture.
_STILL, _FIRM, _BEYOND_ERRORS = 0.005, 0.002, 8.0
# A lens with texture that correlates less than this with its neighbours at any shift shares no content with them.
_SHARED = 0.25
# One whose contrast is so little over the noise as this share of its square tells, five times, and that correlates with
# nothing, shows the coding of the file or what is left of the shading rather than content that neighbours do not share.
_FAINT_SIGNAL = 1 - 1 / 5**2
# Unrelated content reaches this correlation at some shift; neighbours that do agree to this share of the pitch only
# where it is no chance.
_BY_CHANCE, _ALIKE = 0.4, 0.06
# Beyond this share of the pitch, and with less correlation than faint texture must have, a match is believed when its
# pairs agree to the second share: of content beyond what neighbours share, each pair makes its own false match.
_HARDLY_SHARED, AGREED = 0.6, 0.02


def classify_lenses(
    textured: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    error: NDArray,
    signal: NDArray[np.float32],
    centres: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
) -> tuple[NDArray[np.int8], NDArray, NDArray]:
    """Reason, standard error and confidence of every lens, as `DepthMap`, from what it and those around it measure.

    `signal` (n,) is the share of the contrast squared that is no noise: what a right match may correlate at best.
    """
    reason = initial_reasons(textured, found, refined, _agreed(refined, error, neighbours, pitch), pitch)
    reason[(reason == 0) & _unmeasured(refined, error, neighbours, pitch)] = 2
    reason[_by_chance(reason == 0, found, refined, signal, neighbours, pitch)] = 3
    explained = found.normalised_correlation / signal
    beside = confirmed_by_neighbours(reason == 0, refined, explained, neighbours, pitch)
    reason[(reason > 1) & beside & (np.abs(refined) <= RESOLVABLE * pitch)] = 0
    same = sees_same_content(centres, refined, reason == 0, pitch)
    echoes = has_secondary_peak(found.primary_peak, found.secondary_peak, signal, same)
    single = (reason == 0) & (found.uniqueness >= SURE) & ~echoes
    occurring = occurs_among(refined, refined[single], 0.5 * _ALIKE * pitch)
    reason[repeats_with_neighbours(reason == 0, found.uniqueness, echoes, occurring, neighbours)] = 2
    faint = (reason > 1) & (found.correlation < _SHARED) & (signal < _FAINT_SIGNAL)
    reason[faint] = 1
    error = inflate_errors(error, explained)
    sure = np.where(textured & ~faint, np.minimum(found.confidence, found.uniqueness), 0)
    return reason, error, combine_confidence(sure, refined, error, explained, neighbours, pitch)


def _agreed(refined: NDArray, error: NDArray, neighbours: NDArray[np.int32], pitch: float) -> NDArray[np.bool_]:
    """Lenses whose pairs agree, and those that two such lenses beside them confirm.

    At the border, where a lens has few pairs, a lens beside it must confirm what they agree on.
    """
    agreed = error <= AGREED * pitch
    confirm = count_similar(agreed, refined, neighbours, 2 * AGREED * pitch)
    whole = (neighbours >= 0).all(1)
    return np.asarray((agreed & whole) | (confirm >= np.where(agreed, 1, 2)))


def _unmeasured(refined: NDArray, error: NDArray, neighbours: NDArray[np.int32], pitch: float) -> NDArray[np.bool_]:
    """Lenses that share too few pixels with any other to be measured on them, and beside which none at their depth is.

    The search alone is biased toward shifts at which more pixels are shared.
    """
    measured = np.isfinite(error)
    if measured.all():
        return ~measured
    return np.asarray(~measured & (count_similar(measured, refined, neighbours, _ALIKE * pitch) == 0))


def _by_chance(
    resolved: NDArray[np.bool_],
    found: MatchResult,
    refined: NDArray,
    signal: NDArray[np.float32],
    neighbours: NDArray[np.int32],
    pitch: float,
) -> NDArray[np.bool_]:
    """Lenses that match no better than unrelated content may, without two better ones beside them at their depth.

    `signal` (n,) is the share of the contrast squared that is no noise: what a right match may correlate at best.
    Where most lenses match better than that, neighbours do share what they show, and depths that occur among those are
    believed of the others.
    """
    sure = resolved & (found.correlation >= _BY_CHANCE)
    if 2 * sure.sum() > resolved.sum():
        resolved = resolved & ~occurs_among(refined, refined[sure], 0.5 * _ALIKE * pitch)
    better = resolved & (found.correlation >= _SHARED * signal)
    like = count_similar(better, refined, neighbours, _ALIKE * pitch)
    return np.asarray(resolved & (found.correlation < _BY_CHANCE) & (like < 2))


def initial_reasons(
    textured: NDArray[np.bool_], found: MatchResult, refined: NDArray, agreed: NDArray[np.bool_], pitch: float
) -> NDArray[np.int8]:
    """(n,) int8: as `DepthMap.reason`, 0 where the lens is resolved."""
    unsure = found.confidence < SURE
    little = found.correlation < _SHARED
    hardly = (np.abs(refined) > _HARDLY_SHARED * pitch) | (found.correlation < LEAST_EVIDENCE)
    apart = (np.abs(refined) > RESOLVABLE * pitch) | (unsure & little) | (hardly & ~agreed)
    return np.select([~textured, apart, unsure], [1, 3, 2], 0).astype(np.int8)


@njit(cache=True, nogil=True, parallel=True)
def _have_like(values, ordered, gap, least, out):
    for k in prange(len(values)):
        # As numpy's, which takes one after the other. No comparison holds of NaN.
        last = np.searchsorted(ordered, values[k] - gap) + least - 1
        out[k] = last < len(ordered) and ordered[last] < values[k] + gap


def occurs_among(values: NDArray[np.float32], known: NDArray[np.float32], gap: float) -> NDArray[np.bool_]:
    """Which `values` have their like among `known`, within `gap`; the false matches of a periodic texture have not."""
    ordered = np.sort(known)
    like = np.empty(len(values), bool)
    least = max(1, int(np.ceil(_POPULATED * len(ordered))))
    _have_like(values, ordered, ordered.dtype.type(gap), least, like)
    return like


def shift_exceeds_shading(refined: NDArray, error: NDArray, pitch: float) -> NDArray[np.bool_]:
    """Lenses whose pairs agree on a shift that shading, which stays with its lens, cannot have."""
    size = np.abs(refined)
    agreed = (error <= _FIRM * pitch) & ~shift_may_be_zero(refined, error)
    return np.asarray(agreed & (size >= _STILL * pitch))


def shift_may_be_zero(refined: NDArray, error: NDArray) -> NDArray[np.bool_]:
    """Lenses whose shift may be none, for all that their pairs tell."""
    return np.asarray(np.abs(refined) < _BEYOND_ERRORS * error)


def looks_like_shading(
    clear: NDArray[np.bool_], found: MatchResult, contrast: NDArray[np.float32], pitch: float
) -> NDArray[np.bool_]:
    """Those of the `clear` lenses that show no more than shading may: little contrast (white = 1), near zero.

    Toward the border of a flat the main lens cuts microimages, each a little differently, so that no average of others
    removes it. A depth near zero that occurs among the other lenses is the scene's.
    """
    size = found.patch_size
    little = clear & (contrast <= MAX_SHADING_CONTRAST) & (np.abs(size) < SHADED_REACH * pitch)
    return np.asarray(little & ~occurs_among(size, size[clear & ~little], 0.5 * _ALIKE * pitch))


def match_proves_texture(found: MatchResult, pitch: float) -> NDArray[np.bool_]:
    """Lenses whose match alone proves that they carry texture."""
    near_zero = np.abs(found.patch_size) < SHADED_REACH * pitch
    enough = np.where(near_zero, _EVIDENCE_NEAR_ZERO, LEAST_EVIDENCE)
    return (found.confidence >= _PROVEN) & (found.correlation >= enough)


def match_suggests_texture(found: MatchResult) -> NDArray[np.bool_]:
    """Lenses whose match is as sure as one that proves texture, if not as near."""
    return (found.confidence >= _PROVEN) & (found.correlation >= LEAST_EVIDENCE)
