"""Matching cost of neighbouring microimages over signed shifts: the cost volume.

The cost is `1 - rho`: one minus the correlation coefficient over the pixels that two microimages share at a shift
(Lumsdaine and Georgiev 2008, section 4), with noise, remaining shading and small overlaps taken into account.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import VECTOR_LENGTH, OverlapMasks, Strips, extract_strips, make_shift_masks, overlap_range
from ...runtime.buffers import allocate_pooled
from ...runtime.cache import cached
from .pair_moments import Overlap, pair_moments, rim_moments, strip_moments
from .settings import COST

__all__ = [
    "CostTerms", "LensImages", "StripTable", "compute_pair_costs", "half_weight_area", "lens_images", "match_cost",
    "mean_steps", "moments_cost", "overlap_masks", "shading_decay", "shading_doubt", "strip_table",
]  # fmt: skip

# Centres and shifts are rounded to pixels independently, which moves a shift by up to two pixels each way.
_ROUNDING = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), -1).reshape(-1, 2)
# Pairs of a direction over which its mean step is taken.
_STEP_SAMPLES = 500


class LensImages(NamedTuple):
    """The flat and its lenses as kernels take them: `centres` (n, 2) [px], `mean` and `contrast` (n,) [white = 1]."""

    image: NDArray[np.float32]
    centres: NDArray[np.float32]
    radius: np.float32
    pitch: np.float32
    mean: NDArray[np.float32]
    contrast: NDArray[np.float32]


class CostTerms(NamedTuple):
    """Noise [white = 1], shading [share of the mean], overlap with half weight [px^2], and step between rows read."""

    noise: np.float32
    shading: np.float32
    half_weight: np.float32
    row_step: int


class StripTable(NamedTuple):
    """Microimages as `Strips` and the masks of the pixels that two of them share, as kernels take them."""

    values: NDArray[np.float32]
    middle: NDArray[np.int32]
    whole: NDArray[np.bool_]
    half: int
    width: int
    size: int
    columns: NDArray[np.float32]
    lines: NDArray[np.float32]
    bunch: int
    slots: NDArray[np.int32]
    masks: NDArray[np.float32]
    ends: NDArray[np.int32]
    counts: NDArray[np.int32]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def shading_decay(shift, pitch):
    """How the weight of shading falls with the shift: shading stays with its lens, so that it matches at zero."""
    ratio = shift / (COST.shading_reach * pitch)
    return np.exp(-ratio * ratio)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def shading_doubt(contrast):
    """Share of a correlation at zero shift that shading may explain, for lenses of this contrast."""
    return (
        COST.shading_contrast
        * COST.shading_contrast
        / (COST.shading_contrast * COST.shading_contrast + contrast * contrast)
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def match_cost(pixels, variance, residual, offset, floor, half_weight, doubt):
    """Cost of a pair.

    `variance` is the sum of both variances, `residual` the variance of the difference and `offset` its mean; `floor` is
    the variance of noise and shading.
    """
    square = COST.offset_weight * offset * offset
    quality = (residual + square + floor) / (variance + square + floor)
    weight = np.float32(pixels) / (np.float32(pixels) + half_weight) * (np.float32(1.0) - doubt)
    return np.float32(1.0) - weight * (np.float32(1.0) - quality)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def moments_cost(count, sa, sb, saa, sbb, sab, mean_difference, row_step, floor, half_weight, doubt):
    """`match_cost` of a pair from the sums over the `count` pixels that it shares."""
    inverse = np.float32(1.0) / np.float32(count)
    ma, mb = sa * inverse, sb * inverse
    variance = (saa + sbb) * inverse - ma * ma - mb * mb
    residual = variance - np.float32(2.0) * (sab * inverse - ma * mb)
    return match_cost(count * row_step, variance, residual, ma - mb + mean_difference, floor, half_weight, doubt)


# No fast math here: Numba optimises such a body once when it compiles and twice when it loads it from the cache, which
# would add in another order. The row loops above keep their order.
@njit(cache=True, nogil=True, error_model="numpy", share=lambda lenses, rows, *_: len(rows))
def _pair_costs(begin, end, lenses, rows, active, done, shifts, which, terms, table, fresh, out):
    image, centres, radius, pitch, means, contrast = lenses
    noise, shading, half_weight, row_step = terms
    strips, middle, whole, half, width, size, columns, lines, bunch, slots, masks, ends, counts = table
    reach, length = len(slots) // 2, masks.shape[1]
    enough, one = COST.min_overlap * radius * radius, np.float32(1.0)
    pixels, line = strips.reshape(-1), masks.reshape(-1)
    near_zero = np.empty(len(shifts), np.float32)
    for k in range(len(shifts)):
        near_zero[k] = shading_decay(shifts[k], pitch)
    for lens in range(begin, end):
        if fresh:
            out[lens] = 1.0
        ax, ay = centres[lens, 0], centres[lens, 1]
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]) or done[lens] or done[other]:
                continue
            bx, by = centres[other, 0], centres[other, 1]
            mean = np.float32(0.5) * (means[lens] + means[other])
            floor = np.float32(2.0) * (noise * noise + shading * shading * mean * mean)
            doubt = shading_doubt(min(contrast[lens], contrast[other]))
            stripped = whole[lens] and whole[other]
            gap_x, gap_y = middle[other, 0] - middle[lens, 0], middle[other, 1] - middle[lens, 1]
            for k in which:
                grow = one + shifts[k] / pitch
                tx, ty = (bx - ax) * grow, (by - ay) * grow
                floor_x, floor_y = np.floor(tx), np.floor(ty)
                fx, fy = tx - floor_x, ty - floor_y
                weights = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
                dx, dy = int(floor_x) - gap_x, int(floor_y) - gap_y
                slot = -1
                if stripped and abs(dx) <= reach and abs(dy) <= reach:
                    slot = slots[dy + reach, dx + reach]
                # Strips are relative to the mean of their lens, the flat is not.
                difference = means[lens] - means[other]
                if slot >= 0 and counts[slot] * row_step > enough:
                    count = np.float32(counts[slot])
                    start = ends[slot, 0]
                    sa, sb, saa, sbb, sab = strip_moments(
                        pixels, lens * size + start, other * size + start, ends[slot, 2], ends[slot, 3], line,
                        slot * length + start, ends[slot, 1], weights,
                    )  # fmt: skip
                elif slot >= 0:
                    first, number = overlap_range(dx, dy, half, width, row_step, bunch)
                    if number <= 0:
                        continue
                    mx, my = np.float32(middle[lens, 0]), np.float32(middle[lens, 1])
                    low_x, low_y = np.float32(-half - dx), np.float32(-half - dy)
                    both = Overlap(ax - mx, ay - my, bx - tx - mx, by - ty - my, low_x, low_y, radius * radius)
                    count, sa, sb, saa, sbb, sab = rim_moments(
                        pixels, columns, lines, lens * size + first, other * size + first, ends[slot, 2],
                        ends[slot, 3], first, number, both, weights,
                    )  # fmt: skip
                else:
                    count, sa, sb, saa, sbb, sab = pair_moments(image, ax, ay, bx, by, radius, tx, ty, mean, row_step)
                    difference = np.float32(0.0)
                if count < 4:
                    continue
                out[lens, d, k] = moments_cost(
                    count, sa, sb, saa, sbb, sab, difference, row_step, floor, half_weight, doubt * near_zero[k]
                )


def overlap_masks(
    strips: Strips,
    gray: GrayFlat,
    rows: NDArray[np.int32],
    shifts: NDArray[np.float32],
    expected: NDArray[np.float32] | None = None,
) -> OverlapMasks:
    """`make_shift_masks` for all whole-pixel shifts of pairs at `shifts`, beside the `expected` (n,) if given."""
    tried = shifts
    if expected is not None and len(expected):
        tried = np.arange(expected.min() + shifts.min(), expected.max() + shifts.max() + 1)
    steps = mean_steps(gray, rows)
    whole = np.floor((tried / np.float32(gray.pitch))[:, None] * steps[:, None]).astype(int)
    return make_shift_masks(strips, gray.radius, (whole.reshape(-1, 1, 2) + _ROUNDING).reshape(-1, 2))


def strip_table(strips: Strips, masks: OverlapMasks) -> StripTable:
    """Strips and masks as kernels take them."""
    columns, lines = strips.offsets
    slots, pixels, ends, counts = masks
    return StripTable(
        strips.values, strips.centre_pixels, strips.complete, strips.half_width, strips.width, strips.size, columns,
        lines, VECTOR_LENGTH, slots, pixels, ends, counts,
    )  # fmt: skip


def mean_steps(gray: GrayFlat, rows: NDArray[np.int32]) -> NDArray[np.float32]:
    """(k, 2) steps `x, y` [px of `gray`] to the neighbours (n, d), in all directions in which there are any."""
    # Cached with the rows of the lattice, per pitch, since the same flat may be matched at several scales.
    return cached(rows, ("mean steps", gray.pitch), lambda: _mean_steps(gray.centres, rows))


@njit(cache=True, nogil=True)
def _mean_steps(centres, rows):
    found = np.zeros((rows.shape[1], 2), np.float32)
    directions = 0
    for d in range(rows.shape[1]):
        number = 0
        for lens in range(len(rows)):
            number += rows[lens, d] >= 0
        if number == 0:
            continue
        every, seen, count, x, y = max(1, number // _STEP_SAMPLES), 0, 0, 0.0, 0.0
        for lens in range(len(rows)):
            other = rows[lens, d]
            if other < 0:
                continue
            if seen % every == 0:
                x += centres[other, 0] - centres[lens, 0]
                y += centres[other, 1] - centres[lens, 1]
                count += 1
            seen += 1
        found[directions, 0], found[directions, 1] = x / count, y / count
        directions += 1
    return found[:directions]


def half_weight_area(gray: GrayFlat) -> float:
    """Overlap of two microimages [px^2] at which a match has half weight."""
    return float(COST.half_weight_share * np.pi * gray.radius**2)


def compute_pair_costs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    means: NDArray[np.float32],
    contrast: NDArray[np.float32],
    active: NDArray[np.bool_],
    shifts: NDArray[np.float32],
    noise: float,
    shading: float,
    row_step: int = 1,
    which: NDArray[np.int64] | None = None,
    done: NDArray[np.bool_] | None = None,
    out: NDArray[np.float32] | None = None,
    strips: Strips | None = None,
    masks: OverlapMasks | None = None,
) -> NDArray[np.float32]:
    """(n, d, k) float32 matching cost of each lens with its neighbours `rows` (n, d) at each of the `shifts` (k,) [px].

    The cost is `1 - rho`, the correlation coefficient over the pixels that both microimages show at that shift. A
    difference of their `means` (n,) counts by half; the `noise` of a pixel [white = 1], remaining `shading` [share of
    the mean] and small overlaps pull the cost toward 1. Pairs without an `active` lens (n,) cost 1.

    Only every `row_step`-th row of pixels is read. Given an `out` of an earlier call, only the shifts `which` (m,) of
    lenses that are not `done` (n,) are added. `strips` of `gray` and their `overlap_masks` are made if not given.
    """
    fresh = out is None
    if out is None:
        out = allocate_pooled((len(gray.centres), rows.shape[1], len(shifts)), np.float32)
    which = np.arange(len(shifts)) if which is None else which
    done = np.zeros(len(active), bool) if done is None else done
    strips = extract_strips(gray, means, row_step) if strips is None else strips
    masks = overlap_masks(strips, gray, rows, shifts[which]) if masks is None else masks
    lenses = lens_images(gray, means, contrast)
    terms = CostTerms(np.float32(noise), np.float32(shading), np.float32(half_weight_area(gray)), row_step)
    _pair_costs(
        lenses, rows, active, done, shifts.astype(np.float32), which, terms, strip_table(strips, masks), fresh, out
    )
    return out


def lens_images(gray: GrayFlat, means: NDArray[np.float32], contrast: NDArray[np.float32]) -> LensImages:
    """The flat and the statistics of its lenses (n,) as kernels take them."""
    return LensImages(gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), means, contrast)
