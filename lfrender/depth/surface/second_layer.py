"""A second depth inside a microimage: pixels that the first depth does not explain are matched again on their own.

A thin branch fills too little of a microimage to show in the correlation of the whole. But its pixels are those that
no neighbour confirms at the first depth, and they correlate with the neighbours at another one.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import njit

from ...flat.lens_graph import join_opposite
from ...flat.texture import Texture
from ..matching.matcher import Matcher
from ..matching.peaks import fit_parabola
from ..matching.settings import COST, SEARCH
from ..matching.sgm import aggregate_costs
from ..presets import Preset
from ..refinement.pair_pixels import flat_pixels
from ..same_surface import TOLERANCE, same_surface
from .settings import SecondLayerSettings
from .window_differences import (
    BORDER,
    add_where_within,
    copy_windows,
    inner_columns,
    new_windows,
    window_differences,
    window_variance,
)

__all__ = ["find_second_layer"]

_DEFAULT = SecondLayerSettings()

# Masked pixels of a microimage, one after the other: columns, rows, places in the flat, and brightness.
_Masked = namedtuple("_Masked", "x y places light")


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
    """Mean square difference of the better half of the `seen` neighbours at place `at`; -1 if fewer than two see it."""
    count = 0
    # Sorting without branches: mispredicted ones would cost more than all steps of it.
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


@njit(cache=True, nogil=True, fastmath=FAST)
def _mark_unexplained(image, centres, radius, pitch, rows, lens, s, least, row_step, windows, views, mask):
    """Set `mask` (H, W) to 1 at pixels of a lens that differ from the better half of its neighbours at patch size `s`
    by more than `least` and their variance, and to 0 at the others; returns the share of the former."""
    flat = flat_pixels(image)
    ax, ay = centres[lens, 0], centres[lens, 1]
    copy_windows(flat, ax, ay, windows)
    stride, left, top = windows.stride, windows.corner[0], windows.corner[1]
    size, most = stride * stride, rows.shape[1]
    values, confirming, limits = np.empty(most, np.float32), np.zeros(size, np.float32), np.empty(size, np.float32)
    limits[:] = 9 * least
    begin_row = 1 + -(top + 1) % row_step
    number = (stride - 2 - begin_row) // row_step + 1
    seen = total = unexplained = 0
    for k in range(most):
        other = rows[lens, k]
        if other >= 0:
            window_differences(
                flat, windows, ax, ay, centres[other, 0], centres[other, 1], radius, s, pitch, begin_row, row_step,
                views, seen * size,
            )  # fmt: skip
            add_where_within(views, seen * size, limits, number * stride, confirming)
            seen += 1
    for row in range(number):
        y = top + begin_row + row * row_step
        first, last = inner_columns(y, ax, ay, radius, flat.height, flat.width)
        total += max(last - first + 1, 0)
        for x in range(first, last + 1):
            mask[y, x] = 0
            at = row * stride + x - left
            # If half of all neighbours confirm a pixel, so does the better half.
            if 2 * confirming[at] >= seen:
                continue
            difference = _better_half(views, size, seen, at, values)
            # The variance is only computed where it matters.
            if difference > least and difference > window_variance(image, x, y) + least:
                mask[y, x] = 1
                unexplained += 1
    return unexplained / max(total, 1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, share=lambda image, centres, *_: len(centres))
def _mark_all_unexplained(
    begin, end, image, centres, radius, pitch, rows, sizes, wanted, contrast, floor, share_of_lens, row_step, mask,
    shares,
):  # fmt: skip
    """As `_mark_unexplained` for all `wanted` lenses, with the `shares` (n,) of their pixels."""
    windows = new_windows(radius)
    views = np.empty(rows.shape[1] * windows.stride * windows.stride, np.float32)
    for lens in range(begin, end):
        shares[lens] = 0.0
        if wanted[lens]:
            least = floor + share_of_lens * contrast[lens] * contrast[lens]
            shares[lens] = _mark_unexplained(
                image, centres, radius, pitch, rows, lens, sizes[lens], least, row_step, windows, views, mask
            )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _gather_masked(image, mask, ax, ay, radius, row_step, out):
    """Gather the masked pixels of a microimage; returns how many there are."""
    xs, ys, places, values = out.x, out.y, out.places, out.light
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
def _moments(flat, own, number, bx, by, radius, tx, ty, mean):
    """Number of those of some pixels of one lens whose partner, `(tx, ty)` away, lies in the other lens, and sums of
    their brightness less the `mean`, of its squares and products."""
    xs, ys, places, values = own.x, own.y, own.places, own.light
    pixels, height, width = flat.pixels, flat.height, flat.width
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, share=lambda image, mask, centres, *_: len(centres))
def _match_masked(
    begin, end, image, mask, centres, radius, pitch, rows, means, wanted, shifts, floor, half, offset_weight, row_step,
    out,
):  # fmt: skip
    """Mismatch of the masked pixels of each `wanted` lens with the better half of its neighbours, at every shift.

    A match over `half` pixels counts half, and so does the share `offset_weight` of a difference in mean brightness.
    """
    most = square(2 * int(radius) + 3)
    flat, values = flat_pixels(image), np.empty(rows.shape[1], np.float32)
    own = _Masked(
        np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.int64),
        np.empty(most, np.float32),
    )  # fmt: skip
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        ax, ay = centres[lens, 0], centres[lens, 1]
        number = _gather_masked(image, mask, ax, ay, radius, row_step, own)
        for k in range(len(shifts)):
            grow = 1 + shifts[k] / pitch
            shown = 0
            for d in range(rows.shape[1]):
                other = rows[lens, d]
                if other < 0:
                    continue
                bx, by = centres[other, 0], centres[other, 1]
                count, sa, sb, saa, sbb, sab = _moments(
                    flat, own, number, bx, by, radius, (bx - ax) * grow, (by - ay) * grow, means[lens]
                )
                if count < 4:
                    continue
                inverse = np.float32(1.0) / count
                ma, mb = sa * inverse, sb * inverse
                variance = (saa + sbb) * inverse - ma * ma - mb * mb
                offset = offset_weight * (ma - mb) * (ma - mb)
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
    correlation: NDArray[np.float32],
    setting: Preset,
    occurring: NDArray[np.float32] | None = None,
    settings: SecondLayerSettings = _DEFAULT,
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
    settings : SecondLayerSettings

    Returns
    -------
    (n,) float32 [px]
    """
    second = np.full(len(first), np.nan, np.float32)
    wanted = (texture.clear | texture.faint) & (correlation < settings.matched_whole)
    if not wanted.any():
        return second
    pitch = max(setting.search_pitch, settings.least_pitch)
    matcher = Matcher(texture, forward, backward, replace(setting, search_pitch=pitch))
    shifts = _shifts_to_try(matcher, occurring)
    if len(shifts) < 3:
        # A minimum has a shift on either side.
        return second
    rows = join_opposite(forward, backward)
    small = (first / matcher.factor).astype(np.float32)
    cost = _match_unexplained(texture, matcher, shifts, rows, small, wanted, setting.row_step, settings)
    total = aggregate_costs(cost, forward, backward, SEARCH.slope_price * matcher.step, settings.jump_cost)
    best = total.argmin(1)
    lens = np.arange(len(best))
    at_first = np.abs(shifts - first[:, None] / matcher.factor).argmin(1)
    least = cost[lens, best]
    matched = (least < settings.largest_cost) & (least < cost[lens, at_first] - settings.least_gain)
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


