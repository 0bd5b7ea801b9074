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

from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import kernel

from ...flat.lens_graph import join_opposite
from ...flat.texture import Texture
from ..matching.matcher import Matcher
from ..matching.pair_moments import match_cost
from ..matching.peaks import fit_parabola
from ..matching.settings import SEARCH
from ..matching.sgm import aggregate_costs
from ..presets import Preset
from ..refinement.pair_pixels import flat_pixels
from ..same_surface import TOLERANCE, same_surface
from .settings import SURFACE, SurfaceSettings
from .window_differences import BORDER, FEWEST, copy_windows, count_views, inner_columns, new_windows, set_limits

__all__ = ["find_second_layer"]

# Unexplained pixels of a microimage, one after the other: columns, rows, places in the flat, and brightness.
_Pixels = namedtuple("_Pixels", "x y places light")


@njit(fastmath=FAST, error_model="numpy")
def _find_unexplained(flat, windows, centres, lens, radius, s, pitch, rows, row_step, floor, out):
    """Gather the pixels of a lens that fewer than half of the neighbours that show them confirm at patch size `s`;
    returns their number."""
    xs, ys, places, light = out.x, out.y, out.places, out.light
    ax, ay = centres[lens, 0], centres[lens, 1]
    copy_windows(flat, ax, ay, windows)
    stride, left, top = windows.stride, windows.corner[0], windows.corner[1]
    begin_row = 1 + -(top + 1) % row_step
    set_limits(windows, begin_row, row_step, floor)
    count_views(flat, windows, centres, lens, radius, s, pitch, rows, begin_row, row_step)
    showing, confirming, count, row = windows.showing, windows.confirming, 0, 0
    for v in range(begin_row, stride - 1, row_step):
        first, last = inner_columns(top + v, ax, ay, radius, flat.height, flat.width)
        for x in range(first, last + 1):
            at = row + x - left
            if showing[at] >= 2 and 2 * confirming[at] < showing[at]:
                place = (top + v) * flat.width + x
                xs[count], ys[count], places[count], light[count] = x, top + v, place, flat.pixels[place]
                count += 1
        row += stride
    return count


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _moments(flat, own, number, bx, by, radius, tx, ty, mean):
    """Number of those of some pixels of one lens whose partner, `(tx, ty)` away, lies in the other lens, and sums of
    their brightness less the `mean`, of its squares, and of squares of differences."""
    xs, ys, places, values = own.x, own.y, own.places, own.light
    pixels, height, width = flat.pixels, flat.height, flat.width
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
    flat, windows, costs = flat_pixels(image), new_windows(radius - BORDER), np.empty(rows.shape[1], np.float32)
    own = _Pixels(
        np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.int64), np.empty(most, np.float32)
    )
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        number = _find_unexplained(
            flat, windows, centres, lens, radius - BORDER, first[lens], pitch, rows, row_step, floors[lens], own
        )
        wanted[lens] = number >= FEWEST
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
                if count < FEWEST:
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
