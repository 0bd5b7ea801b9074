"""Depth of a flat: signed patch size of every microlens, from nothing but its neighbours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from .blankness import skipped_lenses
from .depthmap import DepthMap
from .flatcheck import check_flat
from .judgement import AGREED, LEAST_EVIDENCE, RESOLVABLE, SHADED_REACH, SURE, populated
from .lens_answers import UNTOLD, Answers, Earlier, Lenses, ask
from .modes import fill
from .neighbours import around, grown, lens_halves, nearest_of
from .plane import TEXTURED, Plane, fit_plane, strays
from .radiance import GrayFlat, gray_flat, shrunk
from .recurrence import recurring
from .region import check_region, embed, lenses_in, part_of, scaled
from .remainder import remainder_depths
from .search import PRESETS, Found, Preset
from .single_plane import PlaneScene, find_plane
from .skipping import Shortcuts, sample_lenses
from .spreading import grid_shape, spread
from .surface import Surface
from .texture import LensStatistics, find_texture, noise_of, quick_statistics, untouched_texture

__all__ = [
    "PRESETS",
    "Overview",
    "analyze",
    "analyzed",
    "lens_by_lens",
    "on_one_plane",
    "regular_plane",
    "working",
]


@dataclass(frozen=True)
class Overview:
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


# So many lenses, evenly spread, tell which depths occur; where few carry texture, this share of them, but not fewer
# than the last number.
_SAMPLE, _SAMPLE_SHARE, _LEAST_SAMPLE = 150, 1 / 16, 24
# A lens shows a plane if it matches there so well, by the usual match, or if two beside it do.
_TYPICAL = 0.5
# Where less than this share of the lenses are asked, the others are left out of all that is done with them.
_FEW = 0.5
# Fewer clear lenses than this do not tell it for the others, and fewer resolved ones than this do not prove a plane.
_FEWEST_CLEAR, _FEWEST_LEVEL = 60, 24


def analyze(
    flat: NDArray,
    calibration: Calibration,
    preset: str = "balanced",
    *,
    skip: bool | Iterable[str] = True,
    roi: tuple[float, float, float, float] | None = None,
    previous: tuple[NDArray, DepthMap] | None = None,
) -> DepthMap:
    """Estimate the signed patch size, mode and magnification of every microlens.

    Neighbouring microimages are correlated over all signed shifts at once (Lumsdaine and Georgiev
    2008, sections 4 to 6: telescopic and binocular differ only in the sign), lenses support each
    other along the lattice, and the best shift is refined on the pixels of every pair, to a plane through each lens.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
        Raw capture; integers are taken relative to the range of their type, floats to 1.
    calibration : Calibration
        Of the same image size.
    preset : {"fast", "balanced", "accurate"}
        How much time to spend.
    skip : bool or names
        Shortcuts to take: True all, False none (the exhaustive search), or some of `"blank"`, `"ranges"`, `"plane"`,
        `"still"`, `"steady"` (see `Shortcuts`). `DepthMap.saved` tells what they have saved.
    roi : (x0, y0, x1, y1), optional [px]
        Only lenses with their centre in this part of the flat are analysed; the others are unresolved.
    previous : (flat, DepthMap), optional
        An earlier frame of the same camera and exposure, and its answer with the same preset: lenses that show
        the same there as now, and whose neighbours do, keep it; so do lenses that move, but still match at their
        depth. Over many frames with slow changes give the frame that was analysed, not the last one, or changes
        smaller than the noise add up.

    Returns
    -------
    DepthMap

    Raises
    ------
    FlatError
        If `flat` is not a picture of finite numbers, or the earlier flat is of another kind.
    CalibrationError
        If `calibration` was made for another image size.
    ValueError
        If an option has no meaning, or no lens lies in `roi`.
    """
    if preset not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    shortcuts = Shortcuts.of(skip)
    flat = check_flat(flat, calibration)
    lattice = calibration.lattice
    inside = None if roi is None else lenses_in(check_region(roi, lattice), lattice)
    if previous is not None and shortcuts.still:
        if inside is not None:
            raise ValueError("give either roi or previous, not both")
        from .following import following

        return following(flat, calibration, preset, shortcuts, *previous)
    gray, small, factor = working(flat, calibration, preset)
    if inside is None:
        return scaled(analyzed(gray, small, preset, shortcuts), lattice, factor)
    part, sub = part_of(gray, small, inside)
    return scaled(embed(analyzed(part, sub, preset, shortcuts), sub, small, inside), lattice, factor)


def working(flat: NDArray, calibration: Calibration, preset: str) -> tuple[GrayFlat, Lattice, int]:
    """The flat as the preset analyses it, its lattice, and how many of its pixels each way have become one."""
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    return gray_flat(flat, calibration, factor), shrunk(calibration.lattice, factor), factor


def analyzed(gray: GrayFlat, lattice: Lattice, preset: str, shortcuts: Shortcuts) -> DepthMap:
    """The depth of a flat of which nothing is known."""
    plain = quick_statistics(gray)
    raw_noise = noise_of(plain.roughness)
    if shortcuts.plane:
        texture = untouched_texture(gray, plain, raw_noise)
        found = find_plane(texture, lattice.indices(), *lens_halves(lattice), PRESETS[preset])
        if found is not None:
            return _level(found, gray, lattice, preset, {"plane": 1 - found.sampled})
    blank = skipped_lenses(gray, lattice, plain, PRESETS[preset], raw_noise) if shortcuts.blank else None
    return lens_by_lens(gray, lattice, preset, shortcuts, plain, blank)[0]


def _level(found: PlaneScene, gray: GrayFlat, lattice: Lattice, preset: str, saved: dict[str, float]) -> DepthMap:
    """One plane for all lenses that show it."""
    shown = found.evidence >= LEAST_EVIDENCE
    usual = shown & (found.evidence >= _TYPICAL * np.median(found.evidence[shown]))
    shown &= usual | (around(usual, np.hstack(lens_halves(lattice))) >= 2)
    sizes = found.plane.at(lattice.centres())
    again, perhaps = recurring(gray, lattice.indices(), sizes, shown)
    sure = found.confidence * (SURE if perhaps else 1.0)
    reason = np.where(shown, np.where(again, 2, 0), 1)
    return on_one_plane(found.plane, lattice, preset, reason, sure * shown, saved)


def on_one_plane(
    plane: Plane, lattice: Lattice, preset: str, reason: NDArray, confidence: NDArray, saved: dict[str, float]
) -> DepthMap:
    """The depth of a scene that is one plane, for the lenses whose `reason` is 0."""
    centres = lattice.centres()
    sizes = plane.at(centres)
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].cells)
    return DepthMap(
        patch_size=np.where(reason == 0, sizes, np.nan),
        standard_error=np.where(reason == 0, plane.standard_error(centres), np.inf),
        confidence=confidence,
        drawn=sizes.astype(np.float32),
        surface=Surface(plane.over_grid(shape, first, spacing), first, spacing),
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=reason,
        saved=saved,
    )


def regular_plane(
    centres: NDArray[np.float64],
    count: int,
    pitch: float,
    sizes: NDArray[np.float32],
    errors: NDArray[np.float32],
    reason: NDArray[np.int8],
    astray: NDArray,
    neighbours: NDArray[np.int32],
) -> Plane | None:
    """The plane that all lenses with texture lie on as far as they can tell: their scatter about it is then nothing
    but noise.

    `reason` (n,) is as in `DepthMap`; `astray` (n,) [px] is the part of their errors that their pairs do not show. If
    they are few of the `count` lenses of the flat, the plane must face the camera: a slant would be carried too far.
    """
    known = (reason == 0) & np.isfinite(errors)
    if known.sum() < TEXTURED * (reason != 1).sum():
        return None
    own = sizes.astype(np.float64)
    # Lenses beside blank ones see little to measure.
    inner = known & (around(reason != 1, neighbours) == (neighbours >= 0).sum(1))
    if inner.sum() < _FEWEST_LEVEL:
        return None
    plane = fit_plane(centres[inner], own[inner], pitch)
    if plane is not None and plane.slanted and known.sum() < TEXTURED * count:
        return None
    if plane is None or strays(np.where(known, own - plane.at(centres), np.nan), errors.astype(float), neighbours):
        return None
    return replace(plane, misled=float(np.median(astray[known])))


def lens_by_lens(
    gray: GrayFlat,
    lattice: Lattice,
    preset: str,
    shortcuts: Shortcuts,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None = None,
    before: DepthMap | None = None,
    overview: Overview | None = None,
) -> tuple[DepthMap, NDArray]:
    """The depth of every lens, but for the `blank` ones and those `kept` from what was found `before`.

    `overview` is of the larger flat of which this is a part. Beside the depth stands the part (n,) [px] of each error
    that all lenses of a surface may share.
    """
    setting = PRESETS[preset]
    forward, backward = lens_halves(lattice)
    neighbours = np.hstack([forward, backward])
    near, earlier = np.ones(len(lattice), bool), None
    if kept is not None and before is not None:
        # Lenses beside those with a new answer support them, and so do those beside these.
        near, earlier = grown(grown(~kept, neighbours), neighbours), Earlier.by(before, kept)
    noise = None if overview is None else overview.noise
    texture = find_texture(gray, lattice, plain, blank, grown(near, neighbours), noise)
    some = texture.clear | texture.faint
    active = near if blank is None else near & some
    sample = _telling(lattice, texture.clear & active) if shortcuts.ranges and overview is None else None
    sizes = overview.sizes if overview is not None and shortcuts.ranges and len(overview.sizes) else None
    lenses = Lenses(texture, forward, backward, lattice.indices(), near, active, sample)
    asked = active if kept is None else active | ~kept
    rows = np.flatnonzero(grown(asked, neighbours)) if 0 < asked.mean() < _FEW else None
    few = lenses if rows is None else lenses.of(rows)
    if rows is not None and kept is None and overview is None and shortcuts.plane:
        level = _few_on_plane(few, rows, texture.flat, lattice, preset)
        if level is not None:
            return level, np.zeros(len(lattice))
    answers = ask(few, setting, earlier if rows is None or earlier is None else earlier.of(rows), sizes)
    skipped = np.zeros(len(lattice), bool) if blank is None else ~some
    saved = _saved(shortcuts, skipped, answers.found, sample, kept)
    if kept is None and overview is None:
        plane = regular_plane(
            few.centres, len(lattice), few.pitch, answers.patch_size, answers.standard_error,
            answers.reason, answers.astray, few.neighbours,
        )  # fmt: skip
        if plane is not None:
            answers = _confirmed(plane, answers, few)
            if rows is not None:
                answers = answers.among(len(lattice), rows, None)
            return on_one_plane(plane, lattice, preset, answers.reason, answers.confidence, saved), answers.astray
    gap = max(1.0, 0.05 * lattice.pitch)
    occurring = _occurring(answers, rows, earlier) if overview is None else overview.sizes
    drawn = fill(answers.drawn, answers.resolved, few.neighbours, gap)
    seconds = _seconds(few, answers, drawn, occurring, setting, shortcuts, gap)
    if rows is not None:
        answers, drawn, seconds = _among_all(lattice, rows, answers, drawn, seconds, earlier)
    resolved, sure = answers.resolved, answers.confidence
    trust = np.where(resolved, sure, 0.05).astype(np.float32)
    old, settled = None if before is None else before.surface, None if kept is None else ~grown(~kept, neighbours)
    surface = spread(texture.flat, lattice, drawn, seconds, trust, texture.noise, setting.cells, settled, old)
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
        confidence=np.where(crossed | ~resolved, SURE * sure, sure),
        drawn=np.where(crossed, middle, drawn),
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=answers.reason,
        saved=saved,
    )
    return depth, answers.astray


def _few_on_plane(
    few: Lenses, rows: NDArray[np.int64], gray: GrayFlat, lattice: Lattice, preset: str
) -> DepthMap | None:
    """The depth of all lenses where those at `rows`, beside which all are blank, show one plane; None if not."""
    found = find_plane(few.texture, few.indices, few.forward, few.backward, PRESETS[preset], facing=True)
    if found is None:
        return None
    evidence = np.zeros(len(lattice), np.float32)
    evidence[rows] = np.where(few.active, found.evidence, 0)
    asked, sampled = few.active.sum() / len(lattice), found.sampled * len(rows) / len(lattice)
    saved = {"blank": float(1 - asked), "plane": float(asked - sampled)}
    return _level(replace(found, evidence=evidence), gray, lattice, preset, saved)


def _telling(lattice: Lattice, clear: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Those of the `clear` lenses that tell which depths occur; None where they say nothing about all faint ones."""
    count = clear.sum()
    if count < _FEWEST_CLEAR:
        return None
    return sample_lenses(lattice.indices(), clear, int(np.clip(count * _SAMPLE_SHARE, _LEAST_SAMPLE, _SAMPLE)))


