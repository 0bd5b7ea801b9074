"""The depth of a frame after another: what lenses that show the same, or the same depth, need not be asked again."""

from __future__ import annotations

import weakref
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError, Lattice, OutputError
from lfcal.runtime.output_file import atomic_write

from ..data.depth_map import DepthMap
from ..data.region import rescale_depth
from ..flat.gray_flat import GrayFlat
from ..flat.lens_graph import count_connected, dilate_mask, neighbour_rows, opposite_neighbours
from ..flat.texture import LensStatistics, classify_texture, sample_statistics
from ..flat.validation import check_flat
from ..runtime.cache import cached
from .changed_lenses import find_changed_lenses
from .matching.matcher import Matcher
from .matching.shortcuts import Shortcuts
from .pipeline import estimate_depth_map, estimate_lens_by_lens, prepare_flat
from .presets import PRESETS
from .validity.textureless import find_textureless

__all__ = ["changed_since", "load_reference_match", "save_reference_match", "update_depth"]

# Brightness of flats of no more bytes than this is kept until the next frame.
_MOST_KEPT = 1 << 25
# A lens still shows its depth where it matches there no worse than it did, by this much, and the best match about it
# has not moved to one side by the second number [px of the search] and so many standard errors of one pair, neither
# there nor in so many lenses beside it.
_WORSE, _MOVED, _SURELY, _TOGETHER = 0.15, 0.1, 4.0, 2
# Beside one that may not, it is not asked again either where it is worse and has moved by less than this share of that.
_HARDLY = 0.25


def update_depth(
    flat: NDArray, calibration: Calibration, preset: str, shortcuts: Shortcuts, earlier: NDArray, before: DepthMap
) -> DepthMap:
    """The depth of a frame after another: only lenses that show something else, or whose neighbours do, are new.

    Parameters
    ----------
    flat : (H, W, C) array
        Checked already.
    calibration, preset
        As for `analyze`.
    shortcuts : Shortcuts
    earlier : array
        The earlier frame.
    before : DepthMap
        Its depth.

    Raises
    ------
    FlatError
        If the frames are not of one kind.
    ValueError
        If the earlier depth is of another camera or preset.
    """
    lattice = calibration.lattice
    earlier = check_flat(earlier, calibration)
    if earlier.shape != flat.shape or earlier.dtype != flat.dtype:
        kinds = " and ".join(f"{a.shape[2]} x {a.dtype}" for a in (earlier, flat))
        raise FlatError(f"both frames must have the same channels and type, they have {kinds}")
    if len(before) != len(lattice) or before.preset != preset:
        raise ValueError("the earlier depth map was made with another camera or preset; analyze without previous")
    neighbours = neighbour_rows(lattice, lattice.steps)
    changed = find_changed_lenses(earlier, flat, calibration)
    kept = ~dilate_mask(changed, neighbours)
    saved = {"still": float(kept.mean())}
    if kept.all():
        after = _noted(replace(before, saved=saved), before, changed)
        cached(after, "kept probe", lambda: _kept_probe(before))
        return after
    gray, small, factor = prepare_flat(flat, calibration, preset)
    plain = sample_statistics(gray)
    then = None
    if shortcuts.steady:
        then = cached(
            before, "probe", lambda: _first_probe(*_frame_of(before, earlier, calibration), small, before, factor)
        )
        # What shows the same matches as it did.
        probe = _probe(gray, small, plain, before, factor, kept).but(then, kept)
        told = (before.reason == 0) & probe.textured
        unsteady, doubtful = find_moved(then, probe, told, before.reason, neighbours)
        unsteady &= ~kept
        kept |= ~(unsteady | (doubtful & dilate_mask(unsteady, neighbours)))
        saved["steady"] = float(kept.mean()) - saved["still"]
        if kept.all():
            return _noted(replace(before, saved=saved), before, changed, then)
    if not kept.any():
        return _noted(
            rescale_depth(estimate_depth_map(gray, small, preset, shortcuts), lattice, factor), before, changed
        )
    asked = dilate_mask(dilate_mask(~kept, neighbours), neighbours)
    blank = find_textureless(gray, small, plain, PRESETS[preset], asked=asked) if shortcuts.blank else None
    depth, _ = estimate_lens_by_lens(
        gray, small, preset, shortcuts, plain, blank, kept, rescale_depth(before, small, 1 / factor)
    )
    after = rescale_depth(depth, lattice, factor, {**depth.saved, **saved})
    if gray.image.nbytes <= _MOST_KEPT:
        # The strips that were cut out of it stay as well.
        _latest_frame(calibration)[:] = [(weakref.ref(after), gray, plain)]
    return _noted(after, before, changed, then, kept)


def _latest_frame(calibration: Calibration) -> list[tuple[weakref.ref[DepthMap], GrayFlat, LensStatistics]]:
    """Of the frame that was analysed last after another: its depth map, brightness and the statistics of that."""
    return cached(calibration, "latest frame", list)


def _frame_of(depth: DepthMap, flat: NDArray, calibration: Calibration) -> tuple[GrayFlat, LensStatistics]:
    """Brightness of the frame that a depth map belongs to, and the statistics of that."""
    with suppress(IndexError):
        # Frames mostly follow each other. No two threads may cut strips out of the same brightness.
        of, gray, plain = _latest_frame(calibration).pop()
        if of() is depth:
            return gray, plain
    gray = prepare_flat(flat, calibration, depth.preset)[0]
    return gray, sample_statistics(gray)


