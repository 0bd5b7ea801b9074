"""Scenes that are one plane: three numbers for all lenses, checked on every one of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import downsample
from ...flat.lens_graph import count_connected, count_neighbours, dilate_mask, join_opposite, restrict_neighbours
from ...flat.texture import Texture, measure_statistics
from ...runtime.quantiles import median
from ..matching.matcher import MISFIT, Matcher
from ..matching.peaks import confidence, fit_parabola
from ..matching.shortcuts import sample_lenses
from ..presets import Preset
from ..refinement.lens_plane import fit_lens_planes
from ..refinement.pair_fit import PairFits, fit_pairs
from ..validity.uncertainty import signal_share, systematic_error
from .plane_fit import MIN_TEXTURED_SHARE, Plane, fit_plane, has_outlier_cluster, is_nearly_planar

__all__ = [
    "MIN_TEXTURED", "PlaneScene", "add_systematic_error", "correlate_with_plane", "find_plane",
    "normalised_plane_correlation",
]  # fmt: skip

#: Fewer lenses with texture hardly show whether what they see repeats.
MIN_TEXTURED = 40
# About so many lenses tell a plane; of few lenses this share of them, but not fewer than the third number. Fewer than
# the last number tell nothing.
_SAMPLE, _SAMPLE_SHARE, _LEAST_SAMPLE, _TOO_FEW = 60, 1 / 12, 30, 20
# They are searched on a flat made smaller by a whole factor that leaves this pitch [px].
_COARSE = 11.0
# A slanted plane needs so many times as many: three numbers instead of one, of which two are carried to the border.
_SLANTED = 6
# A sample whose slant explains so many times the variance of an independent measurement leaves in doubt whether there
# is none: by chance, one in twenty does.
_DOUBTFUL_TILT = 6.0
# Microimages of a larger pitch than this [px] tell more each, so that fewer of them do, where a slant or few lenses
# cost the most.
_LARGE = 35.0
# Of a plane that faces the camera this share of the lenses are searched to the same patch size, to that of the pitch.
_ALIKE, _NEAR = 0.7, 0.05
# Lenses that seem off the plane to one side by this much [px of the search], so many others beside them, are measured.
_OFF, _TOGETHER = 0.15, 2
# A better match elsewhere, by this much, is another surface, if so many pixels away or with others beside it; so is a
# share of the lenses without any match. Where more than the last number seem to have none, they are not searched for
# it.
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
    correlation: NDArray[np.float32]
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
    if texture.clear.sum() < max(MIN_TEXTURED_SHARE * len(indices), MIN_TEXTURED):
        return None
    pitch, rows = texture.flat.pitch, join_opposite(forward, backward)
    count = int(np.clip(texture.clear.sum() * _SAMPLE_SHARE, _LEAST_SAMPLE, _SAMPLE))
    sample = sample_lenses(indices, _inner(texture, rows), count)
    if sample.sum() < _TOO_FEW:
        return None
    whole = Matcher(texture, forward, backward, setting)
    few = _Few.of(whole.downscaled(texture), forward, backward, sample)
    matcher = few.matcher(setting)
    cost = matcher.costs(matcher.pairs(few.asked), few.asked)
    best = cost.argmin(1)
    if matcher.repeats(cost):
        return None
    found = (matcher.shifts[best] + fit_parabola(cost, best) * matcher.step) * few.coarse
    searched = found.astype(np.float64) * whole.factor
    if not is_nearly_planar(texture.flat.centres[sample].astype(np.float64), searched, pitch):
        return None
    if facing and np.mean(np.abs(searched - np.median(searched)) <= _NEAR * pitch) < _ALIKE:
        return None
    points, sizes = few.measured(found, setting)
    points, sizes = (points + 0.5) * whole.factor - 0.5, sizes * whole.factor
    plane = fit_plane(points, sizes, pitch, facing) if len(sizes) >= _TOO_FEW else None
    if plane is None:
        return None
    paths = 2 * forward.shape[1]
    sure = median(confidence(cost * np.float32(paths), best, paths, matcher.tolerance()))
    about = plane.at(texture.flat.centres.astype(np.float64)).astype(np.float32)
    evidence = correlate_with_plane(whole, texture, about, setting)
    if evidence is None:
        return None
    slanted = plane.slanted or plane.tilt > _DOUBTFUL_TILT
    if slanted or whole.factor > 1:
        more = sample
        if slanted:
            more = sample_lenses(indices, texture.clear, int(_SLANTED * _SAMPLE * min(1.0, _LARGE / pitch) ** 2))
        elif facing:
            more = np.zeros(len(sample), bool)
            more[np.flatnonzero(sample)[:: max(1, round(pitch / _LARGE))]] = True
        few = _Few.of(texture, forward, backward, more)
        # Of so few as the sample a plane that faces the camera may have looked slanted.
        about_few = plane.at(few.texture.flat.centres.astype(np.float64))
        plane = fit_plane(*few.measured(about_few, setting, once=True), pitch, facing)
        if plane is None:
            return None
    plane = add_systematic_error(plane, normalised_plane_correlation(whole, texture, about, evidence)[texture.clear])
    return PlaneScene(plane, sure, evidence, float(sample.mean()))


@dataclass(frozen=True)
class _Few:
    """Some lenses and those beside them, as if there were no others.

    Parameters
    ----------
    texture : Texture
    forward, backward : (m, d) int32
        As for `find_plane`.
    asked : (m,) bool
        Those that are not there for the others alone.
    """

    texture: Texture
    forward: NDArray[np.int32]
    backward: NDArray[np.int32]
    asked: NDArray[np.bool_]

    @classmethod
    def of(
        cls, texture: Texture, forward: NDArray[np.int32], backward: NDArray[np.int32], asked: NDArray[np.bool_]
    ) -> _Few:
        """The lenses `asked` (n,) of all."""
        rows = np.flatnonzero(dilate_mask(asked, join_opposite(forward, backward)))
        return cls(
            texture.select(rows), restrict_neighbours(rows, forward), restrict_neighbours(rows, backward), asked[rows]
        )

    @property
    def coarse(self) -> int:
        """How many pixels of the flat, each way, become one where they are matched."""
        return max(1, int(self.texture.flat.pitch / _COARSE))

    def matcher(self, setting: Preset) -> Matcher:
        """What tells their shifts to a fraction of a pixel of the flat."""
        texture, factor = self.texture, self.coarse
        if factor > 1:
            flat = downsample(texture.flat, factor)
            texture = replace(texture, flat=flat, statistics=measure_statistics(flat), noise=texture.noise / factor)
            setting = replace(setting, row_step=1)
        return Matcher(texture, self.forward, self.backward, replace(setting, search_pitch=np.inf))

    def measured(
        self, sizes: NDArray, setting: Preset, once: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Scene points and patch sizes, as `_places`, from the pairs of the lenses asked.

        Their `sizes` (m,), or those of all, are nearly known. With `once` they are measured with the neighbours in
        `forward` alone: those behind see nearly the same.
        """
        start, forward = np.full(len(self.asked), np.nan, np.float32), self.forward
        start[self.asked if len(sizes) < len(start) else slice(None)] = sizes
        if once:
            forward = np.where(self.asked[:, None], forward, -1)
        return _places(_pairs(self.texture, forward, start, setting), self.texture, forward)


