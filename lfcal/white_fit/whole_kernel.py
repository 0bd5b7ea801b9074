"""Least squares of white images whose microimages nothing cuts: the kernel of `disc_model` without the cutting disc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.cell import clip_rows, is_outside_cell
from ..runtime.fastmath import FAST

__all__ = ["OUTLIER", "accumulate_whole", "by_ring", "thinned"]

# Residuals beyond so many standard deviations have no say (Tukey's biweight).
OUTLIER = 4.685
# In the even inside of a microimage one pixel in so many, a power of two, is looked at: the largest that leaves enough
# of them. Rows are put aside by the second number, so that the pixels lie evenly.
_THINNED = ((64, 14), (16, 6), (4, 2))
_ENOUGH = 100


def thinned(radius: float) -> tuple[int, int]:
    """One pixel in how many is enough in an even disc of this radius [px], and by how many px to put rows aside."""
    return next((pair for pair in _THINNED if np.pi * radius**2 / pair[0] > _ENOUGH), _THINNED[-1])


@njit(cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=FAST)
def accumulate_whole(
    light, corners, centres, gain, trust, tilt, faces, inner, reach, step, tables, calm, thin, aside, full, chunks,
    learn, normal, right, mixed, band, scatter,
):  # fmt: skip
    """Add up all lenses; `tables` (r, 4) are level, slope, weight and four, `band` (chunks, r, 11) see `by_ring`.

    Of each lens there are `x`, `y` and gain, in this order. Up to `calm` px from its centre a microimage is `thinned`.
    What the profile asks for, `band` and `mixed`, is added up only to `learn` it.
    """
    lenses, side = light.shape[0], light.shape[1]
    per_step, most = 1 / step, OUTLIER * OUTLIER
    per_most, even, within = 1 / most, calm * calm, inner * inner
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            bright, belief, tilt_x, tilt_y = 1 / gain[lens], trust[lens], tilt[lens, 0], tilt[lens, 1]
            limit = most / belief
            xx = xy = yy = xm = ym = mm = bx = by = bm = far = number = 0.0
            top, bottom = clip_rows(cy, reach, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                first, last = clip_rows(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
                for x in range(first, last):
                    dx = x - cx
                    square = max(dx * dx + dy * dy, 1e-12)
                    w = 1.0
                    if square < even:
                        if (x + aside * y) & (thin - 1):
                            continue
                        w = float(thin)
                    elif square > within and is_outside_cell(dx, dy, faces):
                        continue
                    # Divisions take longer than all the rest.
                    over = 1 / math.sqrt(square)
                    place = square * over * per_step
                    ring = int(place)
                    after = place - ring
                    here = 1 - after
                    up = ring + 1
                    turn = dx * dy * over * over
                    angle = 1 - 8 * turn * turn
                    model = (
                        tables[ring, 0] * here
                        + tables[up, 0] * after
                        + (tables[ring, 3] * here + tables[up, 3] * after) * angle
                    )
                    lean = tilt_x * dx + tilt_y * dy
                    upright = 1 - lean + lean * lean
                    upright *= 2 - (1 + lean) * upright
                    upright *= 2 - (1 + lean) * upright
                    residual = light[lens, y, x] * bright * upright - model
                    sure = tables[ring, 2] * here + tables[up, 2] * after
                    chi = residual * residual * sure
                    if light[lens, y, x] >= full and (residual < 0 or chi < 1):
                        continue
                    far += w * min(chi, limit)
                    number += w
                    away = chi * belief * per_most
                    if away >= 1:
                        continue
                    w *= sure * (1 - away) * (1 - away) * belief
                    along = -(tables[ring, 1] * here + tables[up, 1] * after) * over
                    gx, gy = along * dx, along * dy
                    wx, wy, wm, wr = w * gx, w * gy, w * model, w * residual
                    if learn:
                        wa, turned = w * after, angle * wr
                        band[chunk, ring, 0] += w
                        band[chunk, ring, 1] += wa
                        band[chunk, ring, 2] += wa * after
                        band[chunk, ring, 3] += wr
                        band[chunk, ring, 4] += wr * after
                        band[chunk, ring, 5] += turned
                        band[chunk, ring, 6] += turned * after
                        own = w * angle * angle
                        band[chunk, ring, 7] += own
                        band[chunk, ring, 8] += own * after
                        band[chunk, ring, 9] += residual * residual * belief
                        band[chunk, ring, 10] += 1
                        mixed[lens, 0, ring] += wm * here
                        mixed[lens, 0, up] += wm * after
                    xx += wx * gx
                    xy += wx * gy
                    yy += wy * gy
                    xm += wx * model
                    ym += wy * model
                    mm += wm * model
                    bx += gx * wr
                    by += gy * wr
                    bm += model * wr
            normal[lens, 0, 0], normal[lens, 0, 1], normal[lens, 1, 1] = xx, xy, yy
            normal[lens, 0, 2], normal[lens, 1, 2], normal[lens, 2, 2] = xm, ym, mm
            right[lens, 0], right[lens, 1], right[lens, 2] = bx, by, bm
            scatter[lens, 0], scatter[lens, 1] = far, number


def by_ring(band: NDArray[np.float64]) -> NDArray[np.float64]:
    """What `accumulate_whole` has added up between rings, for each ring.

    Parameters
    ----------
    band : (r, 11) float64
        By the ring below each pixel, which it is `after` of the way to the next one beyond: sums of `w`, `w * after`,
        `w * after**2`; of the weighted residual, and that times `after`; of the same two times `angle`, which is
        `cos(4 * direction)`; of `w * angle**2`, and that times `after`; of squared residuals; number of pixels.

    Returns
    -------
    (r, 8) float64
        Own weight, weight shared with the next ring, force, weight of all, force and weight of the fourth harmonic,
        sum of squares, number of pixels.
    """
    w, wa, waa, force, force_up, turned, turned_up, own, own_up, squares, count = band.T

    def beyond(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([[0.0], values[:-1]])

    return np.column_stack([
        w - 2 * wa + waa + beyond(waa), wa - waa, force - force_up + beyond(force_up), w,
        turned - turned_up + beyond(turned_up), own - own_up + beyond(own_up), squares, count,
    ])  # fmt: skip
