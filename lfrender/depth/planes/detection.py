"""Detection of scenes that are one plane: measured on a sparse sample of lenses, checked on all of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import downsample
from ...flat.lens_graph import count_connected, count_neighbours, dilate_mask, join_opposite, restrict_neighbours
from ...flat.texture import Texture, measure_statistics
from ...runtime.quantiles import median
from ..matching.matcher import Matcher
from ..matching.peaks import confidence, fit_parabola
from ..matching.shortcuts import sample_lenses
from ..presets import Preset
from ..refinement.lens_plane import fit_lens_planes
from ..refinement.pair_fit import PairFits, fit_pairs
from ..validity.uncertainty import signal_share, systematic_error
from .plane_fit import Plane, fit_plane, has_outlier_cluster, is_nearly_planar
from .settings import DETECTION, PLANE, DetectionSettings

__all__ = [
    "PlaneScene", "add_systematic_error", "correlate_with_plane", "find_plane", "normalised_plane_correlation",
]  # fmt: skip


@dataclass(frozen=True)
class PlaneScene:
    """A flat that shows one plane."""

    plane: Plane
    confidence: float  # 0..1, of the lenses that show it
    correlation: NDArray[np.float32]  # (n,) correlation of each lens with its neighbours there, 0..1
    sampled: float  # share of the lenses that were matched at all shifts


def find_plane(
    texture: Texture,
    indices: NDArray[np.int64],
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    preset: Preset,
    facing: bool = False,
    settings: DetectionSettings = DETECTION,
) -> PlaneScene | None:
    """The one plane that the flat shows; None where there are several depths or it cannot be decided.

    Shading of the `texture` need not be removed. `indices` (n, 2) are those of the lenses on the lattice, `forward` and
    `backward` (n, d) their neighbour rows in `d` directions and the opposites. With `facing` only a plane that faces
    the camera is accepted.
    """
    if texture.clear.sum() < max(PLANE.min_textured_share * len(indices), settings.min_textured):
        return None
    inner = _inner(texture, join_opposite(forward, backward))
    count = int(np.clip(texture.clear.sum() * settings.sample_share, settings.min_sample, settings.sample))
    sample = sample_lenses(indices, inner, count)
    if sample.sum() < settings.min_measured:
        return None
    whole = Matcher(texture, forward, backward, preset)
    found = _fit_sample(whole, texture, sample, preset, facing, settings)
    if found is None:
        return None
    plane, sure = found
    expected = plane.at(texture.flat.centres.astype(np.float64)).astype(np.float32)
    correlation = correlate_with_plane(whole, texture, expected, preset, settings)
    if correlation is None:
        return None
    refined = _refine_plane(plane, whole, texture, indices, sample, preset, facing, settings)
    if refined is None:
        return None
    explained = normalised_plane_correlation(whole, texture, expected, correlation)[texture.clear]
    return PlaneScene(add_systematic_error(refined, explained), sure, correlation, float(sample.mean()))


def _fit_sample(
    whole: Matcher,
    texture: Texture,
    sample: NDArray[np.bool_],
    preset: Preset,
    facing: bool,
    settings: DetectionSettings,
) -> tuple[Plane, float] | None:
    """A plane through the lenses of a `sample` (n,), and the confidence of their matches; None if there is none."""
    pitch = texture.flat.pitch
    few = _Subset.of(whole.downscaled(texture), whole.forward, whole.backward, sample, settings)
    matcher = few.matcher(preset)
    cost = matcher.lens_costs(matcher.pair_costs(few.selected), few.selected)
    best = cost.argmin(1)
    if matcher.is_periodic(cost):
        return None
    found = (matcher.shifts[best] + fit_parabola(cost, best) * matcher.step) * few.factor
    searched = found.astype(np.float64) * whole.factor
    if not is_nearly_planar(texture.flat.centres[sample].astype(np.float64), searched, pitch):
        return None
    same = np.abs(searched - np.median(searched)) <= settings.facing_spread * pitch
    if facing and np.mean(same) < settings.facing_share:
        return None
    points, sizes = few.measure(found, preset)
    points, sizes = (points + 0.5) * whole.factor - 0.5, sizes * whole.factor
    plane = fit_plane(points, sizes, pitch, facing) if len(sizes) >= settings.min_measured else None
    paths = 2 * whole.forward.shape[1]
    sure = median(confidence(cost * np.float32(paths), best, paths, matcher.tolerance))
    return None if plane is None else (plane, sure)


def _refine_plane(
    plane: Plane,
    whole: Matcher,
    texture: Texture,
    indices: NDArray[np.int64],
    sample: NDArray[np.bool_],
    preset: Preset,
    facing: bool,
    settings: DetectionSettings,
) -> Plane | None:
    """The plane measured anew on the full flat, if the first one was measured on a reduced flat or may be slanted."""
    slanted = plane.slanted or plane.slant_ratio > settings.doubtful_slant
    if not slanted and whole.factor == 1:
        return plane
    pitch, more = texture.flat.pitch, sample
    if slanted:
        count = int(settings.slanted_sample * settings.sample * min(1.0, settings.large_pitch / pitch) ** 2)
        more = sample_lenses(indices, texture.clear, count)
    elif facing:
        more = np.zeros(len(sample), bool)
        more[np.flatnonzero(sample)[:: max(1, round(pitch / settings.large_pitch))]] = True
    few = _Subset.of(texture, whole.forward, whole.backward, more, settings)
    expected = plane.at(few.texture.flat.centres.astype(np.float64))
    return fit_plane(*few.measure(expected, preset, forward_only=True), pitch, facing)


@dataclass(frozen=True)
class _Subset:
    """Some lenses and their neighbours, as if there were no others."""

    texture: Texture
    forward: NDArray[np.int32]  # (m, d) int32: As for `find_plane`
    backward: NDArray[np.int32]
    selected: NDArray[np.bool_]  # (m,) those that are not there only as neighbours
    factor: int  # pixels of the flat, each way, that become one where they are searched

    @classmethod
    def of(
        cls,
        texture: Texture,
        forward: NDArray[np.int32],
        backward: NDArray[np.int32],
        selected: NDArray[np.bool_],
        settings: DetectionSettings,
    ) -> _Subset:
        """The lenses `selected` (n,) of all."""
        rows = np.flatnonzero(dilate_mask(selected, join_opposite(forward, backward)))
        factor = max(1, int(texture.flat.pitch / settings.search_pitch))
        halves = restrict_neighbours(rows, forward), restrict_neighbours(rows, backward)
        return cls(texture.select(rows), *halves, selected[rows], factor)

    def matcher(self, preset: Preset) -> Matcher:
        """A matcher on the flat reduced by `factor`."""
        texture, factor = self.texture, self.factor
        if factor > 1:
            flat = downsample(texture.flat, factor)
            texture = replace(texture, flat=flat, statistics=measure_statistics(flat), noise=texture.noise / factor)
            preset = replace(preset, row_step=1)
        return Matcher(texture, self.forward, self.backward, replace(preset, search_pitch=np.inf))

    def measure(
        self, sizes: NDArray, preset: Preset, forward_only: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Scene points and patch sizes, as `_scene_points`, from the pairs of the selected lenses.

        `sizes` are first values of the selected lenses or of all. With `forward_only` pairs with the neighbours in
        `backward`, which show nearly the same, are left out.
        """
        start, forward = np.full(len(self.selected), np.nan, np.float32), self.forward
        start[self.selected if len(sizes) < len(start) else slice(None)] = sizes
        if forward_only:
            forward = np.where(self.selected[:, None], forward, -1)
        return _scene_points(_fit_pairs(self.texture, forward, start, preset), self.texture, forward)


