"""Depth of the next frame: only lenses whose pixels or depth have changed are estimated again.

A lens keeps its depth if its pixels, and those of its neighbours, differ from the previous frame by
no more than noise, or if it still matches its neighbours at the depth it had.
"""

from __future__ import annotations

import weakref
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError, Lattice
from lfcal.runtime.kernels import FAST, kernel

from ..data.depth_map import DepthMap
from ..data.frame_state import FrameState, LocalMatch
from ..data.surface import Surface
from ..flat.gray_flat import GrayFlat
from ..flat.lens_graph import count_connected, dilate_mask, neighbour_rows
from ..flat.texture import LensStatistics, classify_texture, sample_statistics
from ..flat.validation import check_flat
from ..runtime.cache import cached
from .edges.locate_edges import locate_edges, places_of_lenses, refine_grid
from .matching.matcher import Matcher
from .matching.neighbours import neighbours_of
from .pipeline import estimate_depth_map, estimate_lens_by_lens, prepare_flat
from .presets import PRESETS, Shortcuts
from .region import rescale_depth
from .same_surface import TOLERANCE
from .surface.scene_grid import grid_shape
from .validity.textureless import find_textureless

__all__ = ["changed_since", "find_changed_lenses", "find_moved", "update_depth"]

# Groups of lenses of like brightness, and share of the quietest of each that tells its noise.
_GROUPS = 8
_QUIETEST = 0.1
# Change of a pixel that nobody sees, as by video coding [white].
_INVISIBLE = 2 / 255
# Share of the variance of a lens that motion by a quarter of a pixel exceeds.
_UNSEEN = 0.007
# [bytes] Largest grey flat that is kept for the next frame.
_MOST_BYTES = 32 << 20
# A lens has moved if its cost rises by more than this, or its minimum by more than this [px], or
# four standard errors of a difference.
_RISE = 0.15
_SHIFT = 0.1
_ERRORS = 4 * 2**0.5
# Lenses beside one that moved are in doubt from this part of both limits on.
_DOUBTFUL = 0.25


@kernel(fastmath=FAST, error_model="numpy", share=lambda before, now, centres, *_: len(centres))
def _compare(begin, end, before, now, centres, radius, side, out):
    """Per lens: mean square of the differences of pixels, and of sums over blocks of `side` x
    `side` pixels over the root of their number; number of blocks.
    """
    height, width = now.shape
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        energy = np.float32(0.0)
        sums = np.float32(0.0)
        count = 0
        for top in range(
            max(0, int(cy - radius)), min(height - side, int(cy + radius) + 1 - side) + 1, side
        ):
            y = np.float32(top + 0.5 * (side - 1)) - cy
            half = np.sqrt(max(radius * radius - y * y, np.float32(0.0)))
            for left in range(
                max(0, int(cx - half)), min(width - side, int(cx + half) + 1 - side) + 1, side
            ):
                total = np.float32(0.0)
                for row in range(top, top + side):
                    for column in range(left, left + side):
                        d = now[row, column] - before[row, column]
                        energy += d * d
                        total += d
                sums += total * total
                count += 1
        pixels = np.float32(max(count, 1) * side * side)
        out[0, lens], out[1, lens], out[2, lens] = energy / pixels, sums / pixels, max(count, 1)


def find_changed_lenses(
    before: GrayFlat, statistics: LensStatistics, now: GrayFlat
) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels differ visibly, and by more than noise, from those of a frame
    `before`.

    The noise of a difference is estimated on its smoothest lenses of like brightness, or on those
    that differ least between the frames, whichever is less. Motion below the noise of a pixel shows
    in sums over blocks.
    """
    side = 4 if now.radius >= 6 else 2
    out = np.empty((3, len(now.centres)), np.float32)
    _compare(before.image, now.image, now.centres, np.float32(now.radius), side, out)
    pixel, block, count = out
    # Noise grows with brightness: that of the tenth of lenses with the least, in eight groups, and
    # in those beside.
    noise = np.minimum(2 * statistics.roughness**2, pixel)
    edges = np.quantile(statistics.mean, np.arange(1, _GROUPS) / _GROUPS)
    group = np.searchsorted(edges, statistics.mean)
    least = 2 * now.rounding**2
    level = np.full(_GROUPS, least, noise.dtype)
    for k in np.unique(group):
        level[k] = np.quantile(noise[group == k], _QUIETEST)
    level = np.maximum(np.pad(level, 1, "edge"), least)
    allowed = np.maximum(np.maximum(level[:-2], level[2:]), level[1:-1])[group]
    unseen = _UNSEEN * statistics.contrast**2
    area = side * side
    most = np.maximum(allowed * _limit(count * area), np.maximum(_INVISIBLE**2, unseen))
    most_block = np.maximum(allowed * _limit(count), np.maximum(_INVISIBLE**2, area * unseen))
    return np.asarray((pixel > most) | (block > most_block))


def _limit(count: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of so many squares of unit noise that noise hardly ever exceeds."""
    return np.asarray(1 + 6 * np.sqrt(2 / count), np.float32)


