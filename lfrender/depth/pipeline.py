"""The passes of an analysis, in order, from a grey flat to its depth map.

`estimate_depth_map`: which lenses have no texture (`validity.textureless`)? Then `estimate_lens_by_lens`: select the
lenses to match; search, refine and classify them (`estimate`); smooth them over surfaces (`refinement.smoothing`), fill
unresolved ones, find second depths (`surface.second_layer`) and make a dense surface of all (`surface.densify`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from ..data.depth_map import DepthMap
from ..data.surface import Surface
from ..flat.gray_flat import GrayFlat, downsample_lattice, make_gray_flat
from ..flat.lens_graph import dilate_mask, nearest_chosen, neighbour_rows, opposite_neighbours
from ..flat.texture import LensStatistics, Texture, find_texture, sample_statistics
from .estimate import LensEstimates, LensSet, PreviousEstimates, estimate_lenses
from .matching.peaks import fill_unresolved
from .matching.shortcuts import Shortcuts, sample_lenses
from .presets import PRESETS, Preset
from .same_surface import TOLERANCE
from .settings import ESTIMATE, PIPELINE
from .surface.densify import densify
from .surface.second_layer import find_second_layer
from .validity.classify import occurs_among
from .validity.settings import CLASSIFY
from .validity.textureless import find_textureless

__all__ = ["SceneStatistics", "estimate_depth_map", "estimate_lens_by_lens", "prepare_flat"]


@dataclass(frozen=True)
class SceneStatistics:
    """Statistics of a large flat that the analysis of a part needs."""

    noise: float  # standard deviation of a pixel, white = 1
    sizes: NDArray[np.float32]  # (m,) [px] patch sizes of resolved lenses from all over the flat
    raw_noise: float  # as `noise`, before shading is corrected


@dataclass(frozen=True)
class _Selection:
    """Lenses to estimate, and what is known before."""

    lattice: Lattice
    texture: Texture  # of all lenses
    lenses: LensSet  # those to estimate and their neighbours, or all
    rows: NDArray[np.int64] | None  # (m,) rows of these among all; None for all
    blank: NDArray[np.bool_]  # (n,) lenses without texture, which are left out
    kept: NDArray[np.bool_] | None  # (n,) lenses that keep the depth they have in `before`
    before: DepthMap | None
    overview: SceneStatistics | None  # of the larger flat of which this is a part

    @property
    def previous(self) -> PreviousEstimates | None:
        """Estimates that all lenses had before."""
        return None if self.kept is None or self.before is None else PreviousEstimates.of_depth(self.before, self.kept)

    @property
    def gap(self) -> float:
        """Difference of patch sizes [px] between two surfaces."""
        return TOLERANCE * self.lattice.pitch

    def estimate(self, preset: Preset, ranges: bool) -> LensEstimates:
        """Estimate the lenses; with `ranges` only depths that occur in the larger flat are searched."""
        previous = self.previous
        if previous is not None and self.rows is not None:
            previous = previous.select(self.rows)
        sizes = self.overview.sizes if self.overview is not None and ranges and len(self.overview.sizes) else None
        return estimate_lenses(self.lenses, preset, previous, sizes)


def prepare_flat(flat: NDArray, calibration: Calibration, preset: str) -> tuple[GrayFlat, Lattice, int]:
    """The grey flat that the preset analyses, its lattice, and how many pixels of the flat each way it has merged."""
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    return make_gray_flat(flat, calibration, factor), downsample_lattice(calibration.lattice, factor), factor


def estimate_depth_map(gray: GrayFlat, lattice: Lattice, preset: str, shortcuts: Shortcuts) -> DepthMap:
    """Depth of a flat about which nothing is known."""
    statistics = sample_statistics(gray)
    blank = find_textureless(gray, lattice, statistics, PRESETS[preset]) if shortcuts.blank else None
    return estimate_lens_by_lens(gray, lattice, preset, shortcuts, statistics, blank)


def estimate_lens_by_lens(
    gray: GrayFlat,
    lattice: Lattice,
    preset: str,
    shortcuts: Shortcuts,
    statistics: LensStatistics,
    blank: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None = None,
    before: DepthMap | None = None,
    overview: SceneStatistics | None = None,
) -> DepthMap:
    """Depth of every lens, but for the `blank` ones (n,) and those `kept` (n,), which have that of `before`.

    `overview` is of the larger flat of which this is a part.
    """
    chosen = _select_lenses(gray, lattice, shortcuts, statistics, blank, kept, before, overview)
    estimates = chosen.estimate(PRESETS[preset], shortcuts.ranges)
    saved = _saved_work(shortcuts, chosen, estimates)
    return _complete_depth(chosen, estimates, preset, shortcuts, saved)


def _select_lenses(
    gray: GrayFlat,
    lattice: Lattice,
    shortcuts: Shortcuts,
    statistics: LensStatistics,
    blank: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None,
    before: DepthMap | None,
    overview: SceneStatistics | None,
) -> _Selection:
    """The lenses with texture and without a depth, and their neighbours."""
    neighbours = neighbour_rows(lattice, lattice.steps)
    # Lenses that keep their depth support their neighbours with it.
    updated = np.ones(len(lattice), bool) if kept is None else ~kept
    noise = None if overview is None else overview.noise
    texture = find_texture(gray, lattice, statistics, blank, dilate_mask(updated, neighbours), noise)
    textured = texture.clear | texture.faint
    active = updated if blank is None else updated & textured
    sample = _sample_depths(lattice, texture.clear, active) if shortcuts.ranges and overview is None else None
    lenses = LensSet(texture, *opposite_neighbours(lattice), lattice.indices(), updated, active, sample)
    wanted = active if kept is None else updated
    rows = np.flatnonzero(dilate_mask(wanted, neighbours)) if 0 < wanted.mean() < PIPELINE.few_lenses else None
    skipped = np.zeros(len(lattice), bool) if blank is None else ~textured
    selected = lenses if rows is None else lenses.select(rows)
    return _Selection(lattice, texture, selected, rows, skipped, kept, before, overview)


def _sample_depths(lattice: Lattice, clear: NDArray[np.bool_], active: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(n,) bool: a sample of the `active` lenses that shows which depths occur; None if too few are `clear`."""
    among = clear & active
    # Faint lenses match only at depths that are known to occur.
    enough = among.sum() * (among.sum() / max(active.sum(), 1)) ** 4 >= 2 * PIPELINE.sample
    return sample_lenses(lattice.indices(), among, PIPELINE.sample) if enough else None


