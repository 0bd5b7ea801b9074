"""The passes of an analysis, in order, from a grey flat to its depth map.

`estimate_part`: which lenses have no texture (`validity.textureless`)? Select the lenses to match;
search, refine, classify and smooth them (`estimate`), find second depths (`surface.second_layer`)
and make a dense surface of all (`surface.densify`). `locate_part_edges`: find the depth edges of
the surface on the pixels (`edges`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from ..data.depth_map import DepthMap
from ..data.surface import Surface
from ..flat.gray_flat import GrayFlat, make_gray_flat
from ..flat.texture import find_texture
from .edges.locate_edges import locate_edges, places_of_lenses, refine_grid
from .estimate import LensEstimates, LensSet, estimate_lenses
from .matching.matcher import sample_lenses
from .presets import PRESETS, Preset, Shortcuts
from .region import Part
from .same_surface import TOLERANCE
from .surface.densify import densify
from .surface.scene_grid import grid_shape
from .surface.second_layer import find_second_layer
from .validity.classify import SHADING_REACH, SURE, occurs_among
from .validity.textureless import find_textureless

__all__ = ["estimate_part", "locate_part_edges", "prepare_flat"]


def prepare_flat(
    flat: NDArray, calibration: Calibration, preset: str
) -> tuple[GrayFlat, Lattice, int]:
    """The grey flat that the preset analyses, its lattice, and how many pixels of the flat each way
    it has merged.
    """
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    lattice = calibration.lattice.downscaled(factor)
    return make_gray_flat(flat, calibration, factor), lattice, factor


def estimate_part(part: Part, shortcuts: Shortcuts) -> DepthMap:
    """Depth of every lens of a part, with a surface whose edges are those of lenses."""
    options = PRESETS[part.preset]
    gray = part.gray
    lattice = part.lattice
    whole = part.whole
    before = part.before
    statistics = part.statistics
    blank = None
    if shortcuts.blank:
        raw_noise = None if whole is None else whole.raw_noise
        near = part.near_updated(2)
        blank = find_textureless(gray, lattice, statistics, options, raw_noise, near)
    noise = None if whole is None else whole.noise
    texture = find_texture(gray, lattice, statistics, blank, part.near_updated(), noise)
    textured = texture.clear | texture.faint
    active = part.updated if blank is None else part.updated & textured
    sample = None
    sizes = None
    if shortcuts.ranges and whole is None:
        sample = _sample_depths(part.neighbours.indices, texture.clear, active)
    if shortcuts.ranges and whole is not None and len(whole.sizes):
        sizes = whole.sizes
    lenses = LensSet(part, texture, active, sample, sizes)
    single = estimate_lenses(lenses, options)
    saved = {}
    if shortcuts.blank:
        saved["blank"] = 0.0 if blank is None else float(1 - textured.mean())
    if sample is not None:
        saved["ranges"] = single.match.skipped_share
    estimates = single.smooth(lenses)
    resolved = estimates.resolved
    occurring = estimates.patch_size[resolved] if whole is None else whole.sizes
    filled = estimates.filled_patch_size
    seconds = _find_second_depths(lenses, estimates, filled, occurring, options, shortcuts)
    # Unresolved lenses count little beside the confidence of others.
    weight = np.where(resolved, estimates.confidence, 0.05).astype(np.float32)
    surface = densify(
        texture.flat,
        lattice,
        filled,
        seconds,
        weight,
        texture.noise,
        options.surface_cells,
        ~part.near_updated(),
        None if before is None else _coarse_surface(before.surface, lattice, options),
    )
    return DepthMap(
        patch_size=np.where(resolved, estimates.patch_size, np.nan),
        standard_error=np.where(resolved, estimates.standard_error, np.inf),
        confidence=np.where(resolved, 1, SURE) * estimates.confidence,
        filled_patch_size=filled,
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=part.preset,
        reason=estimates.reason,
        saved=saved,
    )


def locate_part_edges(part: Part, depth: DepthMap) -> DepthMap:
    """The depth map with its edges on the pixels; far from lenses that are estimated, those of the
    earlier frame.
    """
    if part.before is None:
        return locate_edges(part.gray, part.lattice, depth)
    near = part.near_updated()
    after = locate_edges(part.gray, part.lattice, depth, near)
    old = part.before.surface
    new = after.surface
    values = new.patch_size
    finer = round(new.spacing / old.spacing)
    if finer > 1:
        values = refine_grid(values, finer, TOLERANCE * part.lattice.pitch)
        new = Surface(values, old.first, old.spacing)
    if values.shape != old.patch_size.shape:
        return after
    keep = ~places_of_lenses(near, part.lattice, new)
    return replace(after, surface=replace(new, patch_size=np.where(keep, old.patch_size, values)))


def _coarse_surface(surface: Surface, lattice: Lattice, preset: Preset) -> Surface:
    """The surface on the grid that it has before edges are located."""
    _, first, spacing = grid_shape(lattice, preset.surface_cells)
    finer = round(spacing / surface.spacing)
    if finer <= 1:
        return surface
    return Surface(surface.patch_size[::finer, ::finer].copy(), first, spacing)


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
    """(n,) [px] other patch size that each lens may show beside the `filled` one (n,), NaN where
    there is none: that of its second layer, or the second-best match where none is searched.
    """
    second = estimates.second
    if preset.second_layer:
        correlation = np.where(lenses.part.updated, estimates.match.correlation, 1)
        tried = occurring if shortcuts.ranges else None
        second = find_second_layer(
            lenses.texture, lenses.part.neighbours, filled, correlation, preset, tried
        )
    occurs = occurs_among(second, occurring, TOLERANCE * lenses.pitch)
    # Shading matches itself near zero: a depth there must occur by itself.
    sure = preset.second_layer & (np.abs(second) >= SHADING_REACH * lenses.pitch)
    return np.where(occurs | sure, second, np.float32(np.nan))