def update_depth(
    flat: NDArray,
    calibration: Calibration,
    preset: str,
    shortcuts: Shortcuts,
    edges: bool,
    earlier: NDArray,
    before: DepthMap,
) -> DepthMap:
    """Estimate the depth of a frame from the `earlier` frame and its depth, `before`; arguments and
    errors as `analyze`.
    """
    lattice = calibration.lattice
    earlier = _check_previous(flat, calibration, preset, earlier, before)
    neighbours = neighbour_rows(lattice, lattice.steps)
    old_gray, old_statistics = _frame_of(before, earlier, calibration)
    gray, small, factor = prepare_flat(flat, calibration, preset)
    changed = find_changed_lenses(old_gray, old_statistics, gray)
    kept = ~dilate_mask(changed, neighbours)
    saved = {"still": float(kept.mean())}
    state = FrameState(changed=changed, previous=weakref.ref(before))
    if kept.all():
        state.reference, state.kept = before.frame_state.reference, before.frame_state.kept
        return _remember(
            replace(before, saved=saved, frame_state=state), gray, old_statistics, calibration
        )
    statistics = sample_statistics(gray)
    if shortcuts.steady:
        reference = _complete_reference(before, old_gray, old_statistics, small, factor)
        # Lenses with the same pixels match as they did.
        match = _match_at_depth(gray, small, statistics, before, factor, kept).where(
            kept, reference
        )
        estimated = (before.reason == 0) & match.textured
        moved, doubtful = find_moved(reference, match, estimated, before.reason, neighbours)
        moved &= ~kept
        kept |= ~(moved | (doubtful & dilate_mask(moved, neighbours)))
        saved["steady"] = float(kept.mean()) - saved["still"]
        state.reference, state.kept = reference, kept
        if kept.all():
            state.complete = reference
            return _remember(
                replace(before, saved=saved, frame_state=state), gray, statistics, calibration
            )
    if not kept.any():
        depth = estimate_depth_map(gray, small, preset, shortcuts)
        depth = locate_edges(gray, small, depth) if edges else depth
        state.reference, state.kept = None, None
    else:
        near = dilate_mask(dilate_mask(~kept, neighbours), neighbours)
        blank = (
            find_textureless(gray, small, statistics, PRESETS[preset], asked=near)
            if shortcuts.blank
            else None
        )
        old = rescale_depth(before, small, 1 / factor)
        start = replace(old, surface=_coarse_surface(old.surface, small, preset))
        depth = estimate_lens_by_lens(
            gray, small, preset, shortcuts, statistics, blank, kept, start
        )
        if edges:
            depth = _locate_new_edges(
                gray, small, depth, old.surface, dilate_mask(~kept, neighbours)
            )
        depth = replace(depth, saved={**depth.saved, **saved})
    after = replace(rescale_depth(depth, lattice, factor), frame_state=state)
    return _remember(after, gray, statistics, calibration)


def _coarse_surface(surface: Surface, lattice: Lattice, preset: str) -> Surface:
    """The surface on the grid that it has before edges are located."""
    _, first, spacing = grid_shape(lattice, PRESETS[preset].surface_cells)
    finer = round(spacing / surface.spacing)
    return (
        surface
        if finer <= 1
        else Surface(surface.patch_size[::finer, ::finer].copy(), first, spacing)
    )


def _locate_new_edges(
    gray: GrayFlat, lattice: Lattice, depth: DepthMap, old: Surface, changed: NDArray[np.bool_]
) -> DepthMap:
    """The depth map with its edges about the lenses that have `changed` (n,), and as in the `old`
    surface elsewhere.
    """
    after = locate_edges(gray, lattice, depth, changed)
    new = after.surface
    values = after.surface.patch_size
    finer = round(new.spacing / old.spacing)
    if finer > 1:
        values = refine_grid(values, finer, TOLERANCE * lattice.pitch)
        new = Surface(values, old.first, old.spacing)
    if values.shape != old.patch_size.shape:
        return after
    keep = ~places_of_lenses(changed, lattice, new)
    return replace(after, surface=replace(new, patch_size=np.where(keep, old.patch_size, values)))


def _check_previous(
    flat: NDArray, calibration: Calibration, preset: str, earlier: NDArray, before: DepthMap
) -> NDArray:
    """The earlier frame as (H, W, C), if it and its depth are of the same kind as the flat."""
    earlier = check_flat(earlier, calibration)
    if earlier.shape != flat.shape or earlier.dtype != flat.dtype:
        kinds = " and ".join(f"{a.shape[2]} x {a.dtype}" for a in (earlier, flat))
        raise FlatError(f"both frames must have the same channels and type, they have {kinds}")
    if len(before) != len(calibration.lattice) or before.preset != preset:
        raise ValueError(
            "the earlier depth map was made with another camera or preset; analyze without previous"
        )
    return earlier


