"""How well neighbouring microimages agree at a shift that is known, and how far beside it the best one lies.

One look at the pixels tells both: a step of Gauss and Newton from there, instead of costs on both sides.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import VECTOR_LENGTH, Strips, overlap_range
from ...flat.texture import FIXED_PATTERN_CONTRAST, LensStatistics
from .cost_volume import (
    MIN_OVERLAP,
    half_weight_area,
    match_cost,
    overlap_masks,
    pair_moments,
    shading_decay,
    shading_doubt,
)
from .sgm import average_pair_costs

__all__ = ["FARTHEST", "probe"]

#: A step farther than this tells its side alone [px].
FARTHEST = 0.75


# Places are unsigned: signed ones are looked at for being counted from the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(strips, own, other, upper, lower, masks, mask, count, w00, w01, w10, w11, p00, p01, p10, p11):
    """Sums over the masked pixels of one strip, those that another shows there, their difference and their slope."""
    one = np.uint64(1)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, m = np.uint64(own), np.uint64(mask)
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
def _mask(columns, lines, start, count, ex, ey, qx, qy, low_x, low_y, r2, out):
    """Which pixels of a strip from `start` on are within the radius in both microimages; how many."""
    first, number = np.uint64(start), np.float32(0.0)
    for k in range(np.uint64(count)):
        x, y = columns[first + k], lines[first + k]
        own_2, other_2 = (x - ex) * (x - ex) + (y - ey) * (y - ey), (x - qx) * (x - qx) + (y - qy) * (y - qy)
        inside = (max(own_2, other_2) <= r2) & (x >= low_x) & (y >= low_y)
        out[k] = np.float32(1.0) if inside else np.float32(0.0)
        number += out[k]
    return number


# Without fast math of its own, as `matching._pair_costs`.
@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _probe_pairs(
    image, centres, radius, pitch, rows, means, contrast, active, about, noise, shading, row_step, half, strips, middle,
    whole, side, width, size, columns, lines, bunch, slots, masks, ends, counts, out,
):  # fmt: skip
    """Fill `out` (n, d, 3) with the cost of each pair, its gradient and its steepness."""
    reach, length = len(slots) // 2, masks.shape[1]
    one, half_way = np.float32(1.0), np.float32(0.5)
    pixels, line = strips.reshape(-1), masks.reshape(-1)
    for lens in prange(len(centres)):
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
            shift = half_way * (about[lens] + about[other])
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
                    inverse = one / np.float32(count)
                    ma, mb = sa * inverse, sb * inverse
                    variance = (saa + sbb) * inverse - ma * ma - mb * mb
                    residual = variance - np.float32(2.0) * (sab * inverse - ma * mb)
                    found[0] = match_cost(count * row_step, variance, residual, ma - mb, floor, half, doubt)
                continue
            if counts[slot] * row_step > MIN_OVERLAP * radius * radius:
                count, start, number = np.float32(counts[slot]), ends[slot, 0], ends[slot, 1]
                mask_of, mask_at = line, slot * length + start
            else:
                start, number = overlap_range(dx, dy, side, width, row_step, bunch)
                if number <= 0:
                    continue
                mx, my = np.float32(middle[lens, 0]), np.float32(middle[lens, 1])
                count = _mask(
                    columns, lines, start, number, ax - mx, ay - my, bx - tx - mx, by - ty - my, np.float32(-side - dx),
                    np.float32(-side - dy), radius * radius, shared,
                )  # fmt: skip
                if count < 4:
                    continue
                mask_of, mask_at = shared, 0
            gx, gy = one - fx, one - fy
            w00, w01, w10, w11 = gx * gy, fx * gy, gx * fy, fx * fy
            p00, p01, p10, p11 = -ux * gy - uy * gx, ux * gy - uy * fx, uy * gx - ux * fy, ux * fy + uy * fx
            sa, sb, squares, srr, sp, spp, spr = _sums(
                pixels, lens * size + start, other * size + start, ends[slot, 2], ends[slot, 3], mask_of, mask_at,
                number, w00, w01, w10, w11, p00, p01, p10, p11,
            )  # fmt: skip
            inverse = one / count
            ma, mb = sa * inverse, sb * inverse
            variance = squares * inverse - ma * ma - mb * mb
            residual = srr * inverse - (ma - mb) * (ma - mb)
            apart = ma - mb + means[lens] - means[other]
            found[0] = match_cost(count * row_step, variance, residual, apart, floor, half, doubt)
            found[1], found[2] = spr - sp * (sa - sb) * inverse, spp - sp * sp * inverse


def probe(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    statistics: LensStatistics,
    active: NDArray[np.bool_],
    about: NDArray[np.float32],
    noise: float,
    strips: Strips,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """How badly each lens agrees with its neighbours at the patch size that it is expected to have, how far from
    that the best one lies, and how well noise lets that be told.

    Parameters
    ----------
    gray : GrayFlat
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    statistics : LensStatistics
    active : (n,) bool
        Pairs without an active lens are not matched and cost 1.
    about : (n,) float32 [px of `gray`]
    noise : float
        Standard deviation of a pixel.
    strips : Strips
        Of `gray`, cut out for the active lenses and those beside them.

    Returns
    -------
    cost : (n,) float32
        As `pair_costs`, the mean over the pairs of each lens.
    offset : (n,) float32 [px of `gray`]
        To a first order, and at most `FARTHEST`; less under noise, which has slopes of its own.
    error : (n,) float32 [px of `gray`]
        Standard deviation of the offset of one pair of the lens under noise.
    """
    about = about.astype(np.float32)
    masks = overlap_masks(strips, gray, forward, np.zeros(1, np.float32), about)
    pairs = np.empty((*forward.shape, 3), np.float32)
    _probe_pairs(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), forward, statistics.mean,
        statistics.contrast, active, about, np.float32(noise), np.float32(FIXED_PATTERN_CONTRAST), strips.step,
        np.float32(half_weight_area(gray)), strips.values, strips.centre_pixels, strips.complete, strips.half_width,
        strips.width, strips.size, *strips.offsets, VECTOR_LENGTH, *masks, pairs,
    )  # fmt: skip
    cost, gradient, steepness = average_pair_costs(pairs, forward, backward).T
    steepness = np.maximum(steepness, np.float32(1e-12))
    # Both microimages of a pair have noise.
    error = np.float32(np.sqrt(2) * noise) / np.sqrt(steepness)
    return np.ascontiguousarray(cost), np.clip(gradient / steepness, -FARTHEST, FARTHEST), error
