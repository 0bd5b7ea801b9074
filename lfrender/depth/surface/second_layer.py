"""A second depth inside a microimage: what its first depth leaves unexplained is matched again.

A thin branch fills too little of a microimage to show in the correlation of the whole. But its pixels are those that
no neighbour confirms at the depth of the rest, and they agree with the neighbours at another depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square

from ...flat.lens_graph import join_opposite
from ...flat.microimages import copy_box
from ...flat.texture import Texture
from ...runtime.scheduling import plan_chunks
from ..matching.matcher import Matcher
from ..matching.peaks import confidence, fit_parabola
from ..matching.sgm import aggregate_costs
from ..presets import Preset
from .window_differences import window_differences, window_variance

__all__ = ["find_second_layer"]

# Pitch [px] it is matched at, where the flat's is larger: a rod a tenth of a pitch wide is four pixels wide there.
_PITCH = 40
# Lenses that correlate more than this with their neighbours have nothing unexplained that could be matched.
_EXPLAINED = 0.8
# A place is unexplained when, over 3 x 3 pixels, it differs from the better half of the neighbours by this share of
# the variance about it, by the second share of that of the lens, and by so many times that of the noise.
_SHARE, _OF_LENS, _NOISES = np.float32(1.0), np.float32(0.2), 6.0
# Such 3 x 3 pixels reach a pixel farther.
_BORDER = np.float32(1.0)
# So much of a microimage must be unexplained: less is an edge that interpolation has blurred.
_LEAST = 0.012
# Share of a microimage that must be unexplained, and shown by the neighbour too, for a match to count half.
_HALF_TRUST = 0.012
# Part of a difference in mean brightness that counts as mismatch, as in the first match.
_OFFSET_WEIGHT = np.float32(0.5)
# Prices of semi-global matching, per pixel of shift and at most: lower than of the first depth, since thin things end.
_SLOPE, _JUMP = 0.07, 0.3
# Lenses without a remainder have no opinion: they match anywhere as well as this. Where the rest matches worse
# than the second number, or is less sure than the third, it has no depth of its own.
_NEUTRAL, _MATCHED, _SURE = 0.8, 0.65, 0.5
# It must match better than at the first depth by this much, and as many lenses beside it must show the same.
_BETTER, _TOGETHER = 0.1, 1
# It is another depth when it differs from the first by this share of the pitch.
_APART = 0.04
# Beyond the depths that occur, but for so many outliers, it reaches as far as the search does beyond its samples.
_OUTSIDE, _MARGIN = 0.005, 0.12
# A least value has one shift on either side of it.
_LEAST_SHIFTS = 3


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _insert(values, count, value):
    """Put `value` into the `count` sorted `values`."""
    at = count
    while at > 0 and values[at - 1] > value:
        values[at] = values[at - 1]
        at -= 1
    values[at] = value


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _better_half(views, size, seen, at, values):
    """Mean of the better half of what the `seen` neighbours leave at place `at`; -1 where fewer than two show it."""
    count = 0
    # Branches that nothing foretells would cost more than all steps of the sorting.
    for k in range(seen):
        value = views[np.uint64(k * size + at)]
        count += int(value < np.inf)
        for n in range(k):
            less = min(values[n], value)
            value = max(values[n], value)
            values[n] = less
        values[k] = value
    total = np.float32(0.0)
    half = (count + 1) // 2
    for k in range(half):
        total += values[k]
    return total / (9 * half) if count > 1 else np.float32(-1.0)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _count_within(views, size, count, seen, limit, out):
    """How many of the `seen` neighbours leave no more than `limit` at each of so many places."""
    one, none, most = np.float32(1), np.float32(0), np.float32(limit)
    out[:count] = 0
    for n in range(seen):
        first = np.uint64(n * size)
        for k in range(np.uint64(count)):
            out[k] += one if views[first + k] <= most else none


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _unexplained(image, centres, radius, pitch, rows, sizes, wanted, contrast, floor, row_step, mask, shares):
    """Set `mask` (H, W) to 1 at the pixels of `wanted` lenses that `sizes` do not explain, and to 0 at the others."""
    height, width = image.shape
    pixels = image.reshape(-1)
    side = int(np.ceil(radius)) + 1
    most, wide = rows.shape[1], 2 * side + 2
    size = wide * wide
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        own, there = np.empty(size, np.float32), np.zeros(size + 2 * wide, np.float32)
        squares, lines = np.empty(size, np.float32), np.zeros(size, np.float32)
        views, values = np.empty(most * size, np.float32), np.empty(most, np.float32)
        confirming = np.empty(size, np.float32)
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
            shares[lens] = 0.0
            if not wanted[lens]:
                continue
            ax, ay = centres[lens, 0], centres[lens, 1]
            left, top = int(ax) - side, int(ay) - side
            least = floor + _OF_LENS * contrast[lens] * contrast[lens]
            begin_row = 1 + -(top + 1) % row_step
            number = (wide - 2 - begin_row) // row_step + 1
            copy_box(pixels, width, left, top, wide, wide, own)
            seen = total = unexplained = 0
            for k in range(most):
                other = rows[lens, k]
                if other >= 0:
                    window_differences(
                        pixels, height, width, ax, ay, centres[other, 0], centres[other, 1], radius, sizes[lens],
                        pitch, left, top, wide, begin_row, row_step, own, there, squares, lines, views, seen * size,
                    )  # fmt: skip
                    seen += 1
            _count_within(views, size, number * wide, seen, 9 * least, confirming)
            for row in range(number):
                y = top + begin_row + row * row_step
                half = radius * radius - (y - ay) * (y - ay)
                if half < 0 or y < 1 or y >= height - 1:
                    continue
                half = np.sqrt(half)
                first, last = max(1, int(np.ceil(ax - half))), min(width - 2, int(np.floor(ax + half)))
                total += max(last - first + 1, 0)
                for x in range(first, last + 1):
                    mask[y, x] = 0
                    at = row * wide + x - left
                    # Where half of all confirm it, so does the better half.
                    if 2 * confirming[at] >= seen:
                        continue
                    difference = _better_half(views, size, seen, at, values)
                    # What is below the least need not be compared with the variance about it.
                    if difference > least and difference > _SHARE * window_variance(image, x, y) + least:
                        mask[y, x] = 1
                        unexplained += 1
            shares[lens] = unexplained / max(total, 1)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _masked(image, mask, ax, ay, radius, row_step, xs, ys, places, values):
    """Put the masked pixels of a microimage one after the other; returns how many there are."""
    height, width = mask.shape
    count = 0
    top, bottom = max(0, int(np.ceil(ay - radius))), min(height - 1, int(np.floor(ay + radius)))
    for y in range(top + -top % row_step, bottom + 1, row_step):
        half = np.sqrt(max(radius * radius - (y - ay) * (y - ay), np.float32(0.0)))
        for x in range(max(0, int(np.ceil(ax - half))), min(width - 1, int(np.floor(ax + half))) + 1):
            if mask[y, x] > 0:
                xs[count], ys[count], places[count], values[count] = x, y, y * width + x, image[y, x]
                count += 1
    return count


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _moments(pixels, height, width, xs, ys, places, values, number, bx, by, radius, tx, ty, mean):
    """Sums over those of `number` pixels of one lens whose partner, `(tx, ty)` away, lies in the other."""
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = saa = sbb = sab = np.float32(0.0)
    count = 0
    r2 = radius * radius
    qx, qy = bx - tx, by - ty
    first, last = np.float32(-x0), np.float32(width - 2 - x0)
    above, below = np.float32(-y0), np.float32(height - 2 - y0)
    away, down, right = y0 * width + x0, np.uint64(width), np.uint64(1)
    for k in range(np.uint64(number)):
        x, y = xs[k], ys[k]
        if (x - qx) * (x - qx) + (y - qy) * (y - qy) > r2 or x < first or x > last or y < above or y > below:
            continue
        at = np.uint64(places[k] + away)
        a = values[k] - mean
        b = (
            w00 * pixels[at]
            + w01 * pixels[at + right]
            + w10 * pixels[at + down]
            + w11 * pixels[at + down + right]
            - mean
        )
        count += 1
        sa += a
        sb += b
        saa += a * a
        sbb += b * b
        sab += a * b
    return count, sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _costs(image, mask, centres, radius, pitch, rows, means, wanted, shifts, floor, half, row_step, out):
    """Mismatch of the masked pixels of each `wanted` lens with the better half of its neighbours, at every shift."""
    height, width = image.shape
    pixels = image.reshape(-1)
    most = square(2 * int(radius) + 3)
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        values = np.empty(rows.shape[1], np.float32)
        xs, ys, own = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
        places = np.empty(most, np.int64)
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
            out[lens] = _NEUTRAL
            if not wanted[lens]:
                continue
            ax, ay = centres[lens, 0], centres[lens, 1]
            number = _masked(image, mask, ax, ay, radius, row_step, xs, ys, places, own)
            for k in range(len(shifts)):
                grow = 1 + shifts[k] / pitch
                shown = 0
                for d in range(rows.shape[1]):
                    other = rows[lens, d]
                    if other < 0:
                        continue
                    bx, by = centres[other, 0], centres[other, 1]
                    count, sa, sb, saa, sbb, sab = _moments(
                        pixels, height, width, xs, ys, places, own, number, bx, by, radius, (bx - ax) * grow,
                        (by - ay) * grow, means[lens],
                    )  # fmt: skip
                    if count < 4:
                        continue
                    inverse = np.float32(1.0) / count
                    ma, mb = sa * inverse, sb * inverse
                    variance = (saa + sbb) * inverse - ma * ma - mb * mb
                    offset = _OFFSET_WEIGHT * (ma - mb) * (ma - mb)
                    residual = variance - 2 * (sab * inverse - ma * mb) + offset
                    quality = (residual + floor) / (variance + offset + floor)
                    trust = count * row_step / (count * row_step + half)
                    _insert(values, shown, 1 - trust * (1 - quality))
                    shown += 1
                out[lens, k] = 1.0
                if shown >= 2:
                    better = (shown + 1) // 2
                    out[lens, k] = values[:better].sum() / better


def find_second_layer(
    texture: Texture,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    first: NDArray[np.float32],
    evidence: NDArray[np.float32],
    setting: Preset,
    around: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Patch size of what the first patch size of each lens leaves unexplained; NaN where there is nothing.

    Pixels that no better half of the neighbours confirms are correlated again over all shifts, on their own, and
    the lenses support each other as in the first search: a branch runs through one lens after the other.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    first : (n,) float32 [px]
        Finite.
    evidence : (n,) float32
        Correlation of each lens with its neighbours there.
    setting : Preset
    around : (m,) float32 [px], optional
        Patch sizes that occur; only shifts between these and a little beyond are tried. None tries all.

    Returns
    -------
    (n,) float32 [px]
    """
    second = np.full(len(first), np.nan, np.float32)
    wanted = (texture.clear | texture.faint) & (evidence < _EXPLAINED)
    if not wanted.any():
        return second
    matcher = Matcher(texture, forward, backward, replace(setting, search_pitch=max(setting.search_pitch, _PITCH)))
    gray, shifts, noise = matcher.gray, matcher.shifts, texture.noise / matcher.factor
    if around is not None and len(around):
        low, high = np.quantile(around, [_OUTSIDE, 1 - _OUTSIDE]) / matcher.factor
        margin = _MARGIN * gray.pitch
        shifts = shifts[(shifts >= low - margin) & (shifts <= high + margin)]
        if len(shifts) < _LEAST_SHIFTS:
            return second
    rows = join_opposite(forward, backward)
    mask, shares = np.zeros(gray.image.shape, np.float32), np.empty(len(first), np.float32)
    radius, pitch = np.float32(gray.radius), np.float32(gray.pitch)
    _unexplained(
        gray.image, gray.centres, radius - _BORDER, pitch, rows, (first / matcher.factor).astype(np.float32), wanted,
        matcher.statistics.contrast, np.float32(_NOISES * noise * noise), setting.row_step,
        mask, shares,
    )  # fmt: skip
    wanted &= shares > _LEAST
    cost = np.empty((len(first), len(shifts)), np.float32)
    _costs(
        gray.image, mask, gray.centres, radius, pitch, rows, matcher.statistics.mean, wanted, shifts,
        np.float32(2 * noise * noise), np.float32(_HALF_TRUST * np.pi * radius * radius), setting.row_step, cost,
    )  # fmt: skip
    total = aggregate_costs(cost, forward, backward, _SLOPE * matcher.step, _JUMP)
    best = total.argmin(1)
    lens = np.arange(len(best))
    at_first = np.abs(shifts - first[:, None] / matcher.factor).argmin(1)
    left = cost[lens, best]
    matched = (left < _MATCHED) & (left < cost[lens, at_first] - _BETTER)
    sure = confidence(total, best, rows.shape[1], matcher.tolerance) > _SURE
    found = ((shifts[best] + fit_parabola(total, best) * matcher.step) * matcher.factor).astype(np.float32)
    gap = _APART * texture.flat.pitch
    told = wanted & matched & sure & (np.abs(found - first) > gap)
    beside = np.where((rows >= 0) & told[rows], found[rows], np.nan)
    like = (np.abs(beside - found[:, None]) < gap) | ((rows >= 0) & (np.abs(first[rows] - found[:, None]) < gap))
    return np.where(told & (like.sum(1) >= _TOGETHER), found, second).astype(np.float32)
