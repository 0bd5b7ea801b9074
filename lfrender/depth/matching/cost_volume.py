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


class _Raster(NamedTuple):
    """Pixels of strips."""

    half: Any  # int [px]: from the middle of a microimage to its sides
    width: Any  # int [px]: of a row
    rows: Any  # int: number of rows of a part
    step: Any  # int: number of parts
    flat_size: Any  # two int [px]: height and width of the flat
    radius2: Any  # float32 [px^2]: of microimages


class _Overlap(NamedTuple):
    """Pixels that two strips share."""

    first: Any  # int32: place of the first one in the first strip
    number: Any  # int32: of those to read
    upper: Any  # int32: from a place in the first strip to its partner in the second one
    lower: Any  # int32: and to the pixel below that


# The error model of NumPy, because Python's checks every division, which prevents vector loops.
# Indices are unsigned, because signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _strip_moments(strips, own, other, overlap, masks, mask, chosen, at, weights):
    """Number of the masked pixels of one strip, and sums over them and the interpolated ones of
    another: of both, of the squares of both, and of those of their differences.

    Unless it is None, `chosen` from place `at` on masks the first strip, too.
    """
    one = np.uint64(1)
    above = np.uint64(other + overlap.upper)
    below = np.uint64(other + overlap.lower)
    a = np.uint64(own)
    m = np.uint64(mask)
    first = np.uint64(at)
    w00, w01, w10, w11 = weights
    count = sa = sb = squares = srr = np.float32(0.0)
    for k in range(np.uint64(overlap.number)):
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        counts = masks[m + k]
        if chosen is not None:
            counts *= chosen[first + k]
        b *= counts
        c = counts * strips[a + k]
        count += counts
        sa += c
        sb += b
        squares += c * c + b * b
        srr += (c - b) * (c - b)
    return count, sa, sb, squares, srr


@njit(error_model="numpy", forceinline=True)
def _disc_moments(values, own, other, pair, move, raster, ones, chosen, begin):
    """As `_strip_moments`, row by row, for the pixels of a strip that have a partner in another one,
    in both discs and on the flat.
    """
    a, b, middle, far = pair
    ax = a[0] - middle[0]
    ay = a[1] - middle[1]
    bx = b[0] - move.x - middle[0]
    by = b[1] - move.y - middle[1]
    half = raster.half
    width = raster.width
    step = raster.step
    dx = move.across
    dy = move.down
    height, across = raster.flat_size
    # Interpolation reads one pixel beyond, and both microimages end at the border of the flat.
    left = max(-middle[0], -far[0] - dx)
    right = min(across - 1 - middle[0], across - 2 - far[0] - dx)
    top = max(-half, -middle[1], -far[1] - dy)
    bottom = min(half, height - 1 - middle[1], height - 2 - far[1] - dy)
    upper = ((dy % step) * raster.rows + dy // step) * width + dx
    lower = (((dy + 1) % step) * raster.rows + (dy + 1) // step) * width + dx
    count = sa = sb = squares = srr = np.float32(0.0)
    for line in range((top + half + step - 1) // step, (bottom + half) // step + 1):
        y = np.float32(line * step - half)
        own2 = raster.radius2 - (y - ay) * (y - ay)
        other2 = raster.radius2 - (y - by) * (y - by)
        if min(own2, other2) < 0:
            continue
        own_half = np.sqrt(own2)
        other_half = np.sqrt(other2)
        first = max(left, int(np.ceil(max(ax - own_half, bx - other_half))))
        last = min(right, int(np.floor(min(ax + own_half, bx + other_half))))
        if last < first:
            continue
        at = line * width + first + half
        row = _Overlap(
            np.int32(at),
            np.int32(last + 1 - first),
            np.int32(upper),
            np.int32(lower),
        )
        sums = _strip_moments(
            values, own + at, other + at, row, ones, 0, chosen, begin + at, move.weights
        )
        count += sums[0]
        sa += sums[1]
        sb += sums[2]
        squares += sums[3]
        srr += sums[4]
    return count, sa, sb, squares, srr


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
def _pair_costs(begin, end, terms, strips, masks, rows, tried, chosen, out):
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
    step = strips.step
    radius2 = radius * radius
    raster = _Raster(strips.half, strips.width, strips.rows, step, strips.flat_size, radius2)
    slots, shared, ends, counts = masks
    sizes, near_zero, which = tried
    line = shared.reshape(-1)
    length = shared.shape[1]
    ones = np.ones(strips.width, np.float32)
    reach = len(slots) // 2
    part = strips.rows * strips.width
    size = step * part
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
                own = lens * size
                there = other * size
                of_chosen = lens * part
                # Of small overlaps, below a third of a microimage, the pixels at the rim are tested
                # one by one, unless few pixels are chosen.
                if slot >= 0 and (chosen is not None or counts[slot] * step > radius2):
                    overlap = _Overlap(ends[slot, 0], ends[slot, 1], ends[slot, 2], ends[slot, 3])
                    first = overlap.first
                    count, sa, sb, squares, srr = _strip_moments(
                        values,
                        own + first,
                        there + first,
                        overlap,
                        line,
                        slot * length + first,
                        chosen,
                        of_chosen + first,
                        move.weights,
                    )
                else:
                    pair = (a, b, middle_a, middle_b)
                    count, sa, sb, squares, srr = _disc_moments(
                        values, own, there, pair, move, raster, ones, chosen, of_chosen
                    )
                if count < 4:
                    continue
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
    chosen: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """(n, d, k) float32 `1 - rho` of each lens with its neighbours `rows` (n, d) at each shift.

    A difference of means counts by half; noise, remaining shading and small overlaps pull the cost
    toward 1. Where a row is -1 the cost is 1, or that in `out` of an earlier call. Of the pixels of
    the first part of a strip, only those `chosen` (n * rows * width) count, 1 or 0, all by default.
    """
    if out is None:
        out = np.ones((*rows.shape, len(shifts.sizes)), np.float32)
    _pair_costs(terms, strips, masks, rows, shifts, chosen, out)
    return out