def _confirmed(plane: Plane, answers: Answers, lenses: Lenses) -> Answers:
    """What lenses that all lie on a plane answer: it confirms what few pairs at the border of the flat could not."""
    own, reason = plane.at(lenses.centres), answers.reason
    near_plane = np.abs(answers.patch_size - own) <= 2 * AGREED * lenses.pitch
    near_plane &= np.abs(own) <= RESOLVABLE * lenses.pitch
    sure = near_plane & (answers.found.confidence >= SURE)
    return replace(answers, reason=np.where((reason == 3) & sure, 0, reason).astype(np.int8))


def _occurring(answers: Answers, rows: NDArray[np.int64] | None, earlier: Earlier | None) -> NDArray[np.float32]:
    """Patch sizes [px] of all resolved lenses: those that are asked, at `rows` if not all, and the others."""
    sizes = answers.patch_size[answers.resolved]
    if rows is None or earlier is None:
        return sizes
    others = earlier.reason == 0
    others[rows] = False
    return np.concatenate([sizes, earlier.drawn[others]]).astype(sizes.dtype)


def _seconds(
    lenses: Lenses,
    answers: Answers,
    drawn: NDArray[np.float32],
    occurring: NDArray[np.float32],
    setting: Preset,
    shortcuts: Shortcuts,
    gap: float,
) -> NDArray[np.float32]:
    """(n, 2) [px] other patch sizes that lenses may show beside `drawn`, of those that occur, as for `spread`."""
    second = np.where(populated(answers.second, occurring, gap), answers.second, np.nan)
    rest = np.full(len(drawn), np.nan, np.float32)
    if setting.remainder:
        evidence = np.where(lenses.near, answers.found.evidence, 1)
        around = occurring if shortcuts.ranges else None
        rest = remainder_depths(lenses.texture, lenses.forward, lenses.backward, drawn, evidence, setting, around)
    # Shading matches itself near zero: a depth there must occur by itself.
    rest[(np.abs(rest) < SHADED_REACH * lenses.pitch) & ~populated(rest, occurring, gap)] = np.nan
    return np.stack([second, rest], 1).astype(np.float32)