def _match_unexplained(
    texture: Texture,
    matcher: Matcher,
    shifts: NDArray[np.float32],
    rows: NDArray[np.int32],
    first: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    row_step: int,
    settings: SecondLayerSettings,
) -> NDArray[np.float32]:
    """Mismatch (n, k) of the unexplained pixels of `wanted` lenses at all shifts; those with too few are not wanted
    afterwards."""
    gray, noise = matcher.gray, texture.noise / matcher.factor
    mask, shares = np.zeros(gray.image.shape, np.float32), np.empty(len(first), np.float32)
    radius, pitch = np.float32(gray.radius), np.float32(gray.pitch)
    _mark_all_unexplained(
        gray.image, gray.centres, radius - BORDER, pitch, rows, first, wanted,
        matcher.statistics.contrast, np.float32(settings.noise * noise * noise), np.float32(settings.share_of_lens),
        row_step, mask, shares,
    )  # fmt: skip
    wanted &= shares > settings.least_share
    cost = np.full((len(first), len(shifts)), settings.largest_cost, np.float32)
    _match_masked(
        gray.image, mask, gray.centres, radius, pitch, rows, matcher.statistics.mean, wanted, shifts,
        np.float32(2 * noise * noise), np.float32(settings.half_trust * np.pi * radius * radius),
        COST.offset_weight, row_step, cost,
    )  # fmt: skip
    return cost
