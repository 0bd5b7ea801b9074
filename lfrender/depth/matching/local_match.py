"""Matching cost of neighbouring microimages at one expected patch size, and where near it the minimum lies.

One pass over the pixels gives the cost and its derivatives, and so a Gauss-Newton step, instead of costs on both sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import Strips, overlap_range
from ...flat.settings import TEXTURE
from ...flat.texture import LensStatistics
from .cost_volume import (
    CostTerms,
    half_weight_area,
    lens_images,
    match_cost,
    moments_cost,
    overlap_masks,
    shading_decay,
    shading_doubt,
    strip_table,
)
from .pair_moments import Overlap, in_both, pair_moments
from .settings import COST
from .sgm import average_pair_costs

__all__ = ["match_locally"]


# Indices are unsigned, because signed ones are checked for counting from the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
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


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _mask(columns, lines, start, count, both, out):
    """Mask the pixels of a strip from `start` on that lie in both microimages; how many do."""
    first, number = np.uint64(start), np.float32(0.0)
    for k in range(np.uint64(count)):
        out[k] = np.float32(1.0) if in_both(columns[first + k], lines[first + k], both) else np.float32(0.0)
        number += out[k]
    return number


# No fast math here, as in `cost_volume._pair_costs`.
@njit(cache=True, nogil=True, error_model="numpy", share=lambda lenses, rows, *_: len(rows))
def _local_costs(begin, end, lenses, rows, active, expected, terms, table, out):
    """Fill `out` (n, d, 3) with the cost of each pair, and its first and second derivative."""
    image, centres, radius, pitch, means, contrast = lenses
    noise, shading, half_weight, row_step = terms
    strips, middle, whole, half, width, size, columns, lines, bunch, slots, masks, ends, counts = table
    reach, length = len(slots) // 2, masks.shape[1]
    one, half_way = np.float32(1.0), np.float32(0.5)
    pixels, line = strips.reshape(-1), masks.reshape(-1)
    for lens in range(begin, end):
        shared = np.empty(length, np.float32)
        ax, ay = centres[lens, 0], centres[lens, 1]
        for d in range(rows.shape[1]):
            found = out[lens, d]
            found[0], found[1], found[2] = one, np.float32(0.0), np.float32(0.0)
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]):
                continue
            bx, by = centres[other, 0], centres[other, 1]
            mean = half_way * (means[lens] + means[other])
            floor = np.float32(2.0) * (noise * noise + shading * shading * mean * mean)
            shift = half_way * (expected[lens] + expected[other])
            doubt = shading_doubt(min(contrast[lens], contrast[other])) * shading_decay(shift, pitch)
            ux, uy = (bx - ax) / pitch, (by - ay) / pitch
            tx, ty = bx - ax + shift * ux, by - ay + shift * uy
            floor_x, floor_y = np.floor(tx), np.floor(ty)
            fx, fy = tx - floor_x, ty - floor_y
            dx = int(floor_x) - middle[other, 0] + middle[lens, 0]
            dy = int(floor_y) - middle[other, 1] + middle[lens, 1]
            slot = -1
            if whole[lens] and whole[other] and abs(dx) <= reach and abs(dy) <= reach:
                slot = slots[dy + reach, dx + reach]
            if slot < 0:
                count, sa, sb, saa, sbb, sab = pair_moments(image, ax, ay, bx, by, radius, tx, ty, mean, row_step)
                if count >= 4:
                    found[0] = moments_cost(
                        count, sa, sb, saa, sbb, sab, np.float32(0.0), row_step, floor, half_weight, doubt
                    )
                continue
            if counts[slot] * row_step > COST.min_overlap * radius * radius:
                count, start, number = np.float32(counts[slot]), ends[slot, 0], ends[slot, 1]
                mask_of, mask_at = line, slot * length + start
            else:
                start, number = overlap_range(dx, dy, half, width, row_step, bunch)
                if number <= 0:
                    continue
                mx, my = np.float32(middle[lens, 0]), np.float32(middle[lens, 1])
                both = Overlap(
                    ax - mx, ay - my, bx - tx - mx, by - ty - my, np.float32(-half - dx), np.float32(-half - dy),
                    radius * radius,
                )  # fmt: skip
                count = _mask(columns, lines, start, number, both, shared)
                if count < 4:
                    continue
                mask_of, mask_at = shared, 0
            gx, gy = one - fx, one - fy
            weights = gx * gy, fx * gy, gx * fy, fx * fy
            slopes = -ux * gy - uy * gx, ux * gy - uy * fx, uy * gx - ux * fy, ux * fy + uy * fx
            sa, sb, squares, srr, sp, spp, spr = _sums(
                pixels, lens * size + start, other * size + start, ends[slot, 2], ends[slot, 3], mask_of, mask_at,
                number, weights, slopes,
            )  # fmt: skip
            inverse = one / count
            ma, mb = sa * inverse, sb * inverse
            variance = squares * inverse - ma * ma - mb * mb
            residual = srr * inverse - (ma - mb) * (ma - mb)
            offset = ma - mb + means[lens] - means[other]
            found[0] = match_cost(count * row_step, variance, residual, offset, floor, half_weight, doubt)
            found[1], found[2] = spr - sp * (sa - sb) * inverse, spp - sp * sp * inverse


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
    terms = CostTerms(
        np.float32(noise), np.float32(TEXTURE.fixed_pattern), np.float32(half_weight_area(gray)), strips.step
    )
    lenses = lens_images(gray, statistics.mean, statistics.contrast)
    _local_costs(lenses, forward, active, expected, terms, strip_table(strips, masks), pairs)
    cost, gradient, curvature = average_pair_costs(pairs, forward, backward).T
    curvature = np.maximum(curvature, np.float32(1e-12))
    # Both microimages of a pair have noise.
    error = np.float32(np.sqrt(2) * noise) / np.sqrt(curvature)
    return np.ascontiguousarray(cost), np.clip(gradient / curvature, -COST.max_offset, COST.max_offset), error