def _complete_depth(
    chosen: _Selection, estimates: LensEstimates, preset: str, shortcuts: Shortcuts, saved: dict[str, float]
) -> DepthMap:
    """Smooth estimates over surfaces, find second depths, and make a dense surface of all lenses."""
    lattice, lenses, rows, previous = chosen.lattice, chosen.lenses, chosen.rows, chosen.previous
    kept, gap, options = chosen.kept, chosen.gap, PRESETS[preset]
    estimates = estimates.smooth(lenses, kept if kept is None or rows is None else kept[rows])
    overview = chosen.overview
    occurring = _occurring_sizes(estimates, rows, previous) if overview is None else overview.sizes
    filled = fill_unresolved(estimates.filled_patch_size, estimates.resolved, lenses.neighbours, gap)
    seconds = _find_second_depths(lenses, estimates, filled, occurring, options, shortcuts, gap)
    if rows is not None:
        estimates, filled, seconds = _embed_all(lattice, rows, estimates, filled, seconds, previous)
    weight = np.where(estimates.resolved, estimates.confidence, PIPELINE.unresolved_weight).astype(np.float32)
    old = None if chosen.before is None else chosen.before.surface
    settled = None if kept is None else ~dilate_mask(~kept, neighbour_rows(lattice, lattice.steps))
    flat, noise = chosen.texture.flat, chosen.texture.noise
    surface = densify(flat, lattice, filled, seconds, weight, noise, options.surface_cells, settled, old)
    return _assign_depths(chosen, estimates, filled, surface, preset, saved)


