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
from .settings import PLANE, PlaneSettings

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
    settings: PlaneSettings = PLANE,
) -> PlaneScene | None:
    """The one plane that the flat shows; None where there are several depths or it cannot be decided.

    Shading of the `texture` need not be removed. `indices` (n, 2) are those of the lenses on the lattice, `forward` and
    `backward` (n, d) their neighbour rows in `d` directions and the opposites. With `facing` only a plane that faces
    the camera is accepted.
    """
    inner = _inner(texture, join_opposite(forward, backward))
    sample = sample_lenses(indices, inner, settings.sample)
    if sample.sum() < settings.fewest_lenses or texture.clear.mean() < settings.min_textured_share:
        return None
    whole = Matcher(texture, forward, backward, preset)
    few = _Subset.of(whole.downscaled(texture), whole, sample)
    found = few.search(preset, settings)
    if found is None:
        return None
    start, sure = found
    if not is_nearly_planar(whole.gray.centres[sample], start, whole.gray.pitch):
        return None
    points, sizes = few.measure(start, preset)
    plane = fit_plane((points + 0.5) * whole.factor - 0.5, sizes * whole.factor, texture.flat.pitch, facing)
    if plane is None:
        return None
    expected = plane.at(texture.flat.centres.astype(np.float64)).astype(np.float32)
    correlation = correlate_with_plane(whole, texture, expected, preset)
    if correlation is None:
        return None
    explained = normalised_plane_correlation(whole, texture, expected, correlation)[texture.clear]
    if plane.slanted or whole.factor > 1:
        # Measured anew on the full flat.
        more = sample
        if plane.slanted:
            more = sample_lenses(indices, texture.clear, int(settings.slanted_sample / texture.flat.pitch**2))
        few = _Subset.of(texture, whole, more)
        plane = fit_plane(*few.measure(expected[more], preset, forward_only=True), texture.flat.pitch, facing)
        if plane is None:
            return None
    return PlaneScene(add_systematic_error(plane, explained), sure, correlation, float(sample.mean()))


@dataclass(frozen=True)
class _Subset:
    """Some lenses and their neighbours, as if there were no others."""

    texture: Texture
    forward: NDArray[np.int32]  # (m, d) int32: As for `find_plane`
    backward: NDArray[np.int32]
    selected: NDArray[np.bool_]  # (m,) those that are not there only as neighbours

    @classmethod
    def of(cls, texture: Texture, whole: Matcher, selected: NDArray[np.bool_]) -> _Subset:
        """The lenses `selected` (n,) of all."""
        rows = np.flatnonzero(dilate_mask(selected, whole.neighbours))
        forward, backward = (restrict_neighbours(rows, half) for half in (whole.forward, whole.backward))
        return cls(texture.select(rows), forward, backward, selected[rows])

    def search(self, preset: Preset, settings: PlaneSettings) -> tuple[NDArray[np.float32], float] | None:
        """Patch size of each selected lens, searched on a reduced flat, and the median confidence; None if periodic."""
        texture, factor = self.texture, max(1, int(self.texture.flat.pitch / settings.search_pitch))
        if factor > 1:
            flat = downsample(texture.flat, factor)
            texture = replace(texture, flat=flat, statistics=measure_statistics(flat), noise=texture.noise / factor)
            preset = replace(preset, row_step=1)
        matcher = Matcher(texture, self.forward, self.backward, replace(preset, search_pitch=np.inf))
        cost = matcher.lens_costs(matcher.pair_costs(self.selected), self.selected)
        if matcher.is_periodic(cost):
            return None
        best, paths = cost.argmin(1), 2 * self.forward.shape[1]
        sure = median(confidence(cost * np.float32(paths), best, paths, matcher.tolerance))
        return (matcher.shifts[best] + fit_parabola(cost, best) * matcher.step) * factor, sure

    def measure(
        self, start: NDArray, preset: Preset, forward_only: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Scene points (k, 2) [px] where pairs of lenses with texture measure a patch size, and these (k,) [px].

        They begin at those of the selected lenses. With `forward_only` pairs with the neighbours in `backward`, which
        show nearly the same, are left out.
        """
        texture, gray, sizes = self.texture, self.texture.flat, np.full(len(self.selected), np.nan, np.float32)
        sizes[self.selected] = start
        forward = np.where(self.selected[:, None], self.forward, -1) if forward_only else self.forward
        pairs = _fit_pairs(texture, forward, sizes, preset)
        known = np.isfinite(pairs.patch_size[:, :, 0]) & texture.clear[:, None] & texture.clear[forward]
        lens, d = np.nonzero(known)
        found = pairs.patch_size[lens, d, 0].astype(np.float64)
        here, there = gray.centres[lens].astype(np.float64), gray.centres[forward[lens, d]].astype(np.float64)
        # `X = c - delta * D / s` for the middle between both microimages.
        stretch = gray.pitch / np.where(found == 0, np.inf, found)
        return 0.5 * (here + there) - pairs.place[lens, d, 0] * stretch[:, None], found


def _fit_pairs(texture: Texture, forward: NDArray[np.int32], start: NDArray[np.float32], preset: Preset) -> PairFits:
    """Sub-pixel patch size of all pairs of the lenses with a first value."""
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    return fit_pairs(texture.flat, forward, start, scale, texture.noise, preset.iterations, preset.last_step)


def _inner(texture: Texture, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(n,) bool: lenses with clear texture and no blank neighbour (n, k), of whose pairs most match."""
    return texture.clear & (count_neighbours(texture.clear | texture.faint, rows) == (rows >= 0).sum(1))


def correlate_with_plane(
    matcher: Matcher,
    texture: Texture,
    expected: NDArray[np.float32],
    preset: Preset,
    settings: PlaneSettings = PLANE,
) -> NDArray[np.float32] | None:
    """(n,) correlation of every lens at the patch size `expected` (n,) [px] on a plane; None where it leaves the plane.

    It does where lenses beside each other do not match there, or match at another depth.
    """
    factor, rows = matcher.factor, matcher.neighbours
    cost, off, _ = matcher.match_locally(texture.clear | texture.faint, (expected / factor).astype(np.float32))
    explained = normalised_plane_correlation(matcher, texture, expected, 1 - cost)
    misfits = texture.clear & (explained < settings.least_explained)
    # Lenses beside each other have a pair in common.
    if (count_connected(misfits & _inner(texture, rows), rows) >= settings.cluster - 1).any():
        return None
    doubtful = np.zeros(len(off), bool)
    for side in (-1, 1):
        together = count_connected(texture.clear & ~misfits & (side * off > settings.off_plane), rows)
        doubtful |= together >= settings.cluster - 1
    if doubtful.any():
        doubtful = dilate_mask(doubtful, rows)
        start = np.where(doubtful, expected, np.nan).astype(np.float32)
        pairs = _fit_pairs(texture, matcher.forward, start, preset)
        lenses = fit_lens_planes(texture.flat, matcher.forward, matcher.backward, pairs, start)
        if has_outlier_cluster(lenses.patch_size - expected, lenses.standard_error, rows):
            return None
    return 1 - cost


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
