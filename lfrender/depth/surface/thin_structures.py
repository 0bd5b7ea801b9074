"""Thin structures before a far surface, propagated from lens to lens.

Microimages that are shifted by half a pitch share only their rims: at that depth no neighbour confirms the middle of a
lens, so that a branch there does not show as a second layer either. But a branch runs on: at the depth that one lens
has for it, the next one shows a few pixels that its neighbours confirm.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import downsample
from ...flat.lens_graph import join_opposite
from ...flat.texture import Texture
from ..refinement.pair_pixels import flat_pixels
from ..same_surface import same_surface
from .settings import ThinStructureSettings
from .window_differences import (
    BORDER,
    add_where_within,
    copy_windows,
    inner_columns,
    new_windows,
    window_differences,
    window_variance,
)

__all__ = ["find_thin_structures"]

_DEFAULT = ThinStructureSettings()
# Rounded patch sizes of one lens are below this number; with the row of the lens they form one key.
_KEYS = 1 << 20
# Columns of the known patch sizes of each lens.
_FIRST, _LAYER, _FOUND, _SECOND = range(4)

# Values of `ThinStructureSettings` for kernels; `floor` is the variance that counts as none, `beside` is in px.
_Constants = namedtuple(
    "_Constants",
    "textured confirmed floor beside fewest_views least_share fewest_pixels over_chance",
)  # fmt: skip


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _confirm(flat, windows, centres, lens, radius, s, pitch, rows, fewest, view, limits, out):
    """Set `out` to 1 at pixels of a lens that half of its neighbours confirm at `s` to within `limits`, and to 0
    elsewhere; returns their number."""
    number, seen = (windows.stride - 2) * windows.stride, 0
    out[:number] = 0
    for k in range(rows.shape[1]):
        other = rows[lens, k]
        if other >= 0:
            window_differences(
                flat, windows, centres[lens, 0], centres[lens, 1], centres[other, 0], centres[other, 1], radius, s,
                pitch, 1, 1, view, 0,
            )  # fmt: skip
            add_where_within(view, 0, limits, number, out)
            seen += 1
    enough, count = np.float32(max(0.5 * seen, fewest)), 0
    for k in range(number):
        out[k] = np.float32(1) if out[k] >= enough else np.float32(0)
        count += int(out[k])
    return count


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _set_limits(image, ax, ay, radius, windows, c, limits):
    """Sums of squared differences up to which windows of a microimage are confirmed, -1 where they have too little
    texture; returns the number of its pixels."""
    height, width = image.shape
    left, top = windows.corner[0], windows.corner[1]
    limits[:] = -1
    total = 0
    for v in range(1, windows.stride - 1):
        first, last = inner_columns(top + v, ax, ay, radius, height, width)
        for x in range(first, last + 1):
            total += 1
            variance = window_variance(image, x, top + v)
            if variance >= c.textured * c.floor:
                limits[(v - 1) * windows.stride + x - left] = 9 * (c.confirmed * variance + c.floor)
    return total


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _confirmed_share(image, centres, radius, pitch, rows, lens, s, first, c):
    """Share of the pixels of a lens that are confirmed at `s`, and not at `first`; 0 where that may be chance."""
    flat, windows = flat_pixels(image), new_windows(radius)
    size, fewest = windows.stride * windows.stride, c.fewest_views
    view, limits = np.empty(size, np.float32), np.empty(size, np.float32)
    here, elsewhere = np.empty(size, np.float32), np.empty(size, np.float32)
    copy_windows(flat, centres[lens, 0], centres[lens, 1], windows)
    total = _set_limits(image, centres[lens, 0], centres[lens, 1], radius, windows, c, limits)
    least = max(int(c.least_share * total), c.fewest_pixels)
    count = _confirm(flat, windows, centres, lens, radius, s, pitch, rows, fewest, view, limits, here)
    if count < least:
        return 0.0
    _confirm(flat, windows, centres, lens, radius, first, pitch, rows, fewest, view, limits, elsewhere)
    for k in range((windows.stride - 2) * windows.stride):
        if elsewhere[k] > 0:
            limits[k] = -1
            count -= int(here[k])
    chance = 0
    for turn in range(2):
        other = s + (c.beside if turn else -c.beside)
        found = _confirm(flat, windows, centres, lens, radius, other, pitch, rows, fewest, view, limits, elsewhere)
        chance = max(chance, found)
    return count / total if count >= least and count > c.over_chance * chance else 0.0


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", share=lambda *given: len(given[5]))
def _measure_shares(begin, end, image, centres, radius, pitch, rows, lenses, sizes, firsts, constants: _Constants, out):
    """As `_confirmed_share` for some `lenses` (m,), with `sizes` and `firsts` (m,)."""
    for task in range(begin, end):
        out[task] = _confirmed_share(
            image, centres, radius, pitch, rows, lenses[task], sizes[task], firsts[task], constants
        )


def _depth_order(sizes: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """As `occlusion.depth_order`, of many."""
    return np.where(sizes > 0, sizes, sizes + 2 * pitch)


def _new_hypotheses(
    known: NDArray[np.float32], rows: NDArray[np.int32], lenses: NDArray[np.int64], gap: float, pitch: float
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Patch sizes [px] of neighbours that some `lenses` (m,) do not have, before their first one: lenses, and sizes.

    The second-best match of a lens counts as one it does not have: confirmed by a neighbour it is no false match.
    """
    beside = rows[lenses]
    others = np.where((beside >= 0)[:, :, None], known[beside], np.nan).reshape(len(lenses), -1)
    own = known[lenses][:, None, [_FIRST, _LAYER, _FOUND]]
    new = ~same_surface(others[:, :, None], own, gap).any(2)
    at, which = np.nonzero(new & (_depth_order(others, pitch) > _depth_order(known[lenses, _FIRST, None], pitch)))
    return lenses[at], others[at, which]


