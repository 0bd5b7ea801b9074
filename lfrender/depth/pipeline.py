"""The depth of flats that show several depths, lens by lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from ..data.depth_map import DepthMap
from ..data.surface import Surface
from ..flat.gray_flat import GrayFlat, downsample_lattice, make_gray_flat
from ..flat.lens_graph import dilate_mask, nearest_chosen, neighbour_rows, opposite_neighbours
from ..flat.texture import (
    LensStatistics,
    Texture,
    classify_borderline_texture,
    classify_texture,
    estimate_noise,
    find_texture,
    sample_statistics,
)  # fmt: skip
from .estimate import DEFAULT_RATIO, LensEstimates, LensSet, PreviousEstimates, estimate_lenses
from .matching.matcher import MatchResult
from .matching.peaks import fill_unresolved
from .matching.shortcuts import Shortcuts, sample_lenses
from .plane_depth import confirm_on_plane, find_plane_of_few, fit_regular_plane, plane_depth_map, plane_scene_depth
from .planes.detection import find_plane
from .planes.settings import DETECTION
from .presets import PRESETS, Preset
from .surface.densify import densify
from .surface.second_layer import find_second_layer
from .surface.thin_structures import find_thin_structures
from .validity.classify import occurs_among
from .validity.settings import CLASSIFY
from .validity.textureless import find_textureless

__all__ = ["SceneStatistics", "UnsmoothedEstimates", "estimate_depth_map", "estimate_lens_by_lens", "prepare_flat"]

# So many lenses, evenly spread, tell which depths occur; where few carry texture, this share of them, but not fewer
# than the last number.
_SAMPLE, _SAMPLE_SHARE, _LEAST_SAMPLE = 150, 1 / 16, 24
# Where less than this share of the lenses are asked, the others are left out of all that is done with them.
_FEW = 0.5
# A plane that is not found with shading left in is sought again where shading has faked more than a tenth of the
# texture.
_FEWER = 0.9
# Fewer clear lenses than this do not tell it for the others: what repeats shows at depths that nobody has tried.
_FEWEST_CLEAR = 300
# Faint lenses are not looked after where they fit no depth that is known to occur: where less than the first share of
# the lenses are clear, so many times as many are needed, and asked.
_MOSTLY_CLEAR, _MORE_CLEAR = 0.8, 4


@dataclass(frozen=True)
class SceneStatistics:
    """What the lenses of a part of a flat must be told of the whole.

    Parameters
    ----------
    noise : float
        Standard deviation of a pixel, white = 1.
    sizes : (m,) float32 [px]
        Patch sizes of resolved lenses from all over the flat.
    raw_noise : float
        As `noise`, before shading is taken out.
    """

    noise: float
    sizes: NDArray[np.float32]
    raw_noise: float


@dataclass(frozen=True)
class UnsmoothedEstimates:
    """What each lens answers without what others on its surface say: errors of lenses beside each other share little.

    Parameters
    ----------
    patch_size, standard_error : (n,) [px]
    astray : (n,) [px]
        Part of each error that all lenses of a surface may share.
    """

    patch_size: NDArray
    standard_error: NDArray
    systematic_error: NDArray


@dataclass(frozen=True)
class _Asked:
    """Lenses that are asked for their depth, and what is known before.

    Parameters
    ----------
    lattice : Lattice
    texture : Texture
        Of all lenses.
    lenses : Lenses
        Those that are asked and those beside them, or all.
    rows : (m,) int, optional
        Where these stand among all; None for all.
    skipped : (n,) bool
        Blank lenses that nobody asks.
    kept : (n,) bool, optional
        Lenses that keep what was found `before`.
    before : DepthMap, optional
    overview : Overview, optional
        Of the larger flat of which this is a part.
    """

    lattice: Lattice
    texture: Texture
    lenses: LensSet
    rows: NDArray[np.int64] | None
    skipped: NDArray[np.bool_]
    kept: NDArray[np.bool_] | None
    before: DepthMap | None
    overview: SceneStatistics | None

    @property
    def alone(self) -> bool:
        """Nothing else is known of the scene."""
        return self.kept is None and self.overview is None

    @property
    def earlier(self) -> PreviousEstimates | None:
        """What all lenses answered before."""
        return None if self.kept is None or self.before is None else PreviousEstimates.by(self.before, self.kept)

    def answers(self, setting: Preset, ranges: bool) -> LensEstimates:
        """What the lenses answer; with `ranges`, only depths that occur in the larger flat are looked for."""
        earlier = self.earlier if self.rows is None or self.earlier is None else self.earlier.of(self.rows)
        sizes = self.overview.sizes if self.overview is not None and ranges and len(self.overview.sizes) else None
        return estimate_lenses(self.lenses, setting, earlier, sizes)


def prepare_flat(flat: NDArray, calibration: Calibration, preset: str) -> tuple[GrayFlat, Lattice, int]:
    """The flat as the preset analyses it, its lattice, and how many of its pixels each way have become one."""
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    return make_gray_flat(flat, calibration, factor), downsample_lattice(calibration.lattice, factor), factor


def estimate_depth_map(gray: GrayFlat, lattice: Lattice, preset: str, shortcuts: Shortcuts) -> DepthMap:
    """The depth of a flat of which nothing is known."""
    plain = sample_statistics(gray)
    raw_noise = estimate_noise(plain.roughness)
    if shortcuts.plane:
        texture = classify_texture(gray, plain, raw_noise)
        found = find_plane(texture, lattice.indices(), *opposite_neighbours(lattice), PRESETS[preset])
        if found is not None:
            return plane_scene_depth(found, gray, lattice, preset, {"plane": 1 - found.sampled})
    blank = find_textureless(gray, lattice, plain, PRESETS[preset], raw_noise) if shortcuts.blank else None
    return estimate_lens_by_lens(gray, lattice, preset, shortcuts, plain, blank)[0]


def estimate_lens_by_lens(
    gray: GrayFlat,
    lattice: Lattice,
    preset: str,
    shortcuts: Shortcuts,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None = None,
    before: DepthMap | None = None,
    overview: SceneStatistics | None = None,
) -> tuple[DepthMap, UnsmoothedEstimates]:
    """The depth of every lens, but for the `blank` ones and those `kept` from what was found `before`.

    `overview` is of the larger flat of which this is a part. Beside the depth stands what single lenses say.
    """
    level, tried = None, np.inf
    if blank is not None and kept is None and overview is None and shortcuts.plane:
        level, tried = _plane_among_blank(gray, lattice, preset, plain, blank)
        if level is not None:
            return level, _level(level)
    asked = _asked(gray, lattice, shortcuts, plain, blank, kept, before, overview)
    lenses, rows, setting = asked.lenses, asked.rows, PRESETS[preset]
    if rows is not None and asked.alone and shortcuts.plane and lenses.active.sum() < _FEWER * tried:
        level = find_plane_of_few(lenses, rows, asked.texture.flat, lattice, preset)
        if level is not None:
            return level, _level(level)
    answers = asked.answers(setting, shortcuts.ranges)
    saved = _saved(shortcuts, asked, answers.found)
    plane = None
    if asked.alone:
        plane = fit_regular_plane(
            lenses.centres, len(lattice), lenses.pitch, answers.patch_size, answers.standard_error, answers.reason,
            answers.systematic_error, lenses.neighbours,
        )  # fmt: skip
    if plane is None:
        return _spread_out(asked, answers, preset, shortcuts, saved)
    answers = confirm_on_plane(plane, answers, lenses)
    if rows is not None:
        answers = answers.among(len(lattice), rows, None)
    depth = plane_depth_map(plane, lattice, preset, answers.reason, answers.confidence, saved)
    return depth, UnsmoothedEstimates(depth.patch_size, depth.standard_error, answers.systematic_error)


def _level(depth: DepthMap) -> UnsmoothedEstimates:
    """What single lenses say where a few have told the plane of all."""
    return UnsmoothedEstimates(depth.patch_size, depth.standard_error, np.zeros(len(depth.reason)))


def _plane_among_blank(
    gray: GrayFlat, lattice: Lattice, preset: str, plain: LensStatistics, blank: NDArray[np.bool_]
) -> tuple[DepthMap | None, float]:
    """The depth where few lenses carry texture, the others are `blank`, and those few show one plane; None if not.

    Shading is left in where it hardly matters. Beside the depth stands how many lenses were tried, inf where all.
    """
    if (~blank).sum() < DETECTION.min_textured:
        return None, np.inf
    texture = classify_borderline_texture(gray, lattice, plain, blank, estimate_noise(plain.roughness))
    active = texture.clear | texture.faint
    if not 0 < active.mean() < _FEW:
        return None, np.inf
    forward, backward = opposite_neighbours(lattice)
    rows = np.flatnonzero(dilate_mask(active, neighbour_rows(lattice, lattice.steps)))
    every = np.ones(len(lattice), bool)
    few = LensSet(texture, forward, backward, lattice.indices(), every, active, None).of(rows)
    return find_plane_of_few(few, rows, texture.flat, lattice, preset), float(active.sum())


def _asked(
    gray: GrayFlat,
    lattice: Lattice,
    shortcuts: Shortcuts,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None,
    before: DepthMap | None,
    overview: SceneStatistics | None,
) -> _Asked:
    """The lenses to ask: those with texture and without an answer, and those beside them."""
    forward, backward = opposite_neighbours(lattice)
    neighbours = neighbour_rows(lattice, lattice.steps)
    # Lenses that keep their answer support those beside them with it.
    near = np.ones(len(lattice), bool) if kept is None else ~kept
    noise = None if overview is None else overview.noise
    texture = find_texture(gray, lattice, plain, blank, dilate_mask(near, neighbours), noise)
    some = texture.clear | texture.faint
    active = near if blank is None else near & some
    sample = _telling(lattice, texture.clear, active) if shortcuts.ranges and overview is None else None
    lenses = LensSet(texture, forward, backward, lattice.indices(), near, active, sample)
    wanted = active if kept is None else active | ~kept
    rows = np.flatnonzero(dilate_mask(wanted, neighbours)) if 0 < wanted.mean() < _FEW else None
    skipped = np.zeros(len(lattice), bool) if blank is None else ~some
    few = lenses if rows is None else lenses.of(rows)
    return _Asked(lattice, texture, few, rows, skipped, kept, before, overview)


def _spread_out(
    asked: _Asked, answers: LensEstimates, preset: str, shortcuts: Shortcuts, saved: dict[str, float]
) -> tuple[DepthMap, UnsmoothedEstimates]:
    """The depth of all lenses from what those that were asked answer, spread over the scene."""
    lattice, lenses, rows, earlier, setting = asked.lattice, asked.lenses, asked.rows, asked.earlier, PRESETS[preset]
    gap = max(1.0, 0.05 * lattice.pitch)
    kept, single = asked.kept, answers
    answers = answers.pooled(lenses, kept if kept is None or rows is None else kept[rows], setting.quadratic_fit)
    occurring = _occurring(answers, rows, earlier) if asked.overview is None else asked.overview.sizes
    drawn = fill_unresolved(answers.filled_patch_size, answers.resolved, lenses.neighbours, gap)
    seconds = _seconds(lenses, answers, drawn, occurring, setting, shortcuts, gap)
    if rows is not None:
        answers, drawn, seconds = _among_all(lattice, rows, answers, drawn, seconds, earlier)
        single = single.among(len(lattice), rows, earlier)
    resolved, sure = answers.resolved, answers.confidence
    trust = np.where(resolved, sure, 0.05).astype(np.float32)
    old = None if asked.before is None else asked.before.surface
    settled = None if kept is None else ~dilate_mask(~kept, neighbour_rows(lattice, lattice.steps))
    texture = asked.texture
    surface = densify(texture.flat, lattice, drawn, seconds, trust, texture.noise, setting.surface_cells, settled, old)
    # A lens that sees two depths answers with the one in its middle.
    middle = surface.at(lattice.centres())
    crossed = resolved & (np.abs(middle - drawn) > gap) & (np.abs(middle[:, None] - seconds) <= gap).any(1)
    crossed[crossed] = _level_about(surface, lattice.centres()[crossed], middle[crossed], gap)
    if kept is not None:
        crossed &= ~kept
    error = answers.standard_error
    depth = DepthMap(
        patch_size=np.where(crossed, middle, np.where(resolved, answers.patch_size, np.nan)),
        standard_error=np.where(crossed, np.maximum(error, answers.found.step), np.where(resolved, error, np.inf)),
        confidence=np.where(crossed | ~resolved, CLASSIFY.sure * sure, sure),
        filled_patch_size=np.where(crossed, middle, drawn),
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=answers.reason,
        saved=saved,
    )
    return depth, UnsmoothedEstimates(single.patch_size, single.standard_error, single.systematic_error)


def _telling(lattice: Lattice, clear: NDArray[np.bool_], active: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Those `clear` of the `active` lenses that tell which depths occur; None where they say little of the others."""
    among = clear & active
    count = among.sum()
    more = 1 if count >= _MOSTLY_CLEAR * active.sum() else _MORE_CLEAR
    if count < more * _FEWEST_CLEAR:
        return None
    wanted = np.clip(more * count * _SAMPLE_SHARE, _LEAST_SAMPLE, _SAMPLE)
    return sample_lenses(lattice.indices(), among, int(wanted))


