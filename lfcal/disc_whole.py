"""Least squares of white images whose microimages nothing cuts: the kernel of `disc_model` without the cutting disc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from .lens_cell import outside, rows_within

__all__ = ["OUTLIER", "accumulate_whole", "thinned"]

# Residuals beyond so many standard deviations have no say (Tukey's biweight).
OUTLIER = 4.685
# In the even inside of a microimage one pixel in so many, a power of two, is looked at: the largest that leaves enough
# of them. Rows are put aside by the second number, so that the pixels lie evenly.
_THINNED = ((64, 14), (16, 6), (4, 2))
_ENOUGH = 100

# Sums may be put in another order, but what is not a number stays so.
_FAST = {"contract", "arcp", "nsz", "reassoc"}


def thinned(radius: float) -> tuple[int, int]:
    """One pixel in how many is enough in an even disc of this radius [px], and by how many px to put rows aside."""
    return next((pair for pair in _THINNED if np.pi * radius**2 / pair[0] > _ENOUGH), _THINNED[-1])


@njit(cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=_FAST)
def accumulate_whole(
    light, corners, centres, gain, trust, tilt, faces, inner, reach, step, tables, calm, thin, aside, full, chunks,
    normal, right, mixed, band, scatter,
):  # fmt: skip
    """Add up all lenses; `tables` (r, 4) are level, slope, weight and four, `band` (chunks, r, 8) see `disc_model`.

    Up to `calm` px from its centre a microimage is `thinned`.
    """
    lenses, side = light.shape[0], light.shape[1]
    per_step, most = 1 / step, OUTLIER * OUTLIER
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            bright, belief, tilt_x, tilt_y = 1 / gain[lens], trust[lens], tilt[lens, 0], tilt[lens, 1]
            limit = most / belief
            xx = xy = yy = xm = ym = mm = bx = by = bm = far = number = 0.0
            top, bottom = rows_within(cy, reach, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                first, last = rows_within(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
                for x in range(first, last):
                    dx = x - cx
                    square = dx * dx + dy * dy
                    w = 1.0
                    if square < calm * calm:
                        if (x + aside * y) & (thin - 1):
                            continue
                        w = float(thin)
                    rho = math.sqrt(square)
                    if rho > inner and outside(dx, dy, faces):
                        continue
                    place = rho * per_step
                    ring = int(place)
                    after = place - ring
                    here = 1 - after
                    up = ring + 1
                    over = 1 / max(square, 1e-12)
                    turn = dx * dy * over
                    angle = 1 - 8 * turn * turn
                    model = (
                        tables[ring, 0] * here
                        + tables[up, 0] * after
                        + (tables[ring, 3] * here + tables[up, 3] * after) * angle
                    )
                    residual = light[lens, y, x] * bright / (1 + tilt_x * dx + tilt_y * dy) - model
                    sure = tables[ring, 2] * here + tables[up, 2] * after
                    chi = residual * residual * sure
                    if light[lens, y, x] >= full and (residual < 0 or chi < 1):
                        continue
                    far += w * min(chi, limit)
                    number += w
                    away = chi * belief / most
                    if away >= 1:
                        continue
                    band[chunk, ring, 6] += residual * residual * belief
                    band[chunk, ring, 7] += 1
                    w *= sure * (1 - away) * (1 - away) * belief
                    along = -(tables[ring, 1] * here + tables[up, 1] * after) * rho * over
                    gx, gy = along * dx, along * dy
                    wh, wa, wr = w * here, w * after, w * residual
                    band[chunk, ring, 0] += wh * here
                    band[chunk, up, 0] += wa * after
                    band[chunk, ring, 1] += wh * after
                    band[chunk, ring, 2] += here * wr
                    band[chunk, up, 2] += after * wr
                    band[chunk, ring, 3] += w
                    turned, own_turned = angle * wr, w * angle * angle
                    band[chunk, ring, 4] += turned * here
                    band[chunk, up, 4] += turned * after
                    band[chunk, ring, 5] += own_turned * here
                    band[chunk, up, 5] += own_turned * after
                    mixed[lens, 0, ring] += wh * model
                    mixed[lens, 0, up] += wa * model
                    wx, wy, wm = w * gx, w * gy, w * model
                    xx += wx * gx
                    xy += wx * gy
                    yy += wy * gy
                    xm += wx * model
                    ym += wy * model
                    mm += wm * model
                    bx += wx * residual
                    by += wy * residual
                    bm += wm * residual
            normal[lens, 0, 0], normal[lens, 0, 1], normal[lens, 1, 1] = xx, xy, yy
            normal[lens, 0, 7], normal[lens, 1, 7], normal[lens, 7, 7] = xm, ym, mm
            right[lens, 0], right[lens, 1], right[lens, 7] = bx, by, bm
            scatter[lens, 0], scatter[lens, 1] = far, number