def _latest_frame(
    calibration: Calibration,
) -> list[tuple[weakref.ref[DepthMap], GrayFlat, LensStatistics]]:
    """Cache of the last analysed frame of a camera: its depth map, grey flat and statistics."""
    return cached(calibration, "latest frame", list)


def _remember(
    depth: DepthMap, gray: GrayFlat, statistics: LensStatistics, calibration: Calibration
) -> DepthMap:
    """The depth map; its grey flat of up to 32 MB, with the strips cut out of it, is kept for the
    next one.
    """
    if gray.image.nbytes <= _MOST_BYTES:
        _latest_frame(calibration)[:] = [(weakref.ref(depth), gray, statistics)]
    return depth


def _frame_of(
    depth: DepthMap, flat: NDArray, calibration: Calibration
) -> tuple[GrayFlat, LensStatistics]:
    """The grey flat that a depth map belongs to, and its statistics, taken from the cache if it is
    the last one.
    """
    with suppress(IndexError):
        # Taken out, since no two threads may cut strips out of the same grey flat.
        of, gray, statistics = _latest_frame(calibration).pop()
        if of() is depth:
            return gray, statistics
    gray = prepare_flat(flat, calibration, depth.preset)[0]
    return gray, sample_statistics(gray)


def _complete_reference(
    depth: DepthMap, gray: GrayFlat, statistics: LensStatistics, lattice: Lattice, factor: int
) -> LocalMatch:
    """What all lenses are compared with: those that kept their depth with the frame it is from,
    others with theirs.
    """
    state = depth.frame_state
    if state.complete is None:
        state.complete = _match_at_depth(gray, lattice, statistics, depth, factor, state.kept)
        if state.reference is not None and state.kept is not None:
            state.complete = state.complete.where(state.kept, state.reference)
    return state.complete


def _match_at_depth(
    gray: GrayFlat,
    lattice: Lattice,
    statistics: LensStatistics,
    depth: DepthMap,
    factor: int,
    known: NDArray[np.bool_] | None,
) -> LocalMatch:
    """Match every lens at its `depth`, on pixels `factor` times as large; `known` ones (n,) only as
    neighbours.
    """
    texture = classify_texture(gray, statistics)
    matcher = Matcher(texture, neighbours_of(lattice), PRESETS[depth.preset])
    textured = texture.clear | texture.faint
    active = textured if known is None else textured & ~known
    match = matcher.match_locally(active, depth.filled_patch_size / np.float32(factor))
    return LocalMatch(*match, texture.clear, textured)


def find_moved(
    reference: LocalMatch,
    match: LocalMatch,
    estimated: NDArray[np.bool_],
    reason: NDArray[np.int8],
    neighbours: NDArray[np.int32],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Lenses whose depth may have changed, and those in doubt if one of their neighbours has.

    An `estimated` lens (n,) keeps its depth if from `reference` to `match` its cost hardly rose,
    and its minimum, together with those of two neighbours, hardly moved (`_RISE`, `_SHIFT`). Others
    are estimated if they now carry texture or match.
    """
    shift = match.offset - reference.offset
    rise = match.cost - reference.cost
    moved = estimated & (rise > _RISE)
    moved |= (reason == 0) & reference.textured & ~match.textured
    moved |= (reason != 0) & match.textured & (rise < -_RISE)
    moved |= (reason == 1) & match.clear & ~reference.clear
    # Away from a minimum the cost has no curvature, so that no error can be derived.
    error = np.minimum(reference.error, match.error)
    limit = np.maximum(np.float32(_SHIFT), np.float32(_ERRORS) * error)
    for side in (-1, 1):
        # A shift of fewer than three neighbours is noise.
        moved |= count_connected(estimated & (side * shift > limit), neighbours) >= 2
    doubtful = ~estimated | (rise > _DOUBTFUL * _RISE) | (np.abs(shift) > _DOUBTFUL * limit)
    return np.asarray(moved), np.asarray(doubtful)


def changed_since(
    before: DepthMap, after: DepthMap, earlier: NDArray, flat: NDArray, calibration: Calibration
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that show something else in `flat` than in the `earlier` one, as known from
    the analysis.
    """
    state = after.frame_state
    if state.changed is not None and state.previous is not None and state.previous() is before:
        return state.changed
    first, second = (prepare_flat(frame, calibration, after.preset)[0] for frame in (earlier, flat))
    return find_changed_lenses(first, sample_statistics(first), second)
