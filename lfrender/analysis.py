"""Depth of a flat: signed patch size of every microlens, from nothing but its neighbours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from .blankness import skipped_lenses
from .certainty import misled, signal_share, unexplained
from .consensus import measure
from .depthmap import DepthMap
from .flatcheck import check_flat
from .judgement import (
    AGREED,
    LEAST_EVIDENCE,
    RESOLVABLE,
    SHADED_REACH,
    SURE,
    credible,
    judged,
    moving,
    populated,
    possible,
    shaded,
)  # fmt: skip
from .modes import fill
from .neighbours import grown, lens_halves
from .plane import TEXTURED, Plane, fit_plane, strays
from .radiance import GrayFlat, gray_flat, shrunk
from .recurrence import hardly_seen, recurring
from .region import check_region, embed, embed_textured, lenses_in, part_of, rows_of, scaled
from .remainder import remainder_depths
from .search import PRESETS, Found, Matcher, search
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


# A scene without any texture is drawn at this s / D: from the middle of the microimages. Its sign makes no difference.
_UNTOLD = 0.25
# Rows of a plane's surface that are found at once.
_STRIP = 64
# So many lenses, evenly spread, tell which depths occur; where few carry texture, this share of them, but not fewer
# than the last number.
_SAMPLE, _SAMPLE_SHARE, _LEAST_SAMPLE = 150, 1 / 16, 24
# Where less than this share of the lenses carry texture, and a box about them holds less than the second, the rest of
# the flat is cut off.
_FEW, _PART = 0.5, 0.7
# Fewer clear lenses than this do not tell it for the others.
_FEWEST_CLEAR = 60


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
        found = find_plane(texture, lattice, *lens_halves(lattice), PRESETS[preset])
        if found is not None:
            return _level(found, gray, lattice, preset)
    if not shortcuts.blank:
        return lens_by_lens(gray, lattice, preset, shortcuts, plain, None)[0]
    blank = skipped_lenses(gray, lattice, plain, PRESETS[preset], raw_noise)
    if blank is None:
        return lens_by_lens(gray, lattice, preset, shortcuts, plain, None)[0]
    if 0 < np.sum(~blank) < _FEW * len(blank):
        part, sub = part_of(gray, lattice, ~blank)
        if len(sub) < _PART * len(lattice):
            rows = rows_of(sub, lattice)
            depth, _ = lens_by_lens(part, sub, preset, shortcuts, plain.of(rows), (blank[rows], raw_noise))
            left = (1 - depth.saved["blank"]) * len(sub) / len(lattice)
            return embed_textured(depth, sub, lattice, {**depth.saved, "blank": 1 - left})
    return lens_by_lens(gray, lattice, preset, shortcuts, plain, (blank, np.inf))[0]


def _level(found: PlaneScene, gray: GrayFlat, lattice: Lattice, preset: str) -> DepthMap:
    """One plane for all lenses that show it."""
    shown = found.evidence >= LEAST_EVIDENCE
    sizes = found.plane.at(lattice.centres())
    again, perhaps = recurring(gray, lattice.indices(), sizes, shown)
    sure = found.confidence * (SURE if perhaps else 1.0)
    reason = np.where(shown, np.where(again, 2, 0), 1)
    return on_one_plane(found.plane, lattice, preset, reason, sure * shown, {"plane": 1 - found.sampled})


def on_one_plane(
    plane: Plane, lattice: Lattice, preset: str, reason: NDArray, confidence: NDArray, saved: dict[str, float]
) -> DepthMap:
    """The depth of a scene that is one plane, for the lenses whose `reason` is 0."""
    centres = lattice.centres()
    sizes = plane.at(centres)
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].cells)
    surface = np.empty(shape, np.float32)
    for top in range(0, shape[0], _STRIP):
        strip = surface[top : top + _STRIP]
        v, u = np.mgrid[top : top + len(strip), : shape[1]]
        strip[:] = plane.at(np.stack([first[0] + spacing * u, first[1] + spacing * v], -1).reshape(-1, 2)).reshape(
            u.shape
        )
    return DepthMap(
        patch_size=np.where(reason == 0, sizes, np.nan),
        standard_error=np.where(reason == 0, plane.standard_error(centres), np.inf),
        confidence=confidence,
        drawn=sizes.astype(np.float32),
        surface=Surface(surface, first, spacing),
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=reason,
        saved=saved,
    )


def regular_plane(
    lattice: Lattice,
    sizes: NDArray[np.float32],
    errors: NDArray[np.float32],
    resolved: NDArray[np.bool_],
    astray: NDArray,
    neighbours: NDArray[np.int32],
) -> Plane | None:
    """The plane that all lenses lie on as far as they can tell: their scatter about it is then nothing but noise.

    `astray` (n,) [px] is the part of their errors that their pairs do not show.
    """
    known = resolved & np.isfinite(errors)
    if known.mean() < TEXTURED:
        return None
    centres, own = lattice.centres(), sizes.astype(np.float64)
    plane = fit_plane(centres[known], own[known], lattice.pitch)
    if plane is None or strays(np.where(known, own - plane.at(centres), np.nan), errors.astype(float), neighbours):
        return None
    return replace(plane, misled=float(np.median(astray[known])))


def lens_by_lens(
    gray: GrayFlat,
    lattice: Lattice,
    preset: str,
    shortcuts: Shortcuts,
    plain: LensStatistics,
    blank: tuple[NDArray[np.bool_], float] | None,
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
    near = np.ones(len(lattice), bool)
    known = None
    if kept is not None and before is not None:
        # Lenses beside those with a new answer support them, and so do those beside these.
        near = grown(grown(~kept, neighbours), neighbours)
        known = np.where(near, np.nan, before.drawn).astype(np.float32)
    noise = None if overview is None else overview.noise
    texture = find_texture(gray, lattice, plain, blank, grown(near, neighbours), noise)
    some = texture.clear | texture.faint
    active = near if blank is None else near & some
    clear = texture.clear & active
    # A few clear lenses say nothing about the depths of all the faint ones.
    sample = None
    if shortcuts.ranges and overview is None and clear.sum() >= _FEWEST_CLEAR:
        sample = sample_lenses(lattice, clear, int(np.clip(clear.sum() * _SAMPLE_SHARE, _LEAST_SAMPLE, _SAMPLE)))
    sizes = overview.sizes if overview is not None and shortcuts.ranges and len(overview.sizes) else None
    found = search(Matcher(texture, forward, backward, setting), active, texture.clear, sample, known, sizes)
    doubtful = texture.faint | shaded(texture.clear & near, found, texture.statistics.contrast, lattice.pitch)
    textured = near & ((texture.clear & ~doubtful) | (doubtful & credible(found, lattice.pitch)))
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    maybe = near & doubtful & ~textured & possible(found)
    first = np.where(textured | maybe, found.patch_size, np.nan).astype(np.float32)
    lenses = measure(texture.flat, forward, backward, first, scale, texture.noise, setting.iterations)
    measured = np.isfinite(lenses.patch_size)
    refined = np.where(measured, lenses.patch_size, found.patch_size)
    error = np.where(measured, lenses.standard_error, np.inf)
    textured |= maybe & moving(refined, error, lattice.pitch)
    signal = signal_share(texture)
    astray = misled(error, found.explained / signal)
    reason, error, sure = judged(textured, found, refined, error, signal, neighbours, lattice.pitch)
    again, perhaps = recurring(texture.flat, lattice.indices(), refined, reason == 0)
    little = hardly_seen(texture.flat, refined, reason == 0)
    perhaps = perhaps or unexplained(found.explained / signal, signal, reason == 0, little)
    reason[again] = 2
    sure = SURE * sure if perhaps else sure
    if kept is not None and before is not None:
        refined, error, sure, reason = (
            np.where(kept, earlier, new)
            for earlier, new in (
                (before.drawn, refined),
                (before.standard_error, error),
                (before.confidence, sure),
                (before.reason, reason),
            )
        )
    resolved = reason == 0
    plane = None
    if kept is None and overview is None:
        plane = regular_plane(lattice, refined, error, resolved, astray, neighbours)
    if plane is not None:
        # A plane confirms what few pairs at the border of the flat could not.
        own = plane.at(lattice.centres())
        near_plane = (np.abs(refined - own) <= 2 * AGREED * lattice.pitch) & (np.abs(own) <= RESOLVABLE * lattice.pitch)
        reason = np.where((reason == 3) & near_plane & (found.confidence >= SURE), 0, reason)
        level = on_one_plane(plane, lattice, preset, reason, sure, _saved(shortcuts, some, found, sample, kept))
        return level, astray
    gap = max(1.0, 0.05 * lattice.pitch)
    guess = found.patch_size if known is None else np.where(np.isfinite(known), known, found.patch_size)
    guess = _within_reach(guess, refined, reason, lattice.pitch)
    drawn = fill(np.where(resolved, refined, guess).astype(np.float32), resolved, neighbours, gap)
    occurring = refined[resolved] if overview is None else overview.sizes
    seconds = np.where(textured & populated(found.second, occurring, gap), found.second, np.nan).astype(np.float32)
    evidence = np.where(near, found.evidence, 1)
    around = occurring if shortcuts.ranges else None
    rest = np.full(len(drawn), np.nan, np.float32)
    if setting.remainder:
        rest = remainder_depths(texture, forward, backward, drawn, evidence, setting, around)
    # Shading matches itself near zero: a depth there must occur by itself.
    rest[(np.abs(rest) < SHADED_REACH * lattice.pitch) & ~populated(rest, occurring, gap)] = np.nan
    trust = np.where(resolved, sure, 0.05).astype(np.float32)
    old, settled = None if before is None else before.surface, None if kept is None else ~grown(~kept, neighbours)
    others = np.stack([seconds, rest], 1)
    surface = spread(texture.flat, lattice, drawn, others, trust, texture.noise, setting.cells, settled, old)
    # A lens that sees two depths answers with the one in its middle.
    middle = surface.at(lattice.centres())
    crossed = resolved & (np.abs(middle - drawn) > gap)
    crossed &= (np.abs(middle - seconds) <= gap) | (np.abs(middle - rest) <= gap)
    crossed[crossed] = _level_about(surface, lattice.centres()[crossed], middle[crossed], gap)
    if kept is not None:
        crossed &= ~kept
    saved = _saved(shortcuts, some, found, sample, kept)
    depth = DepthMap(
        patch_size=np.where(crossed, middle, np.where(resolved, refined, np.nan)),
        standard_error=np.where(crossed, np.maximum(error, found.step), np.where(resolved, error, np.inf)),
        confidence=np.where(crossed | ~resolved, SURE * sure, sure),
        drawn=np.where(crossed, middle, drawn),
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=reason,
        saved=saved,
    )
    return depth, astray


def _within_reach(guess: NDArray, refined: NDArray, reason: NDArray[np.int8], pitch: float) -> NDArray:
    """First guesses of unresolved lenses; those without texture that end where no depth is resolvable start anew.

    Costs that are all alike have their minimum at an end of the range. Drawn there, a blank place would be read at
    the rims of microimages.
    """
    astray = (reason == 1) & (np.abs(guess) > RESOLVABLE * pitch)
    known = refined[reason == 0]
    return np.where(astray, np.median(known) if known.size else _UNTOLD * pitch, guess)


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
    some: NDArray[np.bool_],
    found: Found,
    sample: NDArray[np.bool_] | None,
    kept: NDArray[np.bool_] | None,
) -> dict[str, float]:
    saved = {}
    if shortcuts.blank:
        saved["blank"] = float(1 - some.mean())
    if sample is not None:
        saved["ranges"] = found.untried
    if kept is not None:
        saved["still"] = float(kept.mean())
    return saved
