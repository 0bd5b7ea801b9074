"""Matching cost of neighbouring microimages at one expected patch size, and where near it the minimum lies.

One pass over the pixels gives the cost and its derivatives, and so a Gauss-Newton step, instead of costs on both sides.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import Strips
from ...flat.texture import FIXED_PATTERN, LensStatistics
from .cost_volume import overlap_masks, pair_terms, shading_decay
from .pair_moments import PairTerms, StripTable, match_cost, shared_pixels, strip_table
from .settings import COST
from .sgm import average_pair_costs

__all__ = ["match_locally"]


# Indices are unsigned, because signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(strips, own, other, upper, lower, masks, mask, count, weights, slopes):
    """Sums over the masked pixels of one strip, the interpolated ones of another, their difference and derivative."""
    one = np.uint64(1)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, m = np.uint64(own), np.uint64(mask)
    w00, w01, w10, w11 = weights
    p00, p01, p10, p11 = slopes
    sa = sb = squares = srr = sp = spp = spr = np.float32(0.0)
    for k in range(np.uint64(count)):
        v00, v01, v10, v11 = strips[above + k], strips[above + one + k], strips[below + k], strips[below + one + k]
        b = (w00 * v00 + w01 * v01) + (w10 * v10 + w11 * v11)
        p = (p00 * v00 + p01 * v01) + (p10 * v10 + p11 * v11)
        b, p, c = b * masks[m + k], p * masks[m + k], strips[a + k] * masks[m + k]
        r = c - b
        sa += c
        sb += b
        squares += c * c + b * b
        srr += r * r
        sp += p
        spp += p * p
        spr += p * r
    return sa, sb, squares, srr, sp, spp, spr


# No fast math here, as in `cost_volume._pair_costs`.
@kernel(error_model="numpy", share=lambda terms, rows, *_: len(rows))
def _local_costs(begin, end, terms: PairTerms, rows, active, expected, table: StripTable, out):
    """Fill `out` (n, d, 3) with the cost of each pair, and its first and second derivative."""
    centres, radius, pitch, means, doubts, noise2, shading, half_weight = terms
    values, middle, whole, columns, lines, slots, masks, ends, counts, layout, height, across = table
    _, width, tall, step, _ = layout
    size, length = tall * step * width, masks.shape[1]
    own_mask = np.empty(length, np.float32)
    one, half_way = np.float32(1.0), np.float32(0.5)
    for lens in range(begin, end):
        ax, ay = centres[lens, 0], centres[lens, 1]
        mx, my = middle[lens, 0], middle[lens, 1]
        for d in range(rows.shape[1]):
            found = out[lens, d]
            found[0], found[1], found[2] = one, np.float32(0.0), np.float32(0.0)
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]):
                continue
            bx, by = centres[other, 0], centres[other, 1]
            nx, ny = middle[other, 0], middle[other, 1]
            mean = half_way * (means[lens] + means[other])
            floor = np.float32(2.0) * (noise2 + shading * shading * mean * mean)
            doubt, difference = max(doubts[lens], doubts[other]), means[lens] - means[other]
            shift = half_way * (expected[lens] + expected[other])
            ux, uy = (bx - ax) / pitch, (by - ay) / pitch
            tx, ty = bx - ax + shift * ux, by - ay + shift * uy
            floor_x, floor_y = np.floor(tx), np.floor(ty)
            fx, fy, dx, dy = tx - floor_x, ty - floor_y, int(floor_x) - nx + mx, int(floor_y) - ny + my
            count, slot, first, number, upper, lower = shared_pixels(
                dx, dy, whole[lens] and whole[other], (mx, my), (nx, ny),
                (ax - mx, ay - my, bx - tx - mx, by - ty - my), radius * radius, slots, ends, counts, columns, lines,
                layout, (height, across), own_mask,
            )  # fmt: skip
            if count < 4:
                continue
            gx, gy = one - fx, one - fy
            weights = gx * gy, fx * gy, gx * fy, fx * fy
            slopes = -ux * gy - uy * gx, ux * gy - uy * fx, uy * gx - ux * fy, ux * fy + uy * fx
            own, there = lens * size + first, other * size + first
            line, mask = (masks.reshape(-1), slot * length + first) if slot >= 0 else (own_mask, np.int64(0))
            sa, sb, squares, srr, sp, spp, spr = _sums(
                values, own, there, upper, lower, line, mask, number, weights, slopes
            )
            found[0] = match_cost(count, sa, sb, squares, srr, difference, count * step, floor, half_weight, doubt)
            found[1], found[2] = spr - sp * (sa - sb) / count, spp - sp * sp / count


def match_locally(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    statistics: LensStatistics,
    active: NDArray[np.bool_],
    expected: NDArray[np.float32],
    noise: float,
    strips: Strips,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Match each lens with its neighbours at an expected patch size, with one Gauss-Newton step toward the minimum.

    `forward` and `backward` (n, d) are neighbour rows, `expected` (n,) [px of `gray`]; pairs without an `active` lens
    (n,) cost 1. The `strips` of `gray` must hold the active lenses and their neighbours.

    Returns the cost (n,), mean over the pairs of each lens; the offset (n,) [px] from there to the minimum, to first
    order, at most `CostSettings.max_offset` and biased toward 0 by noise; and the standard error (n,) [px] of the
    offset of one pair.
    """
    expected = expected.astype(np.float32)
    masks = overlap_masks(strips, gray, forward, np.zeros(1, np.float32), expected)
    pairs = np.empty((*forward.shape, 3), np.float32)
    terms = pair_terms(gray, statistics.mean, statistics.contrast, noise, FIXED_PATTERN)
    doubts = terms.doubts * shading_decay(expected / terms.pitch)
    _local_costs(terms._replace(doubts=doubts), forward, active, expected, strip_table(strips, masks, gray), pairs)
    cost, gradient, curvature = average_pair_costs(pairs, forward, backward).T
    curvature = np.maximum(curvature, np.float32(1e-12))
    # Both microimages of a pair have noise.
    error = np.float32(np.sqrt(2) * noise) / np.sqrt(curvature)
    return np.ascontiguousarray(cost), np.clip(gradient / curvature, -COST.max_offset, COST.max_offset), error