def _inner(texture: Texture, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: lenses with texture none of whose neighbours (n, k) is blank: the others have few pairs that match."""
    return texture.clear & (count_neighbours(texture.clear | texture.faint, rows) == (rows >= 0).sum(1))


def _pairs(texture: Texture, forward: NDArray[np.int32], start: NDArray[np.float32], setting: Preset) -> PairFits:
    """Sub-pixel patch size of all pairs of the lenses with a first value."""
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    return fit_pairs(texture.flat, forward, start, scale, texture.noise, setting.iterations, setting.last_step)


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


def correlate_with_plane(
    matcher: Matcher, texture: Texture, about: NDArray[np.float32], setting: Preset
) -> NDArray[np.float32] | None:
    """(n,) correlation of every lens at the plane's shift; None where a lens shows something else."""
    everyone = texture.clear | texture.faint
    cost, off, _ = matcher.probe(everyone, (about / matcher.factor).astype(np.float32))
    limit = min(max(_USUAL * median(cost[texture.clear]), MISFIT), _WORST)
    misfits = texture.clear & (cost > limit)
    rows = matcher.rows
    inner = _inner(texture, rows)
    if not inner.any() or misfits[inner].mean() > _DOUBTFUL:
        return None
    if misfits.any():
        few = _Few.of(matcher.downscaled(texture), matcher.forward, matcher.backward, misfits)
        elsewhere, far, misfits = _searched(few, matcher.factor, setting, misfits, about, limit)
        together = count_connected(elsewhere, rows)
        if (far & inner).any() or (elsewhere & inner & (together > 0)).any() or (together >= _TOGETHER).any():
            return None
        if misfits[inner].mean() > _MISFITS:
            return None
    doubtful = np.zeros(len(off), bool)
    for side in (-1, 1):
        doubtful |= count_connected(texture.clear & ~misfits & (side * off > _OFF), rows) >= _TOGETHER
    if doubtful.any():
        doubtful |= (doubtful[rows] & (rows >= 0)).any(1)
        start = np.where(doubtful, about, np.nan).astype(np.float32)
        pairs = _pairs(texture, matcher.forward, start, setting)
        lenses = fit_lens_planes(texture.flat, matcher.forward, matcher.backward, pairs, start)
        if has_outlier_cluster((lenses.patch_size - about).astype(float), lenses.standard_error.astype(float), rows):
            return None
    return 1 - cost


def _searched(
    few: _Few, factor: int, setting: Preset, misfits: NDArray[np.bool_], about: NDArray[np.float32], limit: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of the lenses (n,) that seem to misfit a plane match better elsewhere, which of them far from it, and which
    do not match at the plane either, when they are searched at all shifts.

    The search tries other pairs than the probe, so that only what it finds itself can be compared. The `few` are on a
    flat `factor` times as small as that which the plane is `about`.
    """
    matcher, factor = few.matcher(setting), factor * few.coarse
    full = matcher.costs(matcher.pairs(few.asked), few.asked)
    away = np.abs(matcher.shifts - about[misfits, None] / factor)
    near = away <= matcher.step
    # Between the two shifts beside the plane; none is where the plane lies beyond those that are searched.
    share = np.where(near, matcher.step - away, 0)
    own = (full * share).sum(1) / np.maximum(share.sum(1), np.float32(1e-6))
    there = np.where(near, np.inf, full)
    best, least = there.argmin(1), there.min(1)
    better = (least < own - _BETTER) & (least < limit)
    elsewhere, far, unmatched = np.zeros((3, len(misfits)), bool)
    elsewhere[misfits] = better
    far[misfits] = better & (away[np.arange(len(best)), best] * factor > _FAR)
    unmatched[misfits] = np.where(near, full, np.inf).min(1) > limit
    return elsewhere, far, unmatched


def normalised_plane_correlation(
    matcher: Matcher, texture: Texture, about: NDArray[np.float32], evidence: NDArray[np.float32]
) -> NDArray:
    """(n,) share of the texture of each lens that its match at the plane's shift explains, noise apart."""
    trust = np.interp(about / matcher.factor, matcher.shifts, matcher.trust)
    return np.asarray(evidence / trust / signal_share(texture))


def add_systematic_error(plane: Plane, explained: NDArray) -> Plane:
    """The plane with what the texture that its matches leave unexplained may have done to the lenses (m,) of it."""
    if not explained.size:
        return plane
    return replace(plane, systematic_error=float(systematic_error(plane.scatter, np.median(explained))))
