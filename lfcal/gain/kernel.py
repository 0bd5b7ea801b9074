"""Gain model of one lens: the coefficients of its shape, and the relative light at a place in it (kernels).

A lens is described by an array: factors of `u, v, u^2, uv, v^2` of its shading [1/px, 1/px^2], displacement x, y of its
cutting disc [px], then the harmonics of its rim [share of the radius] from `RIM_START` on.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..runtime.kernels import kernel

__all__ = [
    "RIM_START", "evaluate_level", "evaluate_levels", "evaluate_shape", "find_usable_radius",
    "flatten_rows", "radial_mean", "relative_light",
]  # fmt: skip

RIM_START = 7
_ROOT_HALF = math.sqrt(0.5)
# In which the usable radius and the mean over directions are evaluated.
_DIRECTIONS = 32


@njit(error_model="numpy", fastmath=False)
def _monomials(x, y, count, out):
    """1, x, y, x^2, x*y, y^2 ...: each degree is the one before times x, and its last term times y."""
    out[0] = 1.0
    before, done, degree = 0, 1, 1
    while done < count:
        start = done
        for k in range(degree):
            out[done + k] = out[before + k] * x
        out[done + degree] = out[start - 1] * y
        done += degree + 1
        before = start
        degree += 1


@njit(error_model="numpy", fastmath=False)
def evaluate_shape(cx, cy, shape, powers, lens):
    """Write the description of the lens at `(cx, cy)` into `lens`; `powers` gets the monomials of the field."""
    field, radius, shading, rim, cut = shape.frame, shape.radius, shape.shading, shape.rim, shape.cut
    x, y = (cx - field[0]) / field[2], (cy - field[1]) / field[2]
    _monomials(x, y, max(shading.shape[1], rim.shape[1]), powers)
    for row in range(5):
        total = 0.0
        for t in range(shading.shape[1]):
            total += shading[row, t] * powers[t]
        lens[row] = total / (radius if row < 2 else radius * radius)
    lens[5], lens[6] = cut[0] + cut[2] * x, cut[1] + cut[2] * y
    for row in range(rim.shape[0]):
        total = 0.0
        for t in range(rim.shape[1]):
            total += rim[row, t] * powers[t]
        lens[RIM_START + row] = total / radius


@njit(error_model="numpy")
def evaluate_level(cx, cy, field, level, powers):
    """Exponential of a polynomial of the field at one place; `powers` gets the monomials of the field."""
    _monomials((cx - field[0]) / field[2], (cy - field[1]) / field[2], len(level), powers)
    total = 0.0
    for t in range(len(level)):
        total += level[t] * powers[t]
    return math.exp(total)


@kernel(error_model="numpy", share=lambda centres, *_: len(centres))
def evaluate_levels(begin, end, centres, field, level, out):
    """`evaluate_level` at places (n, 2)."""
    powers = np.empty(64)
    for n in range(begin, end):
        out[n] = evaluate_level(centres[n, 0], centres[n, 1], field, level, powers)


@njit(error_model="numpy", inline="always")
def relative_light(dx, dy, lens, profile, step, cut):
    """Relative light at `(dx, dy)` [px] from the centre of a lens, distance on the profile [px], share not cut off."""
    r = math.sqrt(dx * dx + dy * dy)
    stretched = r
    count = len(lens) - RIM_START
    if count == 1:
        stretched = r * (1 - lens[RIM_START])
    elif r > 0:
        c, s = dx / r, dy / r
        ck, sk = c, s
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
        ex, ey = dx - lens[5], dy - lens[6]
        depth = (cut[3] - math.sqrt(ex * ex + ey * ey)) / cut[4]
        # Beyond four standard deviations the edge is all or nothing.
        if depth < -4:
            through = 0.0
        elif depth < 4:
            through = 0.5 * (1 + math.erf(depth * _ROOT_HALF))
        value = cut[5] + (value - cut[5]) * through
    value *= 1 + dx * (lens[0] + lens[2] * dx + lens[3] * dy) + dy * (lens[1] + lens[4] * dy)
    return value, stretched, through


@kernel(error_model="numpy", share=lambda flat, gain, out, *_: len(out))
def flatten_rows(begin, end, flat, gain, out, highest):
    """`flat` (h, w, c) divided by `gain` (h, w) where that is not NaN; rounded and clipped at `highest` if above 0."""
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


@kernel(error_model="numpy")
def find_usable_radius(centres, lens_gain, limit, out, shape):
    """Least distance [px] over all directions at which the light of each lens falls below one half, up to `limit`."""
    profile, step, cut = shape.profile, shape.step, shape.cut
    for n in range(centres.shape[0]):
        if lens_gain[n] == 0:
            continue
        powers = np.empty(64)
        lens = np.empty(RIM_START + shape.rim.shape[0])
        evaluate_shape(centres[n, 0], centres[n, 1], shape, powers, lens)
        least = limit
        for d in range(_DIRECTIONS):
            c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
            before, r = relative_light(0.0, 0.0, lens, profile, step, cut)[0], 0.0
            if before < 0.5:
                least = 0.0
            while r < least:
                r += step
                after = relative_light(r * c, r * s, lens, profile, step, cut)[0]
                if after < 0.5:
                    least = min(least, r - step * (0.5 - after) / max(before - after, 1e-9))
                    break
                before = after
        out[n] = least


@kernel(error_model="numpy")
def radial_mean(centres, out, shape):
    """Relative light at distances `0, step, ...`, averaged over all directions of each lens; `out` is (n, k)."""
    profile, step, cut = shape.profile, shape.step, shape.cut
    for n in range(centres.shape[0]):
        powers = np.empty(64)
        lens = np.empty(RIM_START + shape.rim.shape[0])
        evaluate_shape(centres[n, 0], centres[n, 1], shape, powers, lens)
        for k in range(out.shape[1]):
            total = 0.0
            for d in range(_DIRECTIONS):
                c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
                total += relative_light(k * step * c, k * step * s, lens, profile, step, cut)[0]
            out[n, k] = total / _DIRECTIONS
