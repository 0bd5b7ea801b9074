"""Correlation of neighbouring microimages over signed shifts."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import VECTOR_LENGTH, OverlapMasks, Strips, extract_strips, make_shift_masks, overlap_range
from ...runtime.buffers import allocate_pooled
from ...runtime.cache import cached
from ...runtime.scheduling import plan_chunks

__all__ = [
    "MIN_OVERLAP",
    "compute_pair_costs",
    "half_weight_area",
    "match_cost",
    "mean_steps",
    "overlap_masks",
    "pair_moments",
    "shading_decay",
    "shading_doubt",
]  # fmt: skip

# Part of a difference in mean brightness that counts as mismatch: neighbouring lenses may differ a
# little in gain, but on a smooth slope their means are all that tells the depth.
_OFFSET_WEIGHT = np.float32(0.5)
# Share of a microimage that must be common for a match to count half: some dozens of independent details. A larger
# one would pull patch sizes toward zero, where more is shared.
_HALF_TRUST = 0.06
# Shading that correction leaves behind looks like weak texture without disparity: a match this near
# zero (in pitches) is doubted by half where the contrast (white = 1) is only this.
_SHADED_REACH = np.float32(0.08)
_SHADED = np.float32(0.03)
#: Where two microimages share less than a third, so many squares of their radius, every pixel at the rim counts.
MIN_OVERLAP = np.float32(1.0)
# Centres and shifts are rounded to pixels each on its own, which moves a shift by so many pixels.
_ROUNDING = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), -1).reshape(-1, 2)
# So many pairs of a direction tell its mean step far better than that.
_PROBES = 500


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _row_moments(row, upper, lower, w00, w01, w10, w11, mean):
    """Sums over one row of pixels and what another lens shows in the rows `upper` and `lower`."""
    sa = sb = saa = sbb = sab = np.float32(0.0)
    for k in range(len(row)):
        a = row[k] - mean
        b = w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1] - mean
        sa += a
        sb += b
        saa += a * a
        sbb += b * b
        sab += a * b
    return sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def pair_moments(image, ax, ay, bx, by, radius, tx, ty, mean, row_step):
    """Sums over all pixels of lens a whose partner, `(tx, ty)` away, lies in lens b."""
    height, width = image.shape
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = saa = sbb = sab = np.float32(0.0)
    count = 0
    r2 = radius * radius
    # Centre of lens b's disc as seen from lens a's pixels.
    qx, qy = bx - tx, by - ty
    top = max(int(np.ceil(max(ay, qy) - radius)), max(0, -y0))
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 1, height - 2 - y0))
    for y in range(top, bottom + 1, row_step):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(0, -x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 1, width - 2 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        row = image[y, left : right + 1]
        upper = image[y + y0, left + x0 : right + x0 + 2]
        lower = image[y + y0 + 1, left + x0 : right + x0 + 2]
        count += n
        ra, rb, raa, rbb, rab = _row_moments(row, upper, lower, w00, w01, w10, w11, mean)
        sa += ra
        sb += rb
        saa += raa
        sbb += rbb
        sab += rab
    return count, sa, sb, saa, sbb, sab


# Python's error model checks every division, which no vector loop can. Places are unsigned: signed ones are looked at
# for being counted from the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _strip_moments(strips, own, other, upper, lower, masks, mask, count, w00, w01, w10, w11):
    """Sums over the masked pixels of one strip and what another shows `upper` and `lower` values farther."""
    one = np.uint64(1)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, m = np.uint64(own), np.uint64(mask)
    sa = sb = saa = sbb = sab = np.float32(0.0)
    for k in range(np.uint64(count)):
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b *= masks[m + k]
        c = masks[m + k] * strips[a + k]
        sa += c
        sb += b
        saa += c * c
        sbb += b * b
        sab += c * b
    return sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _rim_moments(strips, columns, lines, own, other, upper, lower, start, count, ex, ey, qx, qy, low_x, low_y, r2,
                 w00, w01, w10, w11):  # fmt: skip
    """Number of the pixels of one strip that are within the radius in both microimages, and sums over them."""
    one, zero, unit = np.uint64(1), np.float32(0.0), np.float32(1.0)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, first = np.uint64(own), np.uint64(start)
    number = sa = sb = saa = sbb = sab = zero
    for k in range(np.uint64(count)):
        x, y = columns[first + k], lines[first + k]
        own_2, other_2 = (x - ex) * (x - ex) + (y - ey) * (y - ey), (x - qx) * (x - qx) + (y - qy) * (y - qy)
        inside = (max(own_2, other_2) <= r2) & (x >= low_x) & (y >= low_y)
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b, c = b if inside else zero, strips[a + k] if inside else zero
        number += unit if inside else zero
        sa += c
        sb += b
        saa += c * c
        sbb += b * b
        sab += c * b
    return number, sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def shading_decay(shift, pitch):
    """How much less a match at this shift is doubted than one at zero: shading that is left stays with its lens."""
    away = shift / (_SHADED_REACH * pitch)
    return np.exp(-away * away)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def shading_doubt(contrast):
    """How much a match at zero of lenses of this contrast is doubted."""
    return _SHADED * _SHADED / (_SHADED * _SHADED + contrast * contrast)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def match_cost(pixels, variance, residual, apart, floor, half, doubt):
    """Cost of a pair by the sum of the variances of what both show, the variance of the difference, and its mean."""
    offset = _OFFSET_WEIGHT * apart * apart
    quality = (residual + offset + floor) / (variance + offset + floor)
    trust = np.float32(pixels) / (np.float32(pixels) + half) * (np.float32(1.0) - doubt)
    return np.float32(1.0) - trust * (np.float32(1.0) - quality)


# Without fast math of its own: Numba optimises such a body once where it compiles and twice where it loads it, which
# would order its sums differently. Those of the rows keep their order.
@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _pair_costs(
    image, centres, radius, pitch, rows, means, contrast, active, done, shifts, which, noise, shading, row_step, half,
    strips, middle, whole, side, width, size, columns, lines, bunch, slots, masks, ends, counts, fresh, out,
):  # fmt: skip
    reach, length = len(slots) // 2, masks.shape[1]
    enough, one = MIN_OVERLAP * radius * radius, np.float32(1.0)
    pixels, line = strips.reshape(-1), masks.reshape(-1)
    near_zero = np.empty(len(shifts), np.float32)
    for k in range(len(shifts)):
        near_zero[k] = shading_decay(shifts[k], pitch)
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
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
                    dx, dy = int(floor_x) - gap_x, int(floor_y) - gap_y
                    slot = -1
                    if stripped and abs(dx) <= reach and abs(dy) <= reach:
                        slot = slots[dy + reach, dx + reach]
                    if slot >= 0 and counts[slot] * row_step > enough:
                        count = np.float32(counts[slot])
                        start = ends[slot, 0]
                        sa, sb, saa, sbb, sab = _strip_moments(
                            pixels, lens * size + start, other * size + start, ends[slot, 2], ends[slot, 3], line,
                            slot * length + start, ends[slot, 1], (one - fx) * (one - fy), fx * (one - fy),
                            (one - fx) * fy, fx * fy,
                        )  # fmt: skip
                        apart = means[lens] - means[other]
                    elif slot >= 0:
                        first, number = overlap_range(dx, dy, side, width, row_step, bunch)
                        if number <= 0:
                            continue
                        mx, my = np.float32(middle[lens, 0]), np.float32(middle[lens, 1])
                        count, sa, sb, saa, sbb, sab = _rim_moments(
                            pixels, columns, lines, lens * size + first, other * size + first, ends[slot, 2],
                            ends[slot, 3], first, number, ax - mx, ay - my, bx - tx - mx, by - ty - my,
                            np.float32(-side - dx), np.float32(-side - dy), radius * radius,
                            (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy,
                        )  # fmt: skip
                        apart = means[lens] - means[other]
                        if count < 4:
                            continue
                    else:
                        count, sa, sb, saa, sbb, sab = pair_moments(
                            image, ax, ay, bx, by, radius, tx, ty, mean, row_step
                        )
                        apart = np.float32(0.0)
                        if count < 4:
                            continue
                    inverse = one / np.float32(count)
                    ma, mb = sa * inverse, sb * inverse
                    variance = (saa + sbb) * inverse - ma * ma - mb * mb
                    residual = variance - np.float32(2.0) * (sab * inverse - ma * mb)
                    out[lens, d, k] = match_cost(
                        count * row_step, variance, residual, ma - mb + apart, floor, half, doubt * near_zero[k]
                    )


def overlap_masks(
    strips: Strips,
    gray: GrayFlat,
    rows: NDArray[np.int32],
    shifts: NDArray[np.float32],
    about: NDArray[np.float32] | None = None,
) -> OverlapMasks:
    """`make_shift_masks` for the `shifts` tried for all pairs, from what is expected `about` each lens, if
    anything is."""
    return make_shift_masks(strips, gray.radius, _shifts_met(gray, rows, shifts, about))


def _shifts_met(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    shifts: NDArray[np.float32],
    about: NDArray[np.float32] | None,
) -> NDArray[np.int64]:
    """(m, 2) whole pixels `x, y` by which neighbours are shifted against each other, the same for all pairs of a
    direction but for rounding."""
    tried = shifts
    if about is not None and len(about):
        tried = np.arange(about.min() + shifts.min(), about.max() + shifts.max() + 1)
    steps = mean_steps(gray, rows)
    whole = np.floor((tried / np.float32(gray.pitch))[:, None] * steps[:, None]).astype(int)
    return (whole.reshape(-1, 1, 2) + _ROUNDING).reshape(-1, 2)


def mean_steps(gray: GrayFlat, rows: NDArray[np.int32]) -> NDArray[np.float32]:
    """(k, 2) steps `x, y` [px of `gray`] to the neighbours (n, d) in all directions in which there are any."""
    # Rows belong to a lattice, of which there may be pictures of several sizes.
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
        every, seen, count, x, y = max(1, number // _PROBES), 0, 0, 0.0, 0.0
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
    """So many pixels that two microimages share make a match count half."""
    return float(_HALF_TRUST * np.pi * gray.radius**2)


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
    """How badly each lens agrees with its neighbours if the scene had each of some patch sizes.

    The cost is `1 - rho`, the correlation coefficient over the pixels that both microimages show
    at that shift, half-way invariant to a difference of their means, shrunk toward 1 where noise
    or shading explain the contrast or where they share few pixels.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    means, contrast : (n,) float32
        Mean and standard deviation of each lens.
    active : (n,) bool
        Pairs without an active lens are not matched and cost 1.
    shifts : (k,) float32 [px of `gray`]
        Signed patch sizes to try.
    noise : float
        Standard deviation of a pixel.
    shading : float
        Fixed contrast inside every microimage, as a share of its mean.
    row_step : int
        Only every `row_step`-th row of pixels is read.
    which : (m,) int, optional
        The shifts to match; all by default.
    done : (n,) bool, optional
        Lenses all of whose pairs are in `out` already.
    out : (n, d, k) float32, optional
        Costs to be added to; by default all are 1 before.
    strips : Strips, optional
        The microimages of `gray` cut out for this `row_step`; they are by default.
    masks : optional
        `overlap_masks` of these `strips`, for these shifts at least; made by default.

    Returns
    -------
    (n, d, k) float32
    """
    fresh = out is None
    if out is None:
        out = allocate_pooled((len(gray.centres), rows.shape[1], len(shifts)), np.float32)
    which = np.arange(len(shifts)) if which is None else which
    done = np.zeros(len(active), bool) if done is None else done
    half = np.float32(half_weight_area(gray))
    if strips is None:
        strips = extract_strips(gray, means, row_step)
    if masks is None:
        masks = overlap_masks(strips, gray, rows, shifts[which])
    _pair_costs(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), rows, means, contrast, active,
        done, shifts.astype(np.float32), which, np.float32(noise), np.float32(shading), row_step, half,
        strips.values, strips.centre_pixels, strips.complete, strips.half_width, strips.width, strips.size,
        *strips.offsets, VECTOR_LENGTH, *masks, fresh, out,
    )  # fmt: skip
    return out
