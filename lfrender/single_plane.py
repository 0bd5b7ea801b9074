"""Scenes that are one plane: three numbers for all lenses, checked on every one of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .certainty import misled, signal_share
from .modes import confidence, parabola_peak
from .neighbours import around, beside
from .plane import TEXTURED, Plane, fit_plane, nearly_planar, strays
from .refinement import PairFits, fit_pairs
from .search import MISFIT, Matcher, Preset
from .skipping import sample_lenses
from .slant import fit_lenses
from .texture import Texture

__all__ = ["PROBE", "PlaneScene", "explained_by_plane", "find_plane", "plane_evidence", "vertex", "with_misled"]

# About so many lenses tell a plane; of few lenses this share of them, but not fewer than the third number. Fewer than
# the last number tell nothing, nor do so many lenses with texture: they hardly show whether what they see repeats.
_SAMPLE, _SAMPLE_SHARE, _LEAST_SAMPLE, _TOO_FEW = 60, 1 / 12, 30, 20
_FEWEST = 100
# A slanted plane needs so many times as many: three numbers instead of one, of which two are carried to the border.
_SLANTED = 4
# Of a plane that faces the camera this share of the lenses are searched to the same patch size, to that of the pitch.
_ALIKE, _NEAR = 0.7, 0.05
# Three shifts this far apart [px of the search] tell for each lens whether it, too, has its optimum there. Lenses that
# are off to one side by the second number together with others beside them are measured.
PROBE, _OFF, _TOGETHER = 0.75, 0.25, 2
# A better match elsewhere, by this much, is another surface, if by so many pixels of the search or with others beside
# it; so is a share of the lenses without any match. Where more than the last number seem to have none, they are not
# searched for it.
_BETTER, _FAR, _MISFITS, _DOUBTFUL = 0.15, 2.0, 0.05, 0.15
# Noise and little overlap make all matches worse: a misfit is so many times as bad as the usual lens, but at most this.
_USUAL, _WORST = 2.0, 0.6


@dataclass(frozen=True)
class PlaneScene:
    """A flat that shows one plane.

    Parameters
    ----------
    plane : Plane
    confidence : float
        0..1, of the lenses that show it.
    evidence : (n,) float32
        Correlation of each lens with its neighbours there, 0..1.
    sampled : float
        Share of the lenses that were matched at all shifts.
    """

    plane: Plane
    confidence: float
    evidence: NDArray[np.float32]
    sampled: float


def find_plane(
    texture: Texture,
    indices: NDArray[np.int64],
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    setting: Preset,
    facing: bool = False,
) -> PlaneScene | None:
    """The one plane that the flat shows, None where there are several depths or it cannot be told.

    Parameters
    ----------
    texture : Texture
        Shading may be left in.
    indices : (n, 2) int
        Of the lenses on the lattice.
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    setting : Preset
    facing : bool
        Only a plane that faces the camera will do.
    """
    if texture.clear.sum() < max(TEXTURED * len(indices), _FEWEST):
        return None
    matcher = Matcher(texture, forward, backward, setting)
    inner = _inner(texture, matcher.rows)
    count = int(np.clip(texture.clear.sum() * _SAMPLE_SHARE, _LEAST_SAMPLE, _SAMPLE))
    sample = sample_lenses(indices, inner, count)
    if sample.sum() < _TOO_FEW:
        return None
    pitch = texture.flat.pitch
    cost = matcher.costs(matcher.pairs(sample), sample)
    best = cost.argmin(1)
    if matcher.repeats(cost):
        return None
    start = np.full(len(indices), np.nan, np.float32)
    start[sample] = (matcher.shifts[best] + parabola_peak(cost, best) * matcher.step) * matcher.factor
    if not nearly_planar(texture.flat.centres[sample].astype(np.float64), start[sample].astype(np.float64), pitch):
        return None
    if facing and np.mean(np.abs(start[sample] - np.median(start[sample])) <= _NEAR * pitch) < _ALIKE:
        return None
    points, sizes = _places(_pairs(texture, forward, start, setting), texture, forward)
    plane = fit_plane(points, sizes, pitch) if len(sizes) >= _TOO_FEW else None
    if plane is None or (facing and plane.slanted):
        return None
    about = plane.at(texture.flat.centres.astype(np.float64)).astype(np.float32)
    evidence = plane_evidence(matcher, texture, about, setting)
    if evidence is None:
        return None
    if plane.slanted:
        more = sample_lenses(indices, texture.clear, _SLANTED * _SAMPLE)
        start = np.where(more, about, np.nan).astype(np.float32)
        # Of so few as the sample a plane that faces the camera may have looked slanted.
        points, sizes = _places(_pairs(texture, forward, start, setting), texture, forward)
        plane = fit_plane(points, sizes, pitch)
        if plane is None:
            return None
    plane = with_misled(plane, explained_by_plane(matcher, texture, about, evidence)[texture.clear])
    paths = 2 * forward.shape[1]
    sure = float(np.median(confidence(cost * np.float32(paths), best, paths, matcher.tolerance())))
    return PlaneScene(plane, sure, evidence, float(sample.mean()))


def _inner(texture: Texture, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: lenses with texture none of whose neighbours (n, k) is blank: the others have few pairs that match."""
    return texture.clear & (around(texture.clear | texture.faint, rows) == (rows >= 0).sum(1))


