"""A second depth inside a microimage: pixels that the first depth does not explain are matched again on their own.

A thin branch fills too little of a microimage to show in the correlation of the whole. But its pixels are those that
no neighbour confirms at the first depth, and they correlate with the neighbours at another one.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel, square

from ...flat.lens_graph import join_opposite
from ...flat.microimages import copy_box
from ...flat.texture import Texture
from ..matching.matcher import Matcher
from ..matching.pair_moments import match_cost
from ..matching.peaks import fit_parabola
from ..matching.settings import SEARCH
from ..matching.sgm import aggregate_costs
from ..presets import Preset
from ..same_surface import TOLERANCE, same_surface
from .settings import SURFACE, SurfaceSettings

__all__ = ["find_second_layer"]

# [px] that windows reach beyond their middle.
_BORDER = np.float32(1.0)
# Fewer pixels hardly tell a depth.
_FEWEST = 4

# Unexplained pixels of a microimage, one after the other: columns, rows, places in the flat, and brightness.
_Pixels = namedtuple("_Pixels", "x y places light")

# A microimage with what lies about it, `stride` rows and columns; work memory of (stride^2,) float32 for this and
# another one, their differences, sums over windows, the differences that are none, and how many views show and confirm
# each pixel.
_Box = namedtuple("_Box", "stride light other squares sums limits showing confirming")


@njit
def _new_box(radius):
    stride = 2 * (int(np.ceil(radius)) + 1) + 2
    size, none = stride * stride, np.float32(0)
    return _Box(
        stride, np.full(size, none), np.full(size, none), np.full(size, none), np.full(size, none), np.full(size, none),
        np.full(size, none), np.full(size, none),
    )  # fmt: skip


@njit(fastmath=FAST, error_model="numpy")
def _sum_windows(values, start, count, stride, out):
    """Sums over 3 x 3 pixels about `count` pixels from place `start` on."""
    first, one, down = np.uint64(start), np.uint64(1), np.uint64(stride)
    for k in range(np.uint64(count)):
        p = first + k
        a, b = p - down, p + down
        out[p] = ((values[a - one] + values[a] + values[a + one]) + (values[p - one] + values[p] + values[p + one])) + (
            values[b - one] + values[b] + values[b + one]
        )


@njit(fastmath=FAST, error_model="numpy")
def _square_differences(own, there, stride, count, fx, fy, out):
    """Squared difference of a microimage, `stride` pixels a row, from the bilinear interpolation of another."""
    one, down, below = np.uint64(1), np.uint64(stride), np.uint64(stride + 1)
    w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    for k in range(np.uint64(count)):
        e = own[k] - (w00 * there[k] + w01 * there[k + one] + w10 * there[k + down] + w11 * there[k + below])
        out[k] = e * e


@njit(fastmath=FAST, error_model="numpy")
def _count_views(sums, limits, start, count, showing, confirming):
    """Count a view of `count` windows from place `start` on, and those that differ by no more than their limit."""
    first, one, none = np.uint64(start), np.float32(1), np.float32(0)
    for k in range(np.uint64(count)):
        p = first + k
        showing[p] += one
        confirming[p] += one if sums[p] <= limits[p] else none


@njit(fastmath=FAST, error_model="numpy")
def _row_of(y, x, radius, low, high):
    """First column of row `y` [px from the centre] of a disc about column `x`, between two others, and how many."""
    half = radius * radius - y * y
    if half < 0:
        return low, 0
    half = np.sqrt(half)
    first = max(low, int(np.ceil(x - half)))
    return first, min(high, int(np.floor(x + half))) + 1 - first


@njit(fastmath=FAST, error_model="numpy")
def _find_unexplained(flat, box, centres, lens, radius, s, pitch, rows, row_step, floor, out):
    """Gather the pixels of a lens that fewer than half of the neighbours that show them confirm at patch size `s`;
    returns their number. A window of 3 x 3 pixels confirms if it differs by less than its variance and a `floor`."""
    pixels, (height, width) = flat.reshape(-1), flat.shape
    stride, light, other, squares, sums = box.stride, box.light, box.other, box.squares, box.sums
    limits, showing, confirming = box.limits, box.showing, box.confirming
    ax, ay, size, ninth = centres[lens, 0], centres[lens, 1], stride * stride, np.float32(1 / 9)
    half = (stride - 2) // 2
    left, top = int(ax) - half, int(ay) - half
    copy_box(pixels, width, left, top, stride, stride, light)
    # Relative to one of them, squares of similar values keep their digits.
    middle = light[size // 2]
    for k in range(np.uint64(size)):
        other[k] = light[k] - middle
        squares[k] = other[k] * other[k]
    begin = 1 + -(top + 1) % row_step
    for v in range(begin, stride - 1, row_step):
        at = v * stride + 1
        _sum_windows(other, at, stride - 2, stride, sums)
        _sum_windows(squares, at, stride - 2, stride, limits)
        for p in range(np.uint64(at), np.uint64(at + stride - 2)):
            limits[p] += 9 * floor - ninth * sums[p] * sums[p]
            showing[p] = confirming[p] = np.float32(0)
    for d in range(rows.shape[1]):
        if rows[lens, d] < 0:
            continue
        bx, by = centres[rows[lens, d], 0], centres[rows[lens, d], 1]
        tx, ty = (bx - ax) * (1 + s / pitch), (by - ay) * (1 + s / pitch)
        x0, y0 = int(np.floor(tx)), int(np.floor(ty))
        copy_box(pixels, width, left + x0, top + y0, stride, stride, other)
        # The last row and column have no pixel beyond them to interpolate with.
        _square_differences(light, other, stride, size - stride - 1, np.float32(tx - x0), np.float32(ty - y0), squares)
        low, high = max(1, 1 - x0, left + 1), min(width - 2, width - 3 - x0, left + stride - 3)
        for v in range(begin, stride - 2, row_step):
            y = top + v
            if y < max(1, 1 - y0) or y > min(height - 2, height - 3 - y0):
                continue
            first, count = _row_of(y - by + ty, bx - tx, radius, low, high)
            if count > 0:
                _sum_windows(squares, v * stride + first - left, count, stride, sums)
                _count_views(sums, limits, v * stride + first - left, count, showing, confirming)
    xs, ys, places, values, found = out.x, out.y, out.places, out.light, 0
    for v in range(begin, stride - 2, row_step):
        y = top + v
        if y < 1 or y > height - 2:
            continue
        first, count = _row_of(y - ay, ax, radius, 1, width - 2)
        for x in range(first, first + count):
            at = v * stride + x - left
            if showing[at] >= 2 and 2 * confirming[at] < showing[at]:
                place = y * width + x
                xs[found], ys[found], places[found], values[found] = x, y, place, pixels[place]
                found += 1
    return found


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _moments(flat, own, number, bx, by, radius, tx, ty, mean):
    """Number of those of some pixels of one lens whose partner, `(tx, ty)` away, lies in the other lens, and sums of
    their brightness less the `mean`, of its squares, and of squares of differences."""
    xs, ys, places, values = own.x, own.y, own.places, own.light
    pixels, (height, width) = flat.reshape(-1), flat.shape
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = squares = srr = count = np.float32(0.0)
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
        b = w00 * pixels[at] + w01 * pixels[at + right] - mean
        b += w10 * pixels[at + down] + w11 * pixels[at + down + right]
        count += 1
        sa += a
        sb += b
        squares += a * a + b * b
        srr += (a - b) * (a - b)
    return count, sa, sb, squares, srr


@kernel(error_model="numpy", fastmath=FAST, share=lambda image, centres, *_: len(centres))
def _match_unexplained(
    begin, end, image, centres, radius, pitch, rows, first, means, floors, wanted, shifts, floor, half, row_step, out
):
    """Mismatch of the unexplained pixels of each `wanted` lens with the better half of its neighbours, at every shift;
    those with too few are not wanted afterwards. A match over `half` pixels counts half."""
    most, none = square(2 * int(radius) + 3), np.float32(0.0)
    flat, box, costs = image, _new_box(radius - _BORDER), np.empty(rows.shape[1], np.float32)
    own = _Pixels(
        np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.int64), np.empty(most, np.float32)
    )
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        number = _find_unexplained(
            flat, box, centres, lens, radius - _BORDER, first[lens], pitch, rows, row_step, floors[lens], own
        )
        wanted[lens] = number >= _FEWEST
        if not wanted[lens]:
            continue
        ax, ay = centres[lens, 0], centres[lens, 1]
        for k in range(len(shifts)):
            grow, shown = 1 + shifts[k] / pitch, 0
            for d in range(rows.shape[1]):
                other = rows[lens, d]
                if other < 0:
                    continue
                bx, by = centres[other, 0], centres[other, 1]
                count, sa, sb, squares, srr = _moments(
                    flat, own, number, bx, by, radius, (bx - ax) * grow, (by - ay) * grow, means[lens]
                )
                if count < _FEWEST:
                    continue
                cost = match_cost(count, sa, sb, squares, srr, none, count * row_step, floor, half, none)
                at = shown
                while at > 0 and costs[at - 1] > cost:
                    costs[at] = costs[at - 1]
                    at -= 1
                costs[at] = cost
                shown += 1
            if shown >= 2:
                better = (shown + 1) // 2
                out[lens, k] = costs[:better].sum() / better


def find_second_layer(
    texture: Texture,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    first: NDArray[np.float32],
    correlation: NDArray[np.float32],
    setting: Preset,
    occurring: NDArray[np.float32] | None = None,
    settings: SurfaceSettings = SURFACE,
) -> NDArray[np.float32]:
    """Patch size of the pixels of each lens that its first patch size does not explain; NaN if there are none.

    Pixels that the better half of the neighbours does not confirm are correlated over all shifts, and semi-global
    matching smooths the result: a branch runs through one lens after the other.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    first : (n,) float32 [px]
        Finite.
    correlation : (n,) float32
        Correlation of each lens with its neighbours there.
    setting : Preset
    occurring : (m,) float32 [px], optional
        Patch sizes that occur; only shifts between these and a little beyond are tried. All by default.
    settings : SurfaceSettings

    Returns
    -------
    (n,) float32 [px]
    """
    second = np.full(len(first), np.nan, np.float32)
    wanted = (texture.clear | texture.faint) & (correlation < settings.matched_whole)
    if not wanted.any():
        return second
    pitch = max(setting.search_pitch, settings.pitch)
    matcher = Matcher(texture, forward, backward, replace(setting, search_pitch=pitch))
    shifts = _shifts_to_try(matcher, occurring)
    if len(shifts) < 3:
        # A minimum has a shift on either side.
        return second
    rows = join_opposite(forward, backward)
    small = (first / matcher.factor).astype(np.float32)
    gray, noise2 = matcher.gray, np.float32(texture.noise / matcher.factor) ** 2
    cost = np.ones((len(first), len(shifts)), np.float32)
    _match_unexplained(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), rows, small,
        matcher.statistics.mean, 4 * noise2 + np.float32(settings.share_of_lens) * matcher.statistics.contrast**2,
        wanted, shifts, 2 * noise2, np.float32(settings.half_trust * np.pi * gray.radius**2), setting.row_step, cost,
    )  # fmt: skip
    total = aggregate_costs(cost, forward, backward, SEARCH.slope_price * matcher.step, settings.jump)
    best = total.argmin(1)
    lens = np.arange(len(best))
    at_first = np.abs(shifts - first[:, None] / matcher.factor).argmin(1)
    matched = cost[lens, best] < cost[lens, at_first] - settings.least_gain
    found = ((shifts[best] + fit_parabola(total, best) * matcher.step) * matcher.factor).astype(np.float32)
    gap = TOLERANCE * texture.flat.pitch
    new = wanted & matched & ~same_surface(found, first, gap)
    # A neighbour must have the same depth, in either layer.
    beside = same_surface(np.where(new[rows], found[rows], np.nan), found[:, None], gap)
    beside |= same_surface(first[rows], found[:, None], gap)
    return np.where(new & (beside & (rows >= 0)).any(1), found, second).astype(np.float32)


def _shifts_to_try(matcher: Matcher, occurring: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Shifts [px of the search] in the range of the patch sizes that occur, and a little beyond."""
    shifts = matcher.shifts
    if occurring is None or not len(occurring):
        return shifts
    low, high = occurring.min() / matcher.factor, occurring.max() / matcher.factor
    margin = TOLERANCE * matcher.gray.pitch
    return shifts[(shifts >= low - margin) & (shifts <= high + margin)]
