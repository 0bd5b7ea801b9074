"""A second depth inside a microimage: what its first depth leaves unexplained is matched again.

A thin branch fills too little of a microimage to show in the correlation of the whole. But its pixels are those that
no neighbour confirms at the depth of the rest, and they agree with the neighbours at another depth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .agreement import aggregate
from .fastmath import FAST
from .modes import confidence, parabola_peak
from .search import Matcher, Preset
from .texture import Texture

__all__ = ["remainder_depths"]

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


@njit(cache=True, nogil=True, fastmath=FAST)
def _differences(image, ax, ay, bx, by, radius, s, pitch, left, top, row_step, line, out):
    """Mean squared difference over 3 x 3 pixels of lens a from what lens b shows there; -1 where it shows nothing."""
    height, width = image.shape
    out[:] = -1.0
    tx, ty = (bx - ax) * (1 + s / pitch), (by - ay) * (1 + s / pitch)
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    qx, qy = bx - tx, by - ty
    r2 = radius * radius
    first = max(int(np.ceil(max(ay, qy) - radius)), max(1, 1 - y0))
    first += -first % row_step
    last = min(int(np.floor(min(ay, qy) + radius)), min(height - 2, height - 3 - y0))
    for y in range(first, last + 1, row_step):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        begin = max(int(np.ceil(max(ax - ha, qx - hb))), max(1, 1 - x0))
        end = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 2, width - 3 - x0))
        n = end - begin + 1
        if n <= 0:
            continue
        line[: n + 2] = 0.0
        for v in range(-1, 2):
            row = image[y + v, begin - 1 : end + 2]
            upper = image[y + v + y0, begin + x0 - 1 : end + x0 + 3]
            lower = image[y + v + y0 + 1, begin + x0 - 1 : end + x0 + 3]
            for k in range(n + 2):
                e = row[k] - (w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1])
                line[k] += e * e
        target = out[y - top, begin - left : end - left + 1]
        for k in range(n):
            target[k] = (line[k] + line[k + 1] + line[k + 2]) / np.float32(9.0)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _variance(image, x, y):
    """Variance of the 3 x 3 pixels about (x, y)."""
    mean = squares = np.float32(0.0)
    for v in range(-1, 2):
        for u in range(-1, 2):
            value = image[y + v, x + u] - image[y, x]
            mean += value
            squares += value * value
    return squares / 9 - mean * mean / 81


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _insert(values, count, value):
    """Put `value` into the `count` sorted `values`."""
    at = count
    while at > 0 and values[at - 1] > value:
        values[at] = values[at - 1]
        at -= 1
    values[at] = value


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _unexplained(image, centres, radius, pitch, rows, sizes, wanted, contrast, floor, row_step, mask, shares):
    """Set `mask` (H, W) to 1 at the pixels of `wanted` lenses that `sizes` do not explain, and to 0 at the others."""
    height, width = image.shape
    side = int(np.ceil(radius)) + 1
    most = rows.shape[1]
    for lens in prange(len(centres)):
        shares[lens] = 0.0
        if not wanted[lens]:
            continue
        ax, ay = centres[lens, 0], centres[lens, 1]
        left, top = int(ax) - side, int(ay) - side
        views = np.empty((most, 2 * side + 2, 2 * side + 2), np.float32)
        line, values = np.empty(2 * side + 4, np.float32), np.empty(most, np.float32)
        least = floor + _OF_LENS * contrast[lens] * contrast[lens]
        seen = total = unexplained = 0
        for k in range(most):
            other = rows[lens, k]
            if other >= 0:
                _differences(
                    image, ax, ay, centres[other, 0], centres[other, 1], radius, sizes[lens], pitch, left, top,
                    row_step, line, views[seen],
                )  # fmt: skip
                seen += 1
        start = max(1, top)
        for y in range(start + -start % row_step, min(height - 1, top + 2 * side + 2), row_step):
            for x in range(max(1, left), min(width - 1, left + 2 * side + 2)):
                if (x - ax) ** 2 + (y - ay) ** 2 > radius * radius:
                    continue
                total += 1
                mask[y, x] = 0
                count = 0
                for k in range(seen):
                    if views[k, y - top, x - left] >= 0:
                        _insert(values, count, views[k, y - top, x - left])
                        count += 1
                if count < 2:
                    continue
                difference = np.float32(0.0)
                half = (count + 1) // 2
                for k in range(half):
                    difference += values[k]
                if difference / half > _SHARE * _variance(image, x, y) + least:
                    mask[y, x] = 1
                    unexplained += 1
        shares[lens] = unexplained / max(total, 1)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _moments(image, mask, extent, base, ax, ay, bx, by, radius, tx, ty, mean, row_step):
    """Sums over the masked pixels of lens a whose partner, `(tx, ty)` away, lies in lens b.

    `extent` (rows, 2) has the first and last masked column of each row from `base` on.
    """
    height, width = image.shape
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = saa = sbb = sab = count = np.float32(0.0)
    r2 = radius * radius
    qx, qy = bx - tx, by - ty
    top = max(int(np.ceil(max(ay, qy) - radius)), max(0, -y0))
    top += -top % row_step
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 1, height - 2 - y0))
    for y in range(top, bottom + 1, row_step):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(extent[y - base, 0], -x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(extent[y - base, 1], width - 2 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        row = image[y, left : right + 1]
        use = mask[y, left : right + 1]
        upper = image[y + y0, left + x0 : right + x0 + 2]
        lower = image[y + y0 + 1, left + x0 : right + x0 + 2]
        for k in range(n):
            w = use[k]
            a = row[k] - mean
            b = w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1] - mean
            count += w
            sa += w * a
            sb += w * b
            saa += w * a * a
            sbb += w * b * b
            sab += w * a * b
    return count, sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, fastmath=FAST)
def _extent(mask, ax, ay, radius):
    """First row of a microimage, and the first and last masked column of this and each row after it."""
    height, width = mask.shape
    side = int(np.ceil(radius)) + 1
    base = int(ay) - side
    extent = np.empty((2 * side + 2, 2), np.int64)
    for v in range(len(extent)):
        extent[v, 0], extent[v, 1] = width, -1
        y = base + v
        if y < 0 or y >= height:
            continue
        half = radius * radius - (y - ay) * (y - ay)
        if half <= 0:
            continue
        half = np.sqrt(half)
        for x in range(max(0, int(np.ceil(ax - half))), min(width - 1, int(np.floor(ax + half))) + 1):
            if mask[y, x] > 0:
                extent[v, 0], extent[v, 1] = min(extent[v, 0], x), x
    return base, extent


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _costs(image, mask, centres, radius, pitch, rows, means, wanted, shifts, floor, half, row_step, out):
    """Mismatch of the masked pixels of each `wanted` lens with the better half of its neighbours, at every shift."""
    for lens in prange(len(centres)):
        out[lens] = _NEUTRAL
        if not wanted[lens]:
            continue
        values = np.empty(rows.shape[1], np.float32)
        ax, ay = centres[lens, 0], centres[lens, 1]
        base, extent = _extent(mask, ax, ay, radius)
        for k in range(len(shifts)):
            grow = 1 + shifts[k] / pitch
            shown = 0
            for d in range(rows.shape[1]):
                other = rows[lens, d]
                if other < 0:
                    continue
                bx, by = centres[other, 0], centres[other, 1]
                count, sa, sb, saa, sbb, sab = _moments(
                    image, mask, extent, base, ax, ay, bx, by, radius, (bx - ax) * grow, (by - ay) * grow, means[lens],
                    row_step,
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


def remainder_depths(
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
    rows = np.hstack([forward, backward])
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
    total = aggregate(cost, forward, backward, _SLOPE * matcher.step, _JUMP)
    best = total.argmin(1)
    lens = np.arange(len(best))
    at_first = np.abs(shifts - first[:, None] / matcher.factor).argmin(1)
    left = cost[lens, best]
    matched = (left < _MATCHED) & (left < cost[lens, at_first] - _BETTER)
    sure = confidence(total, best, rows.shape[1], matcher.tolerance()) > _SURE
    found = ((shifts[best] + parabola_peak(total, best) * matcher.step) * matcher.factor).astype(np.float32)
    gap = _APART * texture.flat.pitch
    told = wanted & matched & sure & (np.abs(found - first) > gap)
    beside = np.where((rows >= 0) & told[rows], found[rows], np.nan)
    like = (np.abs(beside - found[:, None]) < gap) | ((rows >= 0) & (np.abs(first[rows] - found[:, None]) < gap))
    return np.where(told & (like.sum(1) >= _TOGETHER), found, second).astype(np.float32)