@dataclass(frozen=True)
class LocalMatch:
    """How lenses match at and about the depth they had.

    Parameters
    ----------
    cost : (n,) float32
        At that depth.
    offset : (n,) float32 [px of the search]
        From there to the least cost.
    error : (n,) float32 [px of the search]
        Standard error of that for one pair.
    clear, textured : (n,) bool
        Lenses with texture, and with any that a match may tell from noise.
    """

    cost: NDArray[np.float32]
    offset: NDArray[np.float32]
    error: NDArray[np.float32]
    clear: NDArray[np.bool_]
    textured: NDArray[np.bool_]

    def but(self, other: LocalMatch, where: NDArray[np.bool_]) -> LocalMatch:
        """This one, but for some lenses, which are as in another."""
        return LocalMatch(*(np.where(where, getattr(other, f.name), getattr(self, f.name)) for f in fields(LocalMatch)))


def _first_probe(gray: GrayFlat, plain: LensStatistics, lattice: Lattice, depth: DepthMap, factor: int) -> LocalMatch:
    """The probe of the frame that a depth belongs to.

    Lenses that have kept their depth from a frame before are compared with that one for good, or many small changes
    would pass.
    """
    then, kept = _kept_probe(depth)
    probe = _probe(gray, lattice, plain, depth, factor, kept)
    return probe if then is None or kept is None else probe.but(then, kept)


def _kept_probe(depth: DepthMap) -> tuple[LocalMatch | None, NDArray[np.bool_] | None]:
    """The probe that lenses are compared with which have kept their depth from a frame before, and which these are."""
    return cached(depth, "kept probe", lambda: (None, None))


def save_reference_match(depth: DepthMap, path: Path) -> None:
    """Save what later frames are compared with where lenses have kept their `depth` from frame to frame.

    Without it, changes that are small from one frame to the next would pass for good once that was loaded from a file.
    """
    then, kept = _kept_probe(depth)
    if then is not None and kept is not None:
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez(file, kept=kept, **{f.name: getattr(then, f.name) for f in fields(LocalMatch)})


def load_reference_match(depth: DepthMap, path: Path) -> None:
    """Have later frames compared with what was saved of a `depth` that comes from a file itself, if anything was.

    Raises
    ------
    OutputError
        If the file is damaged.
    """
    if not path.exists():
        return
    try:
        with np.load(path) as file:
            then = LocalMatch(*(file[f.name] for f in fields(LocalMatch)))
            cached(depth, "kept probe", lambda: (then, file["kept"]))
    except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
        raise OutputError(f"{path}: damaged ({error}); render everything anew (--overwrite)") from error


def _probe(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    depth: DepthMap,
    factor: int,
    known: NDArray[np.bool_] | None = None,
) -> LocalMatch:
    """Match every lens at what is drawn of it in `depth`, in pixels `factor` times as small.

    Lenses that are `known` are matched for the others only.
    """
    texture = classify_texture(gray, plain)
    matcher = Matcher(texture, *opposite_neighbours(lattice), PRESETS[depth.preset])
    textured = texture.clear | texture.faint
    about = (depth.filled_patch_size / np.float32(factor * matcher.factor)).astype(np.float32)
    active = textured if known is None else textured & ~known
    return LocalMatch(*matcher.match_locally(active, about), texture.clear, textured)


def find_moved(
    then: LocalMatch,
    now: LocalMatch,
    told: NDArray[np.bool_],
    reason: NDArray[np.int8],
    neighbours: NDArray[np.int32],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Lenses whose depth may be another one: they match worse there, or better beside it, together with others.

    Of those without an answer, those that now carry texture, or match where they are drawn. And those that are in doubt
    if one beside them is of these.
    """
    moved = now.offset - then.offset
    found = told & (now.cost > then.cost + _WORSE)
    found |= (reason == 0) & then.textured & ~now.textured
    found |= (reason != 0) & now.textured & (now.cost < then.cost - _WORSE)
    found |= (reason == 1) & now.clear & ~then.clear
    least = np.maximum(_MOVED, np.float32(_SURELY) * np.hypot(then.error, now.error))
    for side in (-1, 1):
        found |= count_connected(told & (side * moved > least), neighbours) >= _TOGETHER
    doubtful = ~told | (now.cost > then.cost + _HARDLY * _WORSE) | (np.abs(moved) > np.float32(_HARDLY) * least)
    return np.asarray(found), np.asarray(doubtful)


def _noted(
    after: DepthMap,
    before: DepthMap,
    changed: NDArray[np.bool_],
    then: LocalMatch | None = None,
    kept: NDArray[np.bool_] | None = None,
) -> DepthMap:
    """`after`, with notes for `changed_since` and for the frame that follows it."""
    reference = weakref.ref(before)
    cached(after, "changed", lambda: (reference, changed))
    if then is not None and kept is None:
        cached(after, "probe", lambda: then)
        kept = np.ones(len(changed), bool)
    if then is not None:
        cached(after, "kept probe", lambda: (then, kept))
    return after


def changed_since(
    before: DepthMap, after: DepthMap, earlier: NDArray, flat: NDArray, calibration: Calibration
) -> NDArray[np.bool_]:
    """(n,) bool: lenses that show something else in `flat` than in the `earlier` one, as known from the analysis."""
    reference, changed = cached(after, "changed", lambda: (None, None))
    if reference is not None and changed is not None and reference() is before:
        return changed
    return find_changed_lenses(earlier, flat, calibration)
