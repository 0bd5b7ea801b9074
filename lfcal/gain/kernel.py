"""Gain model of one lens: the relative light at a place in it (kernels).

A lens is described by an array: factors of `u, v, u^2, uv, v^2` of its shading [1/px, 1/px^2],
displacement x, y of its cutting disc [px], then the harmonics of its rim [share of the radius] from
`RIM_START` on; `GainMap.describe` makes it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from ..runtime.arrays import Floats
from ..runtime.kernels import kernel

__all__ = ["RIM_START", "Shape", "evaluate_light", "flatten_rows", "relative_light"]

RIM_START = 7


class Shape(NamedTuple):
    """What the microimages of a flat have in common."""

    profile: Floats  # (k,)
    step: float  # [px]
    cut: Floats  # (6,) `GainMap.cut`, 0 if there is no cutting disc, and `GainMap.stray_light`


@njit(error_model="numpy", inline="always")
def relative_light(dx, dy, lens, profile, step, cut):
    """Relative light at `(dx, dy)` [px] from the centre of a lens.

    Also returns the distance on the profile [px] and the share that is not cut off.
    """
    r = math.sqrt(dx * dx + dy * dy)
    stretched = r
    count = len(lens) - RIM_START
    if count == 1:
        stretched = r * (1 - lens[RIM_START])
    elif r > 0:
        c = dx / r
        s = dy / r
        ck = c
        sk = s
        change = lens[RIM_START]
        for k in range(RIM_START + 1, RIM_START + count, 2):
            change += lens[k] * ck + lens[k + 1] * sk
            ck, sk = ck * c - sk * s, sk * c + ck * s
        stretched = max(r * (1 - change), 0.0)
    place = stretched / step
    ring = int(place)
    if ring >= len(profile) - 1:
        value = profile[-1]
    else:
        part = place - ring
        value = profile[ring] * (1 - part) + profile[ring + 1] * part
    through = 1.0
    if cut[4] > 0:
        ex = dx - lens[5]
        ey = dy - lens[6]
        depth = (cut[3] - math.sqrt(ex * ex + ey * ey)) / cut[4]
        # Beyond four standard deviations the edge is all or nothing.
        if depth < -4:
            through = 0.0
        elif depth < 4:
            through = 0.5 * (1 + math.erf(depth * math.sqrt(0.5)))
        value = cut[5] + (value - cut[5]) * through
    value *= 1 + dx * (lens[0] + lens[2] * dx + lens[3] * dy) + dy * (lens[1] + lens[4] * dy)
    return value, stretched, through


@kernel(error_model="numpy", share=lambda lens, *_: len(lens))
def evaluate_light(begin, end, lens, dx, dy, lenses, shape, out):
    """Write `relative_light` at places (p,) in lenses into `out` (3, p).

    `lens` (p,) are rows of `lenses` (n, s).
    """
    profile = shape.profile
    step = shape.step
    cut = shape.cut
    for p in range(begin, end):
        out[0, p], out[1, p], out[2, p] = relative_light(
            dx[p], dy[p], lenses[lens[p]], profile, step, cut
        )


@kernel(error_model="numpy", share=lambda flat, gain, out, *_: len(out))
def flatten_rows(begin, end, flat, gain, out, highest):
    """Divide `flat` (h, w, c) by `gain` (h, w) where the gain is not NaN.

    Values are rounded and clipped at `highest` if that is above 0.
    """
    for y in range(begin, end):
        for x in range(out.shape[1]):
            g = gain[y, x]
            for k in range(out.shape[2]):
                if g != g:
                    out[y, x, k] = flat[y, x, k]
                else:
                    even = flat[y, x, k] / g
                    if highest > 0:
                        even = min(even + 0.5, highest)
                    out[y, x, k] = even