def _pairs(texture: Texture, forward: NDArray[np.int32], start: NDArray[np.float32], setting: Preset) -> PairFits:
    """Sub-pixel patch size of all pairs of the lenses with a first value."""
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    return fit_pairs(texture.flat, forward, start, scale, texture.noise, setting.iterations)


def _places(
    pairs: PairFits, texture: Texture, forward: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scene points (m, 2) [px] where pairs of lenses with texture have measured a patch size, and these (m,) [px]."""
    clear, gray = texture.clear, texture.flat
    lens, d = np.nonzero(np.isfinite(pairs.patch_size[:, :, 0]) & clear[:, None] & clear[forward])
    sizes = pairs.patch_size[lens, d, 0].astype(np.float64)
    here, there = gray.centres[lens].astype(np.float64), gray.centres[forward[lens, d]].astype(np.float64)
    # The middle between both microimages shows the middle between their centres, less its share of the scene.
    stretch = gray.pitch / np.where(sizes == 0, np.inf, sizes)
    return 0.5 * (here + there) - pairs.place[lens, d, 0] * stretch[:, None], sizes


def plane_evidence(
    matcher: Matcher, texture: Texture, about: NDArray[np.float32], setting: Preset
) -> NDArray[np.float32] | None:
    """(n,) correlation of every lens at the plane's shift; None where a lens shows something else."""
    everyone = texture.clear | texture.faint
    probes = (PROBE * np.array([-1, 0, 1])).astype(np.float32)
    cost = matcher.probe(everyone, probes, (about / matcher.factor).astype(np.float32))
    limit = np.clip(_USUAL * np.median(cost[texture.clear, 1]), MISFIT, _WORST)
    misfits = texture.clear & (cost[:, 1] > limit)
    rows = matcher.rows
    inner = _inner(texture, rows)
    if not inner.any() or misfits[inner].mean() > _DOUBTFUL:
        return None
    if misfits.any():
        elsewhere, far, misfits = _searched(matcher, misfits, about, float(limit))
        together = beside(elsewhere, rows)
        if (far & inner).any() or (elsewhere & inner & (together > 0)).any() or (together >= _TOGETHER).any():
            return None
        if misfits[inner].mean() > _MISFITS:
            return None
    off = vertex(cost) * PROBE
    doubtful = np.zeros(len(off), bool)
    for side in (-1, 1):
        doubtful |= beside(texture.clear & ~misfits & (side * off > _OFF), rows) >= _TOGETHER
    if doubtful.any():
        doubtful |= (doubtful[rows] & (rows >= 0)).any(1)
        start = np.where(doubtful, about, np.nan).astype(np.float32)
        pairs = _pairs(texture, matcher.forward, start, setting)
        lenses = fit_lenses(texture.flat, matcher.forward, matcher.backward, pairs, start)
        if strays((lenses.patch_size - about).astype(float), lenses.standard_error.astype(float), rows):
            return None
    return (1 - cost[:, 1]).astype(np.float32)


def _searched(
    matcher: Matcher, misfits: NDArray[np.bool_], about: NDArray[np.float32], limit: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of the lenses (n,) that seem to misfit a plane match better elsewhere, which of them far from it, and which
    do not match at the plane either, when they are searched at all shifts.

    The search tries other pairs than the probe, so that only what it finds itself can be compared.
    """
    full = matcher.costs(matcher.pairs(misfits), misfits)
    away = np.abs(matcher.shifts - about[misfits, None] / matcher.factor)
    near = away <= matcher.step
    # Between the two shifts beside the plane; none is where the plane lies beyond those that are searched.
    share = np.where(near, matcher.step - away, 0)
    own = (full * share).sum(1) / np.maximum(share.sum(1), np.float32(1e-6))
    there = np.where(near, np.inf, full)
    best, least = there.argmin(1), there.min(1)
    better = (least < own - _BETTER) & (least < limit)
    elsewhere, far, unmatched = np.zeros((3, len(misfits)), bool)
    elsewhere[misfits] = better
    far[misfits] = better & (away[np.arange(len(best)), best] > _FAR)
    unmatched[misfits] = np.where(near, full, np.inf).min(1) > limit
    return elsewhere, far, unmatched


def explained_by_plane(
    matcher: Matcher, texture: Texture, about: NDArray[np.float32], evidence: NDArray[np.float32]
) -> NDArray:
    """(n,) share of the texture of each lens that its match at the plane's shift explains, noise apart."""
    trust = np.interp(about / matcher.factor, matcher.shifts, matcher.trust)
    return np.asarray(evidence / trust / signal_share(texture))


def with_misled(plane: Plane, explained: NDArray) -> Plane:
    """The plane with what the texture that its matches leave unexplained may have done to the lenses (m,) of it."""
    return replace(plane, misled=float(misled(plane.scatter, np.median(explained)))) if explained.size else plane


def vertex(cost: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) where the parabola through three costs has its least value, in steps from the middle, at most 1 away."""
    bend = cost[:, 0] - 2 * cost[:, 1] + cost[:, 2]
    tilt = 0.5 * (cost[:, 0] - cost[:, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bend > 1e-6, np.clip(tilt / bend, -1, 1), np.sign(tilt)).astype(np.float32)