def _occurring(
    answers: LensEstimates, rows: NDArray[np.int64] | None, earlier: PreviousEstimates | None
) -> NDArray[np.float32]:
    """Patch sizes [px] of all resolved lenses: those that are asked, at `rows` if not all, and the others."""
    sizes = answers.patch_size[answers.resolved]
    if rows is None or earlier is None:
        return sizes
    others = earlier.reason == 0
    others[rows] = False
    return np.concatenate([sizes, earlier.filled_patch_size[others]]).astype(sizes.dtype)


def _seconds(
    lenses: LensSet,
    answers: LensEstimates,
    drawn: NDArray[np.float32],
    occurring: NDArray[np.float32],
    setting: Preset,
    shortcuts: Shortcuts,
    gap: float,
) -> NDArray[np.float32]:
    """(n, 2) [px] other patch sizes that lenses may show beside `drawn`, of those that occur, as for `densify`."""
    second = np.where(occurs_among(answers.second, occurring, gap), answers.second, np.nan)
    others = np.stack([second, np.full(len(drawn), np.nan)], 1).astype(np.float32)
    if not setting.second_layer:
        return others
    evidence = np.where(lenses.near, answers.found.correlation, 1)
    around = occurring if shortcuts.ranges else None
    rest = find_second_layer(lenses.texture, lenses.forward, lenses.backward, drawn, evidence, setting, around)
    # Shading matches itself near zero: a depth there must occur by itself.
    rest[(np.abs(rest) < CLASSIFY.shading_reach * lenses.pitch) & ~occurs_among(rest, occurring, gap)] = np.nan
    others[:, 1] = rest
    thin = find_thin_structures(lenses.texture, lenses.forward, lenses.backward, drawn, others, lenses.near, gap)
    # Its place is that of the second best, which is false more often, but where the other one is free.
    told, place = np.isfinite(thin), np.where(np.isfinite(second) & np.isnan(rest), 1, 0)
    others[told, place[told]] = thin[told]
    return others