def _among_all(
    lattice: Lattice,
    rows: NDArray[np.int64],
    answers: Answers,
    drawn: NDArray[np.float32],
    seconds: NDArray[np.float32],
    earlier: Earlier | None,
) -> tuple[Answers, NDArray[np.float32], NDArray[np.float32]]:
    """What the lenses at `rows` answer among all; the others keep what they had, or are blank and drawn like the
    nearest that are resolved."""
    whole = answers.among(len(lattice), rows, earlier)
    all_drawn, all_seconds = np.empty(len(lattice), np.float32), np.full((len(lattice), 2), np.nan, np.float32)
    if earlier is not None:
        all_drawn[:] = earlier.drawn
    elif whole.resolved.any():
        all_drawn[rows] = drawn
        all_drawn = all_drawn[nearest_of(lattice, whole.resolved)]
    else:
        all_drawn[:] = UNTOLD * lattice.pitch
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


def _saved(
    shortcuts: Shortcuts,
    skipped: NDArray[np.bool_],
    found: Found,
    sample: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None,
) -> dict[str, float]:
    saved = {}
    if shortcuts.blank:
        saved["blank"] = float(skipped.mean())
    if sample is not None:
        saved["ranges"] = found.untried
    if kept is not None:
        saved["still"] = float(kept.mean())
    return saved
