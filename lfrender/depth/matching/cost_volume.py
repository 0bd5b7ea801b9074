"""Matching cost of neighbouring microimages over signed shifts: the cost volume.

The cost is `1 - rho`: one minus the correlation coefficient over the pixels that two microimages
share at a shift (Lumsdaine and Georgiev 2008, section 4), with noise, remaining shading and small
overlaps taken into account.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import (
    VECTOR_LENGTH,
    OverlapMasks,
    Strips,
    bilinear_weights,
    make_shift_masks,
    overlap_range,
)
from ...flat.texture import FIXED_PATTERN, LensStatistics

__all__ = [
    "compute_pair_costs",
    "fill_mask",
    "half_weight_area",
    "match_cost",
    "overlap_area",
    "overlap_masks",
    "strip_moments",
]


@njit(error_model="numpy", inline="always")
def match_cost(count, sa, sb, squares, srr, difference, pixels, floor, half_weight, doubt):
    """Cost of a pair, one less its weighted correlation, from sums over the `count` pixels that it
    shares.

    Those of both, of the squares of both, and of the squares of their difference; `difference` is
    added to that of the means, `floor` is the variance of noise and shading, `doubt` the share
    taken off the weight of that many `pixels`.
    """
    one = np.float32(1.0)
    inverse = one / count
    ma = sa * inverse
    mb = sb * inverse
    variance = squares * inverse - ma * ma - mb * mb
    residual = srr * inverse - (ma - mb) * (ma - mb)
    # Means count by half: gains differ a little, but on a smooth slope only means show depth.
    offset = np.float32(0.5) * (ma - mb + difference) * (ma - mb + difference)
    quality = (residual + offset + floor) / (variance + offset + floor)
    return one - pixels / (pixels + half_weight) * (one - doubt) * (one - quality)


# The error model of NumPy, because Python's checks every division, which prevents vector loops.
# Indices are unsigned, because signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def strip_moments(strips, own, other, upper, lower, masks, mask, count, weights):
    """Sums over the masked pixels of one strip and the interpolated ones of another, `upper` and
    `lower` values on: of both, of the squares of both, and of those of their difference.
    """
    one = np.uint64(1)
    above = np.uint64(other + upper)
    below = np.uint64(other + lower)
    a = np.uint64(own)
    m = np.uint64(mask)
    w00, w01, w10, w11 = weights
    sa = sb = squares = srr = np.float32(0.0)
    for k in range(np.uint64(count)):
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b *= masks[m + k]
        c = masks[m + k] * strips[a + k]
        sa += c
        sb += b
        squares += c * c + b * b
        srr += (c - b) * (c - b)
    return sa, sb, squares, srr


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _mask_discs(columns, lines, start, count, discs, box, radius2, out):
    """Mask the pixels of a strip from `start` on that lie in both discs, at `ax, ay, bx, by` from
    its middle, and in a box; how many do.
    """
    ax, ay, bx, by = discs
    low_x, low_y, high_x, high_y = box
    first = np.uint64(start)
    number = np.float32(0.0)
    for k in range(np.uint64(count)):
        x = columns[first + k]
        y = lines[first + k]
        a2 = (x - ax) * (x - ax) + (y - ay) * (y - ay)
        b2 = (x - bx) * (x - bx) + (y - by) * (y - by)
        inside = (
            (max(a2, b2) <= radius2) & (x >= low_x) & (y >= low_y) & (x <= high_x) & (y <= high_y)
        )
        out[k] = np.float32(1.0) if inside else np.float32(0.0)
        number += out[k]
    return number


@njit(error_model="numpy", inline="always")
def fill_mask(dx, dy, middle, other, discs, radius2, columns, lines, layout, size, out):
    """Fill `out` with a mask of the pixels of a strip that have a partner in another, `dx, dy`
    pixels away.

    Returns their number, the first position and the number of those to read, and how many values
    later in a strip follow the partner and the pixel below it.
    """
    half, width, rows, step, bunch = layout
    none = np.int32(0)
    count = np.float32(0.0)
    first, number = overlap_range(dx, dy, half, width, step, bunch)
    if number > 0:
        # Interpolation reads one pixel beyond, and both microimages end at the border of the flat.
        (x, y), (far_x, far_y), (height, across) = middle, other, size
        box = (
            np.float32(max(-half - dx, -x, -far_x - dx)),
            np.float32(max(-half - dy, -y, -far_y - dy)),
            np.float32(min(across - 1 - x, across - 2 - far_x - dx)),
            np.float32(min(height - 1 - y, height - 2 - far_y - dy)),
        )
        count = _mask_discs(columns, lines, first, number, discs, box, radius2, out)
    upper = ((dy % step) * rows + dy // step) * width + dx
    lower = (((dy + 1) % step) * rows + (dy + 1) // step) * width + dx
    return count, np.int32(first), np.int32(max(number, none)), np.int32(upper), np.int32(lower)


class PairTerms(NamedTuple):
    """What the cost of a pair depends on besides its pixels, as kernels take it."""

    centres: NDArray[np.float32]  # (n, 2) [px]
    radius: np.float32  # [px]
    pitch: np.float32  # [px]
    means: NDArray[np.float32]  # (n,) [white = 1]
    doubts: NDArray[np.float32]  # (n,) share of a match at zero that may be shading
    noise2: np.float32  # variance of the noise
    shading: np.float32  # [share of the mean]
    half_weight: np.float32  # [px^2] overlap with half weight


class StripTable(NamedTuple):
    """Microimages as `Strips` and the masks of the pixels that two of them share, as kernels take
    them.
    """

    values: NDArray[np.float32]
    middle: NDArray[np.int32]
    whole: NDArray[np.bool_]
    columns: NDArray[np.float32]
    lines: NDArray[np.float32]
    slots: NDArray[np.int32]
    masks: NDArray[np.float32]
    ends: NDArray[np.int32]
    counts: NDArray[np.int32]
    # Pixels from the middle to the sides, from row to row, rows of a part, parts, and vector
    # length; size of the flat.
    layout: tuple[int, int, int, int, int]
    size: tuple[int, int]


@kernel(error_model="numpy", share=lambda terms, rows, *_: len(rows))
def _pair_costs(
    begin,
    end,
    terms: PairTerms,
    rows,
    active,
    done,
    shifts,
    expected,
    near_zero,
    which,
    table: StripTable,
    fresh,
    out,
):
    centres, radius, pitch, means, doubts, noise2, shading, half_weight = terms
    values, middle, whole, columns, lines, slots, masks, ends, counts, layout, flat_size = table
    _, width, tall, step, _ = layout
    size = tall * step * width
    length = masks.shape[1]
    line = masks.reshape(-1)
    one = np.float32(1.0)
    own_mask = np.empty(length, np.float32)
    reach = len(slots) // 2
    for lens in range(begin, end):
        if fresh:
            out[lens] = 1.0
        ax = centres[lens, 0]
        ay = centres[lens, 1]
        mx = middle[lens, 0]
        my = middle[lens, 1]
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]) or done[lens] or done[other]:
                continue
            bx = centres[other, 0]
            by = centres[other, 1]
            nx = middle[other, 0]
            ny = middle[other, 1]
            mean = np.float32(0.5) * (means[lens] + means[other])
            about = np.float32(0.0)
            if expected.size > 0:
                about = np.float32(0.5) * (expected[lens] + expected[other])
            floor = np.float32(2.0) * (noise2 + shading * shading * mean * mean)
            doubt = max(doubts[lens], doubts[other])
            difference = means[lens] - means[other]
            for k in which:
                grow = one + (about + shifts[k]) / pitch
                tx = (bx - ax) * grow
                ty = (by - ay) * grow
                floor_x = np.floor(tx)
                floor_y = np.floor(ty)
                fx = tx - floor_x
                fy = ty - floor_y
                dx = int(floor_x) - nx + mx
                dy = int(floor_y) - ny + my
                # Looked up here, since a call counts references to all arrays.
                slot = np.int32(-1)
                if whole[lens] and whole[other] and abs(dx) <= reach and abs(dy) <= reach:
                    slot = slots[dy + reach, dx + reach]
                # Of small overlaps, below a third of a microimage, the pixels at the rim are tested
                # one by one.
                if slot >= 0 and counts[slot] * step > radius * radius:
                    count = np.float32(counts[slot])
                    first = ends[slot, 0]
                    number = ends[slot, 1]
                    upper = ends[slot, 2]
                    lower = ends[slot, 3]
                else:
                    slot = np.int32(-1)
                    count, first, number, upper, lower = fill_mask(
                        dx,
                        dy,
                        (mx, my),
                        (nx, ny),
                        (ax - mx, ay - my, bx - tx - mx, by - ty - my),
                        radius * radius,
                        columns,
                        lines,
                        layout,
                        flat_size,
                        own_mask,
                    )
                if count < 4:
                    continue
                weights = bilinear_weights(fx, fy)
                own = lens * size + first
                there = other * size + first
                if slot >= 0:
                    sa, sb, squares, srr = strip_moments(
                        values,
                        own,
                        there,
                        upper,
                        lower,
                        line,
                        slot * length + first,
                        number,
                        weights,
                    )
                else:
                    sa, sb, squares, srr = strip_moments(
                        values, own, there, upper, lower, own_mask, 0, number, weights
                    )
                out[lens, d, k] = match_cost(
                    count,
                    sa,
                    sb,
                    squares,
                    srr,
                    difference,
                    count * step,
                    floor,
                    half_weight,
                    doubt * near_zero[k],
                )


def overlap_masks(
    strips: Strips, gray: GrayFlat, steps: NDArray[np.float32], shifts: NDArray[np.float32]
) -> OverlapMasks:
    """`make_shift_masks` for all whole-pixel shifts of pairs `steps` (d, 2) [pitch] apart at
    `shifts` (k,) [px].
    """
    whole = np.floor(shifts[:, None, None] * steps).astype(int)
    # Centres and shifts are rounded to pixels independently, which moves a shift by up to two
    # pixels each way.
    rounding = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), -1).reshape(-1, 2)
    return make_shift_masks(
        strips, gray.radius, (whole.reshape(-1, 1, 2) + rounding).reshape(-1, 2)
    )


def half_weight_area(gray: GrayFlat) -> float:
    """Overlap of two microimages [px^2] at which a match has half weight; more would bias patch
    sizes toward zero.
    """
    return float(0.06 * np.pi * gray.radius**2)


def overlap_area(
    gray: GrayFlat, steps: NDArray[np.float32], shifts: NDArray[np.float32]
) -> NDArray[np.float64]:
    """(d, k) [px^2] overlap of microimages `steps` (d, 2) [pitch] apart at `shifts` (k,) [px of
    `gray`].
    """
    x = np.minimum(np.abs(shifts) * np.linalg.norm(steps, axis=1)[:, None] / (2 * gray.radius), 1)
    return np.asarray(2 * gray.radius**2 * (np.arccos(x) - x * np.sqrt(1 - x * x)))


def compute_pair_costs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    statistics: LensStatistics,
    active: NDArray[np.bool_],
    shifts: NDArray[np.float32],
    noise: float,
    strips: Strips,
    masks: OverlapMasks,
    *,
    expected: NDArray[np.float32] | None = None,
    which: NDArray[np.int64] | None = None,
    done: NDArray[np.bool_] | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """(n, d, k) float32 `1 - rho` of each lens with its neighbours `rows` (n, d) at each of the
    `shifts` (k,) [px].

    A difference of means counts by half; the `noise` of a pixel [white], remaining shading and
    small overlaps pull the cost toward 1; pairs without an `active` lens cost 1. Shifts are from
    the `expected` ones (n,), 0 by default. Given an `out` of an earlier call, only the shifts
    `which` (m,) of lenses that are not `done` (n,) are added.
    """
    fresh = out is None
    if out is None:
        out = np.empty((len(gray.centres), rows.shape[1], len(shifts)), np.float32)
    pitch = np.float32(gray.pitch)
    shifts = shifts.astype(np.float32)
    # A match at zero may be one of shading, which stays with its lens, if contrast is below 3 % of
    # white: within 0.08 pitches of zero.
    doubts = 1 / (1 + np.square(statistics.contrast / np.float32(0.03)))
    near_zero = np.exp(-np.square(shifts / pitch / np.float32(0.08)))
    if expected is not None:
        doubts = doubts * np.exp(-np.square(expected / pitch / np.float32(0.08)))
        near_zero = np.ones_like(shifts)
    terms = PairTerms(
        gray.centres,
        np.float32(gray.radius),
        pitch,
        statistics.mean,
        doubts.astype(np.float32),
        *map(np.float32, (noise**2, FIXED_PATTERN, half_weight_area(gray))),
    )
    layout = strips.half_width, strips.width, strips.rows, strips.step, VECTOR_LENGTH
    slots, pixels, ends, counts = masks
    table = StripTable(
        strips.values,
        strips.centre_pixels,
        strips.complete,
        *strips.offsets,
        slots,
        pixels,
        ends,
        counts,
        layout,
        gray.image.shape,
    )
    _pair_costs(
        terms,
        rows,
        active,
        np.zeros(len(active), bool) if done is None else done,
        shifts,
        np.empty(0, np.float32) if expected is None else expected,
        near_zero,
        np.arange(len(shifts)) if which is None else which,
        table,
        fresh,
        out,
    )
    return out