def _among_all(
    lattice: Lattice,
    rows: NDArray[np.int64],
    answers: LensEstimates,
    drawn: NDArray[np.float32],
    seconds: NDArray[np.float32],
    earlier: PreviousEstimates | None,
) -> tuple[LensEstimates, NDArray[np.float32], NDArray[np.float32]]:
    """What the lenses at `rows` answer among all; the others keep what they had, or are blank and drawn like the
    nearest that are resolved."""
    whole = answers.among(len(lattice), rows, earlier)
    all_drawn, all_seconds = np.empty(len(lattice), np.float32), np.full((len(lattice), 2), np.nan, np.float32)
    if earlier is not None:
        all_drawn[:] = earlier.filled_patch_size
    elif whole.resolved.any():
        all_drawn[rows] = drawn
        all_drawn = all_drawn[nearest_chosen(lattice, whole.resolved)]
    else:
        all_drawn[:] = DEFAULT_RATIO * lattice.pitch
    all_drawn[rows], all_seconds[rows] = drawn, seconds
    return whole, all_drawn, all_seconds


def _level_about(
    surface: Surface, centres: NDArray[np.float64], middle: NDArray[np.float32], gap: float
) -> NDArray[np.bool_]:
    """Lenses about whose centre the surface stays at its value there, to all sides."""
    level = np.ones(len(middle), bool)
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        beside = surface.at(centres + np.array([x, y]) * surface.spacing)
        level &= np.abs(beside - middle) <= gap
    return level


def _saved(shortcuts: Shortcuts, asked: _Asked, found: MatchResult) -> dict[str, float]:
    saved = {}
    if shortcuts.blank:
        saved["blank"] = float(asked.skipped.mean())
    if asked.lenses.sample is not None:
        saved["ranges"] = found.skipped_share
    if asked.kept is not None:
        saved["still"] = float(asked.kept.mean())
    return saved
