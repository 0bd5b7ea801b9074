"""Model of whole microimages, and the normal equations of all lenses about it.

A pixel at `delta` from the centre of its lens has the light `gain * (1 + slope @ delta) *
(profile(|delta|) + own(|delta|) * shade @ delta)`: `slope` is that of the light over the field,
`shade` that of the light of a lens by itself. At the border of its cell half of the light is that
of a neighbour, which is shaded the other way: only the light above it, `own`, counts. Outliers are
weighted down by Tukey's biweight. Square pixels blur an edge along their sides unlike across their
corners, and apertures may be square: the profile has a fourth harmonic of the direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from ..lattice.cell import is_outside_cell
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..runtime.arrays import Floats, Integers, Singles
from ..runtime.kernels import FAST, kernel

__all__ = ["Rings", "Windows", "add_lenses"]

_MOST = TUKEY_CUTOFF * TUKEY_CUTOFF


class Windows(NamedTuple):
    """Squares of a flat around `n` lenses, and what is known of each lens."""

    light: Singles  # (n, k, k)
    corners: Integers  # (n, 2) [px] flat coordinates of the first pixel of each square
    centres: Floats  # (n, 2) [px]
    gain: Floats  # (n,) light of the lens over that of the profile
    slope: Floats  # (n, 2) [1/px]
    shade: Floats  # (n, 2) [1/px]


class Rings(NamedTuple):
    """What all lenses share, at distances `0, step, 2*step, ...` from their centres."""

    step: float  # [px]
    # (r, 5) light, its slope [1/px], inverse variance of a pixel, own light, amplitude of `cos(4 *
    # direction)`
    table: Floats
    saturation: float  # least light of clipped pixels


@njit(error_model="numpy", fastmath=False)
def _clip_rows(centre, reach, side):
    """First and last row (excluded) of a window of `side` rows within `reach` of `centre`."""
    return max(math.ceil(centre - reach), 0), min(math.floor(centre + reach) + 1, side)


@kernel(error_model="numpy", share=lambda windows, cell, rings, sums: len(sums.band), fastmath=FAST)
def add_lenses(begin, end, windows, cell, rings, sums):
    """Add up the pixels in the cells of all lenses; a chunk of them goes into each band."""
    light, corners, centres, gains, slope, shade = windows
    normals, inradius, reach = cell
    step, table, saturation = rings
    normal, right, bands = sums
    count = light.shape[0]
    side = light.shape[1]
    chunks = bands.shape[0]
    per_step = 1 / step
    for chunk in range(begin, end):
        band = bands[chunk]
        for lens in range(chunk * count // chunks, (chunk + 1) * count // chunks):
            cx = centres[lens, 0] - corners[lens, 0]
            cy = centres[lens, 1] - corners[lens, 1]
            per_gain = 1 / gains[lens]
            slope_x = slope[lens, 0]
            slope_y = slope[lens, 1]
            shade_x = shade[lens, 0]
            shade_y = shade[lens, 1]
            xx = xy = yy = xm = ym = mm = bx = by = bm = 0.0
            top, bottom = _clip_rows(cy, reach, side)
            for y in range(top, bottom):
                dy = y - cy
                first, last = _clip_rows(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), side)
                for x in range(first, last):
                    dx = x - cx
                    square = max(dx * dx + dy * dy, 1e-12)
                    if square > inradius * inradius and is_outside_cell(dx, dy, normals):
                        continue
                    far = math.sqrt(square)
                    place = far * per_step
                    ring = int(place)
                    after = place - ring
                    here = 1 - after
                    up = ring + 1
                    own = table[ring, 3] * here + table[up, 3] * after
                    angle = 1 - 8 * (dx * dy / square) * (dx * dy / square)
                    level = table[ring, 0] * here + table[up, 0] * after
                    level += (table[ring, 4] * here + table[up, 4] * after) * angle
                    model = level + own * (shade_x * dx + shade_y * dy)
                    residual = (
                        light[lens, y, x] * per_gain / (1 + slope_x * dx + slope_y * dy) - model
                    )
                    weight = table[ring, 2] * here + table[up, 2] * after
                    chi = residual * residual * weight
                    # A clipped pixel counts only where the model is clearly darker than it is.
                    if chi >= _MOST or (
                        light[lens, y, x] >= saturation and (residual < 0 or chi < 1)
                    ):
                        continue
                    weight *= (1 - chi / _MOST) * (1 - chi / _MOST)
                    nearest = int(place + 0.5)
                    band[nearest, 0] += weight
                    band[nearest, 1] += weight * residual
                    band[nearest, 2] += weight * residual * angle
                    band[nearest, 3] += weight * angle * angle
                    band[nearest, 4] += residual * residual
                    band[nearest, 5] += 1
                    along = -(table[ring, 1] * here + table[up, 1] * after) / far
                    gx = along * dx
                    gy = along * dy
                    wx = weight * gx
                    wy = weight * gy
                    wr = weight * residual
                    xx += wx * gx
                    xy += wx * gy
                    yy += wy * gy
                    xm += wx * model
                    ym += wy * model
                    mm += weight * model * model
                    bx += gx * wr
                    by += gy * wr
                    bm += model * wr
            normal[lens, 0, 0], normal[lens, 0, 1], normal[lens, 1, 1] = xx, xy, yy
            normal[lens, 0, 2], normal[lens, 1, 2], normal[lens, 2, 2] = xm, ym, mm
            right[lens, 0], right[lens, 1], right[lens, 2] = bx, by, bm