def _best_of_each(lens: NDArray[np.int64], share: NDArray[np.float32]) -> NDArray[np.int64]:
    """Where each of the lenses has its largest share, of those that have any."""
    order = np.lexsort((share, lens))
    order = order[share[order] > 0]
    last = np.ones(len(order), bool)
    last[:-1] = np.diff(lens[order]) > 0
    return order[last]


def find_thin_structures(
    texture: Texture,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    first: NDArray[np.float32],
    others: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    gap: float,
    settings: ThinStructureSettings = _DEFAULT,
) -> NDArray[np.float32]:
    """Patch sizes of thin structures that lenses show before their first surface, propagated from their neighbours.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    first : (n,) float32 [px]
        Finite.
    others : (n, 2) float32 [px]
        Second-best patch size of each lens, and that of its second layer; NaN where there is none.
    wanted : (n,) bool
        The other lenses are left out.
    gap : float [px]
        Patch sizes that differ by less belong to one surface.
    settings : ThinStructureSettings

    Returns
    -------
    (n,) float32 [px]
        NaN where there is no such structure, or where a neighbour has that patch size as its first.
    """
    pitch = texture.flat.pitch
    wanted = wanted & (texture.clear | texture.faint) & (np.abs(first) > settings.least_patch_size * pitch)
    rows = join_opposite(forward, backward)
    if not wanted.any():
        return np.full(len(first), np.nan, np.float32)
    factor = max(1, round(pitch / settings.pitch))
    gray, noise = downsample(texture.flat, factor), texture.noise / factor
    constants = _Constants(
        np.float32(settings.textured), np.float32(settings.confirmed), np.float32(settings.noise * noise * noise),
        np.float32(settings.beside * gray.pitch), settings.fewest_views, settings.least_share, settings.fewest_pixels,
        settings.over_chance,
    )  # fmt: skip

    def confirmed(lenses: NDArray[np.int64], sizes: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty(len(lenses), np.float32)
        _measure_shares(
            gray.image, gray.centres, np.float32(gray.radius - BORDER), np.float32(gray.pitch), rows, lenses,
            sizes / np.float32(factor), (first[lenses] / factor).astype(np.float32), constants, out,
        )  # fmt: skip
        return out

    # A second-best patch size is false in every fourth lens: only confirmed ones are propagated.
    second = np.flatnonzero(wanted & np.isfinite(others[:, 0]))
    sure = second[confirmed(second, others[second, 0]) > 0]
    known = np.full((len(first), 4), np.nan, np.float32)
    known[:, _FIRST], known[:, _LAYER], known[sure, _SECOND] = first, others[:, 1], others[sure, 0]
    found = known[:, _FOUND]
    fresh, tried = np.ones(len(first), bool), np.empty(0, np.int64)
    for _ in range(settings.longest):
        lenses = np.flatnonzero(wanted & np.isnan(found) & ((rows >= 0) & fresh[rows]).any(1))
        if not len(lenses):
            break
        lens, size = _new_hypotheses(known, rows, lenses, gap, pitch)
        step = settings.same_hypothesis * gap
        keys, once = np.unique(lens * _KEYS + np.rint(size / step).astype(np.int64), return_index=True)
        once = once[~np.isin(keys, tried)]
        lens, size, tried = lens[once], size[once], np.union1d(tried, keys)
        best = _best_of_each(lens, confirmed(lens, size))
        found[lens[best]] = size[best]
        fresh[:] = False
        fresh[lens[best]] = True
    # The first patch size of a neighbour is a hypothesis for the points about this lens in any case.
    redundant = same_surface(np.where(rows >= 0, first[rows], np.nan), found[:, None], gap).any(1)
    return np.where(redundant, np.nan, found).astype(np.float32)
