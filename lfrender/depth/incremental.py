"""Depth of the next frame: only lenses whose pixels or depth have changed are estimated again.

A lens keeps its depth if its pixels, and those of its neighbours, differ from the previous frame by
no more than noise, or if it still matches its neighbours at the depth it had.
"""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError

from ..data.depth_map import DepthMap, check_depth
from ..data.frame_state import FrameState, LocalMatch
from ..flat.lens_graph import count_connected, dilate_mask
from ..flat.texture import classify_texture
from ..flat.validation import check_flat
from .changed_lenses import find_changed_lenses
from .matching.matcher import Matcher
from .pipeline import estimate_part, locate_part_edges, prepare_flat
from .presets import PRESETS, Shortcuts
from .region import Part, rescale_depth

__all__ = ["changed_since", "update_depth"]

# A lens has moved if its cost rises by more than this, or its minimum by more than this [px], or
# four standard errors of a difference.
_RISE = 0.15
_SHIFT = 0.1
_ERRORS = 4 * 2**0.5
# Lenses beside one that moved are in doubt from this part of both limits on.
_DOUBTFUL = 0.25


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
    earlier = _check_previous(flat, calibration, preset, earlier, before)
    old = _part_of(earlier, calibration, preset)
    part = _part_of(flat, calibration, preset)
    factor = PRESETS[preset].factor(calibration.lattice.pitch)
    changed = find_changed_lenses(old.gray, old.statistics, part.gray)
    state = FrameState(changed=changed, previous=weakref.ref(before))
    kept = ~dilate_mask(changed, part.neighbours.all)
    saved = {"still": float(kept.mean())}
    if kept.all():
        state.reference = before.frame_state.reference
        state.kept = before.frame_state.kept
        return replace(before, saved=saved, frame_state=state)

    if shortcuts.steady:
        state.reference = _reference(old, before, factor)
        match = _match_at_depth(part, before, factor, kept)
        kept |= _find_steady(state.reference, match, before.reason, kept, part.neighbours.all)
        saved["steady"] = float(kept.mean()) - saved["still"]
    if kept.all():
        state.complete = state.reference
        depth = replace(before, saved=saved)
    else:
        if kept.any():
            earlier_depth = rescale_depth(before, part.lattice, 1 / factor)
            part = replace(part, before=earlier_depth, changed=~kept)
        else:
            state.reference = None
        depth = estimate_part(part, shortcuts)
        if edges:
            depth = locate_part_edges(part, depth)
        depth = rescale_depth(depth, calibration.lattice, factor)
        depth = replace(depth, saved={**depth.saved, **saved})
    if state.reference is not None:
        state.kept = kept
    return replace(depth, frame_state=state)


def _part_of(flat: NDArray, calibration: Calibration, preset: str) -> Part:
    gray, lattice, _ = prepare_flat(flat, calibration, preset)
    return Part(gray, lattice, preset)


def _check_previous(
    flat: NDArray, calibration: Calibration, preset: str, earlier: NDArray, before: DepthMap
) -> NDArray:
    """The earlier frame as (H, W, C), if it and its depth are of the same kind as the flat."""
    earlier = check_flat(earlier, calibration)
    if earlier.shape != flat.shape or earlier.dtype != flat.dtype:
        kinds = " and ".join(f"{a.shape[2]} x {a.dtype}" for a in (earlier, flat))
        raise FlatError(f"both frames must have the same channels and type, they have {kinds}")
    check_depth(before, calibration)
    if before.preset != preset:
        raise ValueError(
            "the earlier depth map was made with another preset; analyze without previous"
        )
    return earlier


def _reference(old: Part, before: DepthMap, factor: int) -> LocalMatch:
    """The match of each lens of an earlier frame that the next one is compared with.

    It is the match in the frame in which the depth of the lens was estimated. As several frames may
    be compared with this one, it is stored in the state of its depth map.
    """
    state = before.frame_state
    if state.complete is None:
        match = _match_at_depth(old, before, factor, state.kept)
        if state.reference is not None and state.kept is not None:
            match = match.where(state.kept, state.reference)
        state.complete = match
    return state.complete


def _match_at_depth(
    part: Part, depth: DepthMap, factor: int, known: NDArray[np.bool_] | None
) -> LocalMatch:
    """Match every lens at its `depth`, on pixels `factor` times as large; `known` ones (n,) only as
    neighbours.
    """
    texture = classify_texture(part.gray, part.statistics, part.statistics.noise)
    matcher = Matcher(texture, part.neighbours, PRESETS[part.preset])
    textured = texture.clear | texture.faint
    active = textured if known is None else textured & ~known
    match = matcher.match_locally(active, depth.filled_patch_size / np.float32(factor))
    return LocalMatch(*match, texture.clear, textured)


def _find_steady(
    reference: LocalMatch,
    match: LocalMatch,
    reason: NDArray[np.int8],
    still: NDArray[np.bool_],
    neighbours: NDArray[np.int32],
) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels have changed, but that match at the depth they had before.

    A lens keeps its depth if from `reference` to `match` its cost hardly rose, and its minimum,
    together with those of two neighbours, hardly moved (`_RISE`, `_SHIFT`). One without a depth, by
    its `reason` (n,), is estimated if it now carries texture or matches. Lenses with the same
    pixels, `still` (n,), match as they did.
    """
    match = match.where(still, reference)
    estimated = (reason == 0) & match.textured
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
    moved &= ~still
    return np.asarray(~(moved | (doubtful & dilate_mask(moved, neighbours))))


def changed_since(
    before: DepthMap, after: DepthMap, earlier: NDArray, flat: NDArray, calibration: Calibration
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that show something else in `flat` than in the `earlier` one, as known from
    the analysis.
    """
    state = after.frame_state
    if state.changed is not None and state.previous is not None and state.previous() is before:
        return state.changed
    old = _part_of(earlier, calibration, after.preset)
    now = _part_of(flat, calibration, after.preset)
    return find_changed_lenses(old.gray, old.statistics, now.gray)
