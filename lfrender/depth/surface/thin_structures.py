"""Thin things before a far surface, from lens to lens.

Microimages that are shifted by half a pitch share no more than their rims: at that depth nothing confirms what the
middle of a lens shows, so that a branch there is not missed either (`remainder.py`). But a branch runs on, and at the
depth that one lens tells of it the next one shows a few pixels that its neighbours confirm.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ...flat.gray_flat import downsample
from ...flat.lens_graph import join_opposite
from ...flat.microimages import copy_box
from ...flat.texture import Texture
from .window_differences import window_differences, window_variance

__all__ = ["find_thin_structures"]

# Lenses beyond this share of the pitch share too little with others.
_SHARING_LITTLE = 0.4
# Pitch [px] at which lenses are compared, about, where the flat's is larger: 3 x 3 pixels fit into a twentieth of it.
_PITCH = 60
# Of places that vary over 3 x 3 pixels by more than so many times the least difference, one is confirmed by lenses that
# differ from it by no more than a share of that, and this: so many times the noise. That takes half of all neighbours,
# and so many.
_TEXTURED, _CONFIRMED, _NOISES, _FEWEST = np.float32(3.0), np.float32(0.7), 4.0, 2.0
# A thing is seen where so much of a microimage is confirmed, at least the second number of places, and so many times as
# much as at depths this share of the pitch beside it: whatever repeats is confirmed there as well.
_LEAST, _FEWEST_PLACES, _MORE, _BESIDE = 0.005, 3, 2.0, 0.13
# Such 3 x 3 pixels reach a pixel farther.
_BORDER = 1.0
# Lenses ask those beside them so many times at most: so many lenses long a thing may be.
_LONGEST = 60
# Patch sizes that differ by less than this share of a gap are tried once.
_SAME = 0.5
# Patch sizes tried on one lens are told apart within so many numbers.
_KEYS = 1 << 20
# What is known of each lens.
_FIRST, _REST, _TOLD, _SECOND = range(4)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _add_where_within(view, limits, number, out):
    """Count one more at each of so many places where another lens differs by no more than the limit there."""
    one, none = np.float32(1), np.float32(0)
    for k in range(np.uint64(number)):
        out[k] += one if view[k] <= limits[k] else none


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _confirm(
    pixels, height, width, centres, lens, radius, s, pitch, rows, left, top, wide, own, there, squares, lines, view,
    limits, out,
):  # fmt: skip
    """Set `out` to 1 where half of the neighbours of a lens confirm at `s` what it shows, to within `limits`, and to 0
    elsewhere; returns how often."""
    number, seen = (wide - 2) * wide, 0
    out[:number] = 0
    for k in range(rows.shape[1]):
        other = rows[lens, k]
        if other >= 0:
            window_differences(
                pixels, height, width, centres[lens, 0], centres[lens, 1], centres[other, 0], centres[other, 1], radius,
                s, pitch, left, top, wide, 1, 1, own, there, squares, lines, view, 0,
            )  # fmt: skip
            _add_where_within(view, limits, number, out)
            seen += 1
    enough, count = np.float32(max(0.5 * seen, _FEWEST)), 0
    for k in range(number):
        out[k] = np.float32(1) if out[k] >= enough else np.float32(0)
        count += int(out[k])
    return count


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _set_limits(image, ax, ay, radius, left, top, wide, floor, limits):
    """Sums over 3 x 3 squared differences up to which places of a microimage are confirmed, -1 where they show too
    little texture to tell; returns how many places there are."""
    height, width = image.shape
    limits[:] = -1
    total = 0
    for v in range(1, wide - 1):
        y = top + v
        half = radius * radius - (y - ay) * (y - ay)
        if half < 0 or y < 1 or y >= height - 1:
            continue
        half = np.sqrt(half)
        for x in range(max(1, int(np.ceil(ax - half))), min(width - 2, int(np.floor(ax + half))) + 1):
            total += 1
            varied = window_variance(image, x, y)
            if varied >= _TEXTURED * floor:
                limits[(v - 1) * wide + x - left] = 9 * (_CONFIRMED * varied + floor)
    return total


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST, error_model="numpy")
def _shown(image, centres, radius, pitch, rows, lenses, sizes, firsts, floor, beside, out):
    """How much of some `lenses` (m,) is confirmed at `sizes` (m,), and not at `firsts`; 0 where that may be chance."""
    height, width = image.shape
    pixels = image.reshape(-1)
    side = int(np.ceil(radius)) + 1
    wide = 2 * side + 2
    size = wide * wide
    for task in prange(len(lenses)):
        lens, s = lenses[task], sizes[task]
        out[task] = 0.0
        own, there, view = np.empty(size, np.float32), np.zeros(size + 2 * wide, np.float32), np.empty(size, np.float32)
        squares, lines, limits = np.empty(size, np.float32), np.zeros(size, np.float32), np.empty(size, np.float32)
        here, elsewhere = np.empty(size, np.float32), np.empty(size, np.float32)
        left, top = int(centres[lens, 0]) - side, int(centres[lens, 1]) - side
        copy_box(pixels, width, left, top, wide, wide, own)
        total = _set_limits(image, centres[lens, 0], centres[lens, 1], radius, left, top, wide, floor, limits)
        least = max(int(_LEAST * total), _FEWEST_PLACES)
        count = _confirm(
            pixels, height, width, centres, lens, radius, s, pitch, rows, left, top, wide, own, there, squares, lines,
            view, limits, here,
        )  # fmt: skip
        if count < least:
            continue
        _confirm(
            pixels, height, width, centres, lens, radius, firsts[task], pitch, rows, left, top, wide, own, there,
            squares, lines, view, limits, elsewhere,
        )  # fmt: skip
        for k in range((wide - 2) * wide):
            if elsewhere[k] > 0:
                limits[k] = -1
                count -= int(here[k])
        chance = 0
        for turn in range(2):
            other = s + (beside if turn else -beside)
            chance = max(chance, _confirm(
                pixels, height, width, centres, lens, radius, other, pitch, rows, left, top, wide, own, there, squares,
                lines, view, limits, elsewhere,
            ))  # fmt: skip
        if count >= least and count > _MORE * chance:
            out[task] = count / total


def _nearness(sizes: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """As `visibility.nearness`, of many."""
    return np.where(sizes > 0, sizes, sizes + 2 * pitch)


def _news(
    known: NDArray[np.float32], rows: NDArray[np.int32], lenses: NDArray[np.int64], gap: float, pitch: float
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """What those beside some `lenses` (m,) know and these do not, before their first: lenses, and patch sizes [px].

    What is no more than their second best counts as unknown: where it is told as well, it is no false one.
    """
    beside = rows[lenses]
    heard = np.where((beside >= 0)[:, :, None], known[beside], np.nan).reshape(len(lenses), -1)
    own = known[lenses][:, None, [_FIRST, _REST, _TOLD]]
    apart = ~(np.abs(heard[:, :, None] - own) <= gap).any(2)
    at, which = np.nonzero(apart & (_nearness(heard, pitch) > _nearness(known[lenses, _FIRST, None], pitch)))
    return lenses[at], heard[at, which]


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
    asked: NDArray[np.bool_],
    gap: float,
) -> NDArray[np.float32]:
    """Patch sizes of what lenses show before the surface of their first, as lenses beside them tell of it.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    first : (n,) float32 [px]
        Finite.
    others : (n, 2) float32 [px]
        Second best patch size of each lens, and that of what the first leaves unexplained; NaN where there is none.
    asked : (n,) bool
        The other lenses are left alone.
    gap : float [px]
        Patch sizes that differ by less belong to one surface.

    Returns
    -------
    (n,) float32 [px]
        NaN where nothing is told, or where a lens beside it has that patch size as its first.
    """
    pitch = texture.flat.pitch
    asked = asked & (texture.clear | texture.faint) & (np.abs(first) > _SHARING_LITTLE * pitch)
    rows = join_opposite(forward, backward)
    if not asked.any():
        return np.full(len(first), np.nan, np.float32)
    factor = max(1, round(pitch / _PITCH))
    gray, noise = downsample(texture.flat, factor), texture.noise / factor

    def shown(lenses: NDArray[np.int64], sizes: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty(len(lenses), np.float32)
        _shown(
            gray.image, gray.centres, np.float32(gray.radius - _BORDER), np.float32(gray.pitch), rows, lenses,
            sizes / np.float32(factor), (first[lenses] / factor).astype(np.float32),
            np.float32(_NOISES * noise * noise), np.float32(_BESIDE * gray.pitch), out,
        )  # fmt: skip
        return out

    # A second best patch size is false in every fourth lens: others hear of those that are confirmed.
    second = np.flatnonzero(asked & np.isfinite(others[:, 0]))
    sure = second[shown(second, others[second, 0]) > 0]
    known = np.full((len(first), 4), np.nan, np.float32)
    known[:, _FIRST], known[:, _REST], known[sure, _SECOND] = first, others[:, 1], others[sure, 0]
    told = known[:, _TOLD]
    fresh, tried = np.ones(len(first), bool), np.empty(0, np.int64)
    for _ in range(_LONGEST):
        lenses = np.flatnonzero(asked & np.isnan(told) & ((rows >= 0) & fresh[rows]).any(1))
        if not len(lenses):
            break
        lens, size = _news(known, rows, lenses, gap, pitch)
        keys, once = np.unique(lens * _KEYS + np.rint(size / (_SAME * gap)).astype(np.int64), return_index=True)
        once = once[~np.isin(keys, tried)]
        lens, size, tried = lens[once], size[once], np.union1d(tried, keys)
        best = _best_of_each(lens, shown(lens, size))
        told[lens[best]] = size[best]
        fresh[:] = False
        fresh[lens[best]] = True
    # What a lens beside has as its first is tried on the places about this one in any case.
    spoken = (np.abs(np.where(rows >= 0, first[rows], np.nan) - told[:, None]) <= gap).any(1)
    return np.where(spoken, np.nan, told).astype(np.float32)