def _inner(texture: Texture, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: lenses with clear texture and no blank neighbour (n, k), of whose pairs most match."""
    return texture.clear & (count_neighbours(texture.clear | texture.faint, rows) == (rows >= 0).sum(1))


def _fit_pairs(texture: Texture, forward: NDArray[np.int32], start: NDArray[np.float32], preset: Preset) -> PairFits:
    """Sub-pixel patch size of all pairs of the lenses with a first value."""
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    return fit_pairs(texture.flat, forward, start, scale, texture.noise, preset.iterations, preset.last_step)


def _scene_points(
    pairs: PairFits, texture: Texture, forward: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scene points (m, 2) [px] where pairs of lenses with texture have measured a patch size, and these (m,) [px]."""
    clear, gray = texture.clear, texture.flat
    lens, d = np.nonzero(np.isfinite(pairs.patch_size[:, :, 0]) & clear[:, None] & clear[forward])
    sizes = pairs.patch_size[lens, d, 0].astype(np.float64)
    here, there = gray.centres[lens].astype(np.float64), gray.centres[forward[lens, d]].astype(np.float64)
    # `X = c - delta * D / s` for the middle between both microimages.
    stretch = gray.pitch / np.where(sizes == 0, np.inf, sizes)
    return 0.5 * (here + there) - pairs.place[lens, d, 0] * stretch[:, None], sizes


def correlate_with_plane(
    matcher: Matcher,
    texture: Texture,
    expected: NDArray[np.float32],
    preset: Preset,
    settings: DetectionSettings = DETECTION,
) -> NDArray[np.float32] | None:
    """(n,) correlation of every lens at the patch size `expected` (n,) [px] on a plane; None where one is not on it."""
    textured = texture.clear | texture.faint
    cost, off, _ = matcher.match_locally(textured, (expected / matcher.factor).astype(np.float32))
    usual = settings.misfit_factor * median(cost[texture.clear])
    limit = min(max(usual, matcher.settings.misfit_cost), settings.max_misfit_cost)
    misfits = texture.clear & (cost > limit)
    rows = matcher.neighbours
    inner = _inner(texture, rows)
    if not inner.any() or misfits[inner].mean() > settings.max_doubtful:
        return None
    if misfits.any():
        few = _Subset.of(matcher.downscaled(texture), matcher.forward, matcher.backward, misfits, settings)
        elsewhere, far, misfits = _search_misfits(few, matcher.factor, preset, misfits, expected, limit, settings)
        together = count_connected(elsewhere, rows)
        if (far & inner).any() or (elsewhere & inner & (together > 0)).any() or (together >= 2).any():
            return None
        if misfits[inner].mean() > settings.max_misfits:
            return None
    doubtful = np.zeros(len(off), bool)
    for side in (-1, 1):
        off_plane = texture.clear & ~misfits & (side * off > settings.off_plane)
        doubtful |= count_connected(off_plane, rows) >= settings.off_plane_neighbours
    if doubtful.any():
        doubtful |= (doubtful[rows] & (rows >= 0)).any(1)
        start = np.where(doubtful, expected, np.nan).astype(np.float32)
        pairs = _fit_pairs(texture, matcher.forward, start, preset)
        lenses = fit_lens_planes(texture.flat, matcher.forward, matcher.backward, pairs, start)
        residual = (lenses.patch_size - expected).astype(float)
        if has_outlier_cluster(residual, lenses.standard_error.astype(float), rows):
            return None
    return 1 - cost


def _search_misfits(
    few: _Subset,
    factor: int,
    preset: Preset,
    misfits: NDArray[np.bool_],
    expected: NDArray[np.float32],
    limit: float,
    settings: DetectionSettings,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Search lenses (n,) that do not match on a plane at all shifts: match better elsewhere, far from it, or nowhere.

    All costs are of this search, because that on the plane was over other pairs. The `few` are on a flat `factor` times
    as small as that of `expected`.
    """
    matcher, factor = few.matcher(preset), factor * few.factor
    full = matcher.lens_costs(matcher.pair_costs(few.selected), few.selected)
    away = np.abs(matcher.shifts - expected[misfits, None] / factor)
    near = away <= matcher.step
    # Interpolated between the two shifts beside the plane; there are none if the plane lies beyond the search range.
    share = np.where(near, matcher.step - away, 0)
    own = (full * share).sum(1) / np.maximum(share.sum(1), np.float32(1e-6))
    there = np.where(near, np.inf, full)
    best, least = there.argmin(1), there.min(1)
    better = (least < own - settings.better_by) & (least < limit)
    elsewhere, far, unmatched = np.zeros((3, len(misfits)), bool)
    elsewhere[misfits] = better
    far[misfits] = better & (away[np.arange(len(best)), best] * factor > settings.far)
    unmatched[misfits] = np.where(near, full, np.inf).min(1) > limit
    return elsewhere, far, unmatched


def normalised_plane_correlation(
    matcher: Matcher, texture: Texture, expected: NDArray[np.float32], correlation: NDArray[np.float32]
) -> NDArray:
    """(n,) share of the signal variance of each lens that its match on the plane explains."""
    weight = np.interp(expected / matcher.factor, matcher.shifts, matcher.overlap_weight)
    return np.asarray(correlation / weight / signal_share(texture))


def add_systematic_error(plane: Plane, explained: NDArray) -> Plane:
    """The plane with the systematic error of its lenses, from the share of their variance `explained` (m,)."""
    if not explained.size:
        return plane
    return replace(plane, systematic_error=float(systematic_error(plane.scatter, np.median(explained))))
