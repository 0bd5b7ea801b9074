"""Matching cost of neighbouring microimages over signed shifts: the cost volume.

The cost is `1 - rho`: one minus the correlation coefficient over the pixels that two microimages
share at a shift (Lumsdaine and Georgiev 2008, section 4), with noise, remaining shading and small
overlaps taken into account.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
)
from ...flat.texture import FIXED_PATTERN, LensStatistics

__all__ = [
    "PairTerms",
    "Shifts",
    "compute_pair_costs",
    "half_weight_area",
    "match_cost",
    "overlap_area",
    "overlap_masks",
    "pair_terms",
    "pairs_of",
    "shifts_from_zero",
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


class PairTerms(NamedTuple):
    """What the costs of pairs depend on besides their pixels."""

    centres: NDArray[np.float32]  # (n, 2) [px]
    radius: np.float32  # [px]
    pitch: np.float32  # [px]
    means: NDArray[np.float32]  # (n,) [white = 1]
    expected: NDArray[np.float32]  # (n,) [px] patch sizes from which shifts are counted
    doubts: NDArray[np.float32]  # (n,) share of a match at zero that may be shading
    noise2: np.float32  # variance of the noise
    shading: np.float32  # [share of the mean]
    half_weight: np.float32  # [px^2] overlap with half weight


class Shifts(NamedTuple):
    """Shifts that are tried."""

    sizes: NDArray[np.float32]  # (k,) [px]
    near_zero: NDArray[np.float32]  # (k,) share of `PairTerms.doubts` that counts
    which: NDArray[np.int64]  # (m,) rows of those that are tried now


class _Move(NamedTuple):
    """From a lens to the place in another that shows the same."""

    x: Any  # float32 [px]
    y: Any
    across: Any  # int: pixels from one middle to the other, to the upper left of the place
    down: Any
    weights: Any  # of the four pixels about the place


class _Overlap(NamedTuple):
    """Pixels that two strips share."""

    count: Any  # float32: their number
    first: Any  # int32: place of the first one in the first strip
    number: Any  # int32: of those to read
    upper: Any  # int32: from a place in the first strip to its partner in the second one
    lower: Any  # int32: and to the pixel below that


# The error model of NumPy, because Python's checks every division, which prevents vector loops.
# Indices are unsigned, because signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _strip_moments(strips, own, other, overlap, masks, mask, weights):
    """Sums over the masked pixels of one strip and the interpolated ones of another: of both, of
    the squares of both, and of those of their differences.
    """
    one = np.uint64(1)
    above = np.uint64(other + overlap.upper)
    below = np.uint64(other + overlap.lower)
    a = np.uint64(own)
    m = np.uint64(mask)
    w00, w01, w10, w11 = weights
    sa = sb = squares = srr = np.float32(0.0)
    for k in range(np.uint64(overlap.number)):
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
def _mask_pair(a, b, middle, other, move, radius2, columns, lines, shape, flat_size, out):
    """Fill `out` with a mask of the pixels of a strip, of a lens with its centre at `a` and
    `middle` its middle pixel, that have a partner in that of another at `b`.
    """
    half, width, rows, step = shape
    dx = move.across
    dy = move.down
    count = np.float32(0.0)
    first = -(min(0, dy) // step) * width + max(0, -dx)
    number = ((2 * half - 1 - max(0, dy)) // step + 1) * width - first
    number = (number + VECTOR_LENGTH - 1) // VECTOR_LENGTH * VECTOR_LENGTH
    if number > 0:
        x, y = middle
        far_x, far_y = other
        height, across = flat_size
        discs = (a[0] - x, a[1] - y, b[0] - move.x - x, b[1] - move.y - y)
        # Interpolation reads one pixel beyond, and both microimages end at the border of the flat.
        box = (
            np.float32(max(-half - dx, -x, -far_x - dx)),
            np.float32(max(-half - dy, -y, -far_y - dy)),
            np.float32(min(across - 1 - x, across - 2 - far_x - dx)),
            np.float32(min(height - 1 - y, height - 2 - far_y - dy)),
        )
        count = _mask_discs(columns, lines, first, number, discs, box, radius2, out)
    upper = ((dy % step) * rows + dy // step) * width + dx
    lower = (((dy + 1) % step) * rows + (dy + 1) // step) * width + dx
    return _Overlap(
        count, np.int32(first), np.int32(max(number, 0)), np.int32(upper), np.int32(lower)
    )


@njit(error_model="numpy", inline="always")
def _move_between(a, b, middle, other, grow):
    """From a lens with its centre at `a`, and `middle` its middle pixel, to another at `b`."""
    x = (b[0] - a[0]) * grow
    y = (b[1] - a[1]) * grow
    whole_x = np.floor(x)
    whole_y = np.floor(y)
    across = int(whole_x) - other[0] + middle[0]
    down = int(whole_y) - other[1] + middle[1]
    return _Move(x, y, across, down, bilinear_weights(x - whole_x, y - whole_y))


@kernel(error_model="numpy", share=lambda terms, *_: len(terms.centres))
def _pair_costs(begin, end, terms, strips, masks, rows, tried, out):
    # Numba counts references each time that an array is taken out of a tuple: not in loops.
    centres = terms.centres
    radius = terms.radius
    pitch = terms.pitch
    means = terms.means
    expected = terms.expected
    doubts = terms.doubts
    noise2 = terms.noise2
    shading = terms.shading
    half_weight = terms.half_weight
    values = strips.values
    middle = strips.middle
    whole = strips.whole
    columns = strips.columns
    lines = strips.lines
    half = strips.half
    width = strips.width
    tall = strips.rows
    step = strips.step
    flat_size = strips.flat_size
    slots, shared, ends, counts = masks
    sizes, near_zero, which = tried
    line = shared.reshape(-1)
    length = shared.shape[1]
    own_mask = np.empty(length, np.float32)
    reach = len(slots) // 2
    size = tall * step * width
    shape = (half, width, tall, step)
    radius2 = radius * radius
    mid = np.float32(0.5)
    for lens in range(begin, end):
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0:
                continue
            a = (centres[lens, 0], centres[lens, 1])
            b = (centres[other, 0], centres[other, 1])
            middle_a = (middle[lens, 0], middle[lens, 1])
            middle_b = (middle[other, 0], middle[other, 1])
            mean = mid * (means[lens] + means[other])
            about = mid * (expected[lens] + expected[other])
            floor = np.float32(2.0) * (noise2 + shading * shading * mean * mean)
            doubt = max(doubts[lens], doubts[other])
            difference = means[lens] - means[other]
            both_whole = whole[lens] and whole[other]
            for k in which:
                grow = np.float32(1.0) + (about + sizes[k]) / pitch
                move = _move_between(a, b, middle_a, middle_b, grow)
                slot = np.int32(-1)
                if both_whole and abs(move.across) <= reach and abs(move.down) <= reach:
                    slot = slots[move.down + reach, move.across + reach]
                # Of small overlaps, below a third of a microimage, the pixels at the rim are tested
                # one by one.
                if slot >= 0 and counts[slot] * step > radius2:
                    overlap = _Overlap(
                        np.float32(counts[slot]),
                        ends[slot, 0],
                        ends[slot, 1],
                        ends[slot, 2],
                        ends[slot, 3],
                    )
                else:
                    slot = np.int32(-1)
                    overlap = _mask_pair(
                        a,
                        b,
                        middle_a,
                        middle_b,
                        move,
                        radius2,
                        columns,
                        lines,
                        shape,
                        flat_size,
                        own_mask,
                    )
                count = overlap.count
                if count < 4:
                    continue
                own = lens * size + overlap.first
                there = other * size + overlap.first
                if slot >= 0:
                    mask = slot * length + overlap.first
                    sums = _strip_moments(values, own, there, overlap, line, mask, move.weights)
                else:
                    sums = _strip_moments(values, own, there, overlap, own_mask, 0, move.weights)
                sa, sb, squares, srr = sums
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


def pair_terms(
    gray: GrayFlat,
    statistics: LensStatistics,
    noise: float,
    expected: NDArray[np.float32] | None = None,
) -> PairTerms:
    """What the costs of the pairs of a flat depend on, with this `noise` of a pixel [white].

    Shifts are counted from the `expected` patch sizes (n,) [px], from 0 by default.
    """
    # A match at zero may be one of shading, which stays with its lens, if contrast is below 3 % of
    # white.
    doubts = 1 / (1 + np.square(statistics.contrast / np.float32(0.03)))
    if expected is None:
        expected = np.zeros_like(doubts)
    else:
        doubts = doubts * _near_zero(expected, gray.pitch)
    return PairTerms(
        gray.centres,
        np.float32(gray.radius),
        np.float32(gray.pitch),
        statistics.mean,
        expected,
        doubts.astype(np.float32),
        np.float32(noise**2),
        np.float32(FIXED_PATTERN),
        np.float32(half_weight_area(gray)),
    )


def pairs_of(
    rows: NDArray[np.int32], active: NDArray[np.bool_], done: NDArray[np.bool_] | None = None
) -> NDArray[np.int32]:
    """The neighbours `rows` (n, d) of pairs with an `active` lens (n,), and none that is `done`
    (n,); -1 for all others.
    """
    wanted = (rows >= 0) & (active[:, None] | active[rows])
    if done is not None:
        wanted &= ~(done[:, None] | done[rows])
    return np.where(wanted, rows, np.int32(-1))


def shifts_from_zero(sizes: NDArray[np.float32], pitch: float) -> Shifts:
    """All shifts of these `sizes` (k,) [px], counted from zero."""
    return Shifts(sizes, _near_zero(sizes, pitch), np.arange(len(sizes)))


def _near_zero(sizes: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """One at patch size zero, less farther away: shading shows within 0.08 pitches."""
    return np.asarray(np.exp(-np.square(sizes / np.float32(pitch) / np.float32(0.08))))


def compute_pair_costs(
    terms: PairTerms,
    strips: Strips,
    masks: OverlapMasks,
    rows: NDArray[np.int32],
    shifts: Shifts,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """(n, d, k) float32 `1 - rho` of each lens with its neighbours `rows` (n, d) at each shift.

    A difference of means counts by half; noise, remaining shading and small overlaps pull the cost
    toward 1. Where a row is -1 the cost is 1, or that in `out` of an earlier call.
    """
    if out is None:
        out = np.ones((*rows.shape, len(shifts.sizes)), np.float32)
    _pair_costs(terms, strips, masks, rows, shifts, out)
    return out
