"""The passes of an analysis, in order, from a grey flat to its depth map.

`estimate_depth_map`: which lenses have no texture (`validity.textureless`)? Then
`estimate_lens_by_lens`: select the lenses to match; search, refine, classify and smooth them
(`estimate`), find second depths (`surface.second_layer`) and make a dense surface of all
(`surface.densify`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from ..data.depth_map import DepthMap
from ..flat.gray_flat import GrayFlat, make_gray_flat
from ..flat.lens_graph import dilate_mask
from ..flat.neighbours import neighbours_of
from ..flat.texture import LensStatistics, find_texture, sample_statistics
from .estimate import LensEstimates, LensSet, estimate_lenses
from .matching.matcher import sample_lenses
from .presets import PRESETS, Preset, Shortcuts
from .same_surface import TOLERANCE
from .surface.densify import densify
from .surface.second_layer import find_second_layer
from .validity.classify import SHADING_REACH, SURE, occurs_among
from .validity.textureless import find_textureless

__all__ = ["SceneStatistics", "estimate_depth_map", "estimate_lens_by_lens", "prepare_flat"]


@dataclass(frozen=True)
class SceneStatistics:
    """Statistics of a large flat that the analysis of a part needs."""

    noise: float  # standard deviation of a pixel, white = 1
    sizes: NDArray[np.float32]  # (m,) [px] patch sizes of resolved lenses from all over the flat
    raw_noise: float  # as `noise`, before shading is corrected


def prepare_flat(
    flat: NDArray, calibration: Calibration, preset: str
) -> tuple[GrayFlat, Lattice, int]:
    """The grey flat that the preset analyses, its lattice, and how many pixels of the flat each way
    it has merged.
    """
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    lattice = calibration.lattice.downscaled(factor)
    return make_gray_flat(flat, calibration, factor), lattice, factor


def estimate_depth_map(
    gray: GrayFlat, lattice: Lattice, preset: str, shortcuts: Shortcuts
) -> DepthMap:
    """Depth of a flat about which nothing is known."""
    statistics = sample_statistics(gray)
    blank = (
        find_textureless(gray, lattice, statistics, PRESETS[preset]) if shortcuts.blank else None
    )
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
    """Depth of every lens, but for the `blank` ones (n,) and those `kept` (n,), which have that of
    `before`.
    """
    options = PRESETS[preset]
    neighbours = neighbours_of(lattice)
    # Lenses that keep their depth support their neighbours with it.
    updated = np.ones(len(lattice), bool) if kept is None else ~kept
    noise = None if overview is None else overview.noise
    texture = find_texture(
        gray, lattice, statistics, blank, dilate_mask(updated, neighbours.all), noise
    )
    textured = texture.clear | texture.faint
    active = updated if blank is None else updated & textured
    sample = None
    if shortcuts.ranges and overview is None:
        sample = _sample_depths(neighbours.indices, texture.clear, active)
    lenses = LensSet(texture, neighbours, updated, active, sample)
    sizes = (
        overview.sizes
        if overview is not None and shortcuts.ranges and len(overview.sizes)
        else None
    )
    single = estimate_lenses(lenses, options, before, sizes)
    saved = {}
    if shortcuts.blank:
        saved["blank"] = 0.0 if blank is None else float(1 - textured.mean())
    if sample is not None:
        saved["ranges"] = single.match.skipped_share
    estimates = single.smooth(lenses)
    resolved = estimates.resolved
    occurring = estimates.patch_size[resolved] if overview is None else overview.sizes
    filled = estimates.filled_patch_size
    seconds = _find_second_depths(lenses, estimates, filled, occurring, options, shortcuts)
    # Unresolved lenses count little beside the confidence of others.
    weight = np.where(resolved, estimates.confidence, 0.05).astype(np.float32)
    settled = None if kept is None else ~dilate_mask(updated, neighbours.all)
    old = None if before is None else before.surface
    surface = densify(
        texture.flat,
        lattice,
        filled,
        seconds,
        weight,
        texture.noise,
        options.surface_cells,
        settled,
        old,
    )
    return DepthMap(
        patch_size=np.where(resolved, estimates.patch_size, np.nan),
        standard_error=np.where(resolved, estimates.standard_error, np.inf),
        confidence=np.where(resolved, 1, SURE) * estimates.confidence,
        filled_patch_size=filled,
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=estimates.reason,
        saved=saved,
    )


def _sample_depths(
    indices: NDArray[np.int64], clear: NDArray[np.bool_], active: NDArray[np.bool_]
) -> NDArray[np.bool_] | None:
    """(n,) bool: a sample of 150 `active` lenses that shows which depths occur; None if too few are
    `clear`.
    """
    among = clear & active
    # Faint lenses match only at depths that are known to occur.
    enough = among.sum() * (among.sum() / max(active.sum(), 1)) ** 4 >= 300
    return sample_lenses(indices, among, 150) if enough else None


def _find_second_depths(
    lenses: LensSet,
    estimates: LensEstimates,
    filled: NDArray[np.float32],
    occurring: NDArray[np.float32],
    preset: Preset,
    shortcuts: Shortcuts,
) -> NDArray[np.float32]:
    """(n, 2) [px] other patch sizes that lenses may show beside the `filled` (n,), as for
    `densify`.
    """
    gap = TOLERANCE * lenses.pitch
    others = np.full((len(filled), 2), np.nan, np.float32)
    others[:, 0] = np.where(
        occurs_among(estimates.second, occurring, gap), estimates.second, np.nan
    )
    if preset.second_layer:
        correlation = np.where(lenses.updated, estimates.match.correlation, 1)
        tried = occurring if shortcuts.ranges else None
        rest = find_second_layer(
            lenses.texture, lenses.neighbours, filled, correlation, preset, tried
        )
        # Shading matches itself near zero: a depth there must occur by itself.
        rest[
            (np.abs(rest) < SHADING_REACH * lenses.pitch) & ~occurs_among(rest, occurring, gap)
        ] = np.nan
        others[:, 1] = rest
        # Beside a second layer, the second-best match is mostly a rougher value of it.
        others[dilate_mask(np.isfinite(rest), lenses.neighbours.all), 0] = np.nan
    return others