def _assign_depths(
    chosen: _Selection,
    estimates: LensEstimates,
    filled: NDArray[np.float32],
    surface: Surface,
    preset: str,
    saved: dict[str, float],
) -> DepthMap:
    """The depth map of the lenses, with the `surface`."""
    lattice, resolved, sure = chosen.lattice, estimates.resolved, estimates.confidence
    return DepthMap(
        patch_size=np.where(resolved, estimates.patch_size, np.nan),
        standard_error=np.where(resolved, estimates.standard_error, np.inf),
        confidence=np.where(resolved, sure, CLASSIFY.sure * sure),
        filled_patch_size=filled,
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=estimates.reason,
        saved=saved,
    )


def _occurring_sizes(
    estimates: LensEstimates, rows: NDArray[np.int64] | None, previous: PreviousEstimates | None
) -> NDArray[np.float32]:
    """Patch sizes [px] of all resolved lenses, whether estimated now, at `rows` if not all, or before."""
    sizes = estimates.patch_size[estimates.resolved]
    if rows is None or previous is None:
        return sizes
    others = previous.reason == 0
    others[rows] = False
    return np.concatenate([sizes, previous.filled_patch_size[others]]).astype(sizes.dtype)


def _find_second_depths(
    lenses: LensSet,
    estimates: LensEstimates,
    filled: NDArray[np.float32],
    occurring: NDArray[np.float32],
    preset: Preset,
    shortcuts: Shortcuts,
    gap: float,
) -> NDArray[np.float32]:
    """(n, 2) [px] other patch sizes that lenses may show beside the `filled` (n,), as for `densify`."""
    second = np.where(occurs_among(estimates.second, occurring, gap), estimates.second, np.nan)
    others = np.stack([second, np.full(len(filled), np.nan)], 1).astype(np.float32)
    if not preset.second_layer:
        return others
    correlation = np.where(lenses.updated, estimates.match.correlation, 1)
    tried = occurring if shortcuts.ranges else None
    halves = lenses.forward, lenses.backward
    rest = find_second_layer(lenses.texture, *halves, filled, correlation, preset, tried)
    # Shading matches itself near zero: a depth there must occur by itself.
    rest[(np.abs(rest) < CLASSIFY.shading_reach * lenses.pitch) & ~occurs_among(rest, occurring, gap)] = np.nan
    others[:, 1] = rest
    return others


def _embed_all(
    lattice: Lattice,
    rows: NDArray[np.int64],
    estimates: LensEstimates,
    filled: NDArray[np.float32],
    seconds: NDArray[np.float32],
    previous: PreviousEstimates | None,
) -> tuple[LensEstimates, NDArray[np.float32], NDArray[np.float32]]:
    """Estimates of the lenses at `rows` among all; others keep theirs, or are filled from the nearest resolved one."""
    whole = estimates.embed(len(lattice), rows, previous)
    all_filled, all_seconds = np.empty(len(lattice), np.float32), np.full((len(lattice), 2), np.nan, np.float32)
    if previous is not None:
        all_filled[:] = previous.filled_patch_size
    elif whole.resolved.any():
        all_filled[rows] = filled
        all_filled = all_filled[nearest_chosen(lattice, whole.resolved)]
    else:
        all_filled[:] = ESTIMATE.default_ratio * lattice.pitch
    all_filled[rows], all_seconds[rows] = filled, seconds
    return whole, all_filled, all_seconds


def _saved_work(shortcuts: Shortcuts, chosen: _Selection, estimates: LensEstimates) -> dict[str, float]:
    """Share of the work that each shortcut has saved, as `DepthMap.saved`."""
    saved = {}
    if shortcuts.blank:
        saved["blank"] = float(chosen.blank.mean())
    if chosen.lenses.sample is not None:
        saved["ranges"] = estimates.match.skipped_share
    if chosen.kept is not None:
        saved["still"] = float(chosen.kept.mean())
    return saved
