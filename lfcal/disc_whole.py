"""Least squares of white images whose microimages nothing cuts: the kernel of `disc_model` without the cutting disc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

__all__ = ["OUTLIER", "THINNED", "accumulate_whole", "outside", "rows_within"]

# Residuals beyond so many standard deviations have no say (Tukey's biweight).
OUTLIER = 4.685
# In the even inside of a microimage one pixel in so many, a power of two, is looked at.
THINNED = 4


@njit(cache=True, nogil=True, error_model="numpy")
def outside(dx, dy, faces):
    for face in range(faces.shape[0]):  # noqa: SIM110
        if dx * faces[face, 0] + dy * faces[face, 1] > 0.5:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def rows_within(centre, reach, corner, side):
    """First and last but one row of a window within reach of the centre."""
    return max(int(np.ceil(centre - reach)) - corner, 0), min(int(np.floor(centre + reach)) + 1 - corner, side)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def accumulate_whole(
    light, corners, centres, gain, trust, tilt, faces, inner, reach, step, tables, even, full, chunks, normal, right,
    mixed, band, scatter,
):  # fmt: skip
    """Add up all lenses; `tables` (r, 4) are level, slope, weight and four, `band` (chunks, r, 8) see `disc_model`."""
    lenses, side = light.shape[0], light.shape[1]
    per_step, most = 1 / step, OUTLIER * OUTLIER
    for chunk in prange(chunks):
        own = band[chunk]
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            window, taken = light[lens], mixed[lens, 0]
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
                    rho = math.sqrt(square)
                    place = rho * per_step
                    ring = int(place)
                    w = 1.0
                    if rho > inner and outside(dx, dy, faces):
                        continue
                    if ring < even:
                        if (x + 2 * y) & (THINNED - 1):
                            continue
                        w = float(THINNED)
                    after = place - ring
                    here = 1 - after
                    low, high = tables[ring], tables[ring + 1]
                    over = 1 / max(square, 1e-12)
                    turn = dx * dy * over
                    angle = 1 - 8 * turn * turn
                    model = low[0] * here + high[0] * after + (low[3] * here + high[3] * after) * angle
                    residual = window[y, x] * bright / (1 + tilt_x * dx + tilt_y * dy) - model
                    sure = low[2] * here + high[2] * after
                    chi = residual * residual * sure
                    if window[y, x] >= full and (residual < 0 or chi < 1):
                        continue
                    far += min(chi, limit)
                    number += 1
                    away = chi * belief / most
                    if away >= 1:
                        continue
                    at, beyond = own[ring], own[ring + 1]
                    at[6] += residual * residual * belief
                    at[7] += 1
                    w *= sure * (1 - away) * (1 - away) * belief
                    along = -(low[1] * here + high[1] * after) * rho * over
                    gx, gy = along * dx, along * dy
                    wh, wa, wr = w * here, w * after, w * residual
                    at[0] += wh * here
                    beyond[0] += wa * after
                    at[1] += wh * after
                    at[2] += here * wr
                    beyond[2] += after * wr
                    at[3] += w
                    turned, own_turned = angle * wr, w * angle * angle
                    at[4] += turned * here
                    beyond[4] += turned * after
                    at[5] += own_turned * here
                    beyond[5] += own_turned * after
                    taken[ring] += wh * model
                    taken[ring + 1] += wa * model
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
            n, r = normal[lens], right[lens]
            n[0, 0], n[0, 1], n[1, 1], n[0, 7], n[1, 7], n[7, 7] = xx, xy, yy, xm, ym, mm
            r[0], r[1], r[7] = bx, by, bm
            scatter[lens, 0], scatter[lens, 1] = far, number
