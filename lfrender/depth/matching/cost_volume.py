"""Matching cost of neighbouring microimages over signed shifts: the cost volume.

The cost is `1 - rho`: one minus the correlation coefficient over the pixels that two microimages share at a shift
(Lumsdaine and Georgiev 2008, section 4), with noise, remaining shading and small overlaps taken into account.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import OverlapMasks, Strips, extract_strips, make_shift_masks
from ...runtime.buffers import allocate_pooled
from ...runtime.cache import cached
from .pair_moments import PairTerms, StripTable, match_cost, shared_pixels, strip_moments, strip_table
from .settings import COST

__all__ = ["compute_pair_costs", "half_weight_area", "mean_steps", "overlap_masks", "pair_terms", "shading_decay"]

# Centres and shifts are rounded to pixels independently, which moves a shift by up to two pixels each way.
_ROUNDING = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), -1).reshape(-1, 2)
# Pairs of a direction over which its mean step is taken.
_STEP_SAMPLES = 500


def shading_decay(ratio: NDArray[np.float32]) -> NDArray[np.float32]:
    """How the weight of shading falls with shift over pitch: it stays with its lens, so that it matches at zero."""
    return np.exp(-np.square(ratio / COST.shading_reach))


@kernel(error_model="numpy", share=lambda terms, rows, *_: len(rows))
def _pair_costs(
    begin, end, terms: PairTerms, rows, active, done, shifts, near_zero, which, table: StripTable, fresh, out
):
    centres, radius, pitch, means, doubts, noise2, shading, half_weight = terms
    values, middle, whole, columns, lines, slots, masks, ends, counts, layout, height, across = table
    _, width, tall, step, _ = layout
    size, length = tall * step * width, masks.shape[1]
    line, one, own_mask = masks.reshape(-1), np.float32(1.0), np.empty(length, np.float32)
    reach = len(slots) // 2
    for lens in range(begin, end):
        if fresh:
            out[lens] = 1.0
        ax, ay = centres[lens, 0], centres[lens, 1]
        mx, my = middle[lens, 0], middle[lens, 1]
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]) or done[lens] or done[other]:
                continue
            bx, by = centres[other, 0], centres[other, 1]
            nx, ny = middle[other, 0], middle[other, 1]
            mean = np.float32(0.5) * (means[lens] + means[other])
            floor = np.float32(2.0) * (noise2 + shading * shading * mean * mean)
            doubt, difference = max(doubts[lens], doubts[other]), means[lens] - means[other]
            for k in which:
                grow = one + shifts[k] / pitch
                tx, ty = (bx - ax) * grow, (by - ay) * grow
                floor_x, floor_y = np.floor(tx), np.floor(ty)
                fx, fy, dx, dy = tx - floor_x, ty - floor_y, int(floor_x) - nx + mx, int(floor_y) - ny + my
                # Looked up here, since a call counts references to all arrays.
                slot = np.int32(-1)
                if whole[lens] and whole[other] and abs(dx) <= reach and abs(dy) <= reach:
                    slot = slots[dy + reach, dx + reach]
                if slot >= 0 and counts[slot] * step > COST.min_overlap * radius * radius:
                    count = np.float32(counts[slot])
                    first, number, upper, lower = ends[slot, 0], ends[slot, 1], ends[slot, 2], ends[slot, 3]
                else:
                    count, slot, first, number, upper, lower = shared_pixels(
                        dx, dy, False, (mx, my), (nx, ny), (ax - mx, ay - my, bx - tx - mx, by - ty - my),
                        radius * radius, slots, ends, counts, columns, lines, layout, (height, across), own_mask,
                    )  # fmt: skip
                if count < 4:
                    continue
                weights = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
                own, there = lens * size + first, other * size + first
                if slot >= 0:
                    sa, sb, squares, srr = strip_moments(
                        values, own, there, upper, lower, line, slot * length + first, number, weights
                    )
                else:
                    sa, sb, squares, srr = strip_moments(values, own, there, upper, lower, own_mask, 0, number, weights)
                out[lens, d, k] = match_cost(
                    count, sa, sb, squares, srr, difference, count * step, floor, half_weight, doubt * near_zero[k]
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


def mean_steps(gray: GrayFlat, rows: NDArray[np.int32]) -> NDArray[np.float32]:
    """(k, 2) steps `x, y` [px of `gray`] to the neighbours (n, d), in all directions in which there are any."""
    # Cached with the rows of the lattice, per pitch, since the same flat may be matched at several scales.
    return cached(rows, ("mean steps", gray.pitch), lambda: _mean_steps(gray.centres, rows))


def _mean_steps(centres: NDArray[np.float32], rows: NDArray[np.int32]) -> NDArray[np.float32]:
    found = []
    for row in rows.T:
        lens = np.flatnonzero(row >= 0)
        lens = lens[:: max(1, len(lens) // _STEP_SAMPLES)]
        if len(lens):
            found.append((centres[row[lens]] - centres[lens]).mean(0, dtype=float))
    return np.array(found, np.float32).reshape(-1, 2)


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
    near_zero = shading_decay(shifts / np.float32(gray.pitch)).astype(np.float32)
    _pair_costs(
        pair_terms(gray, means, contrast, noise, shading), rows, active, done, shifts.astype(np.float32), near_zero,
        which, strip_table(strips, masks, gray), fresh, out,
    )  # fmt: skip
    return out


def pair_terms(
    gray: GrayFlat, means: NDArray[np.float32], contrast: NDArray[np.float32], noise: float, shading: float
) -> PairTerms:
    """The statistics of lenses (n,), noise and shading as kernels take them."""
    doubts = 1 / (1 + np.square(contrast / COST.shading_contrast))
    values = (noise**2, shading, half_weight_area(gray))
    return PairTerms(
        gray.centres, np.float32(gray.radius), np.float32(gray.pitch), means, doubts.astype(np.float32),
        *map(np.float32, values),
    )  # fmt: skip
