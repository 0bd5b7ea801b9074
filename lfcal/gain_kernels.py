"""Kernels of the gain map: light at a place of a lens, and the way from lens to lens along the rows of a flat."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["LEAST_LIGHT", "centre_of", "describe", "fill", "level_of", "light", "nearest", "usable", "walk"]

# Where a lens delivers a smaller share of its light, correction would show noise and stray light: nothing is known.
LEAST_LIGHT = 0.25
# Numbers that describe one lens before those of its rim: shading (5) and displacement of the cutting disc (2).
_FIXED = 7
# Beyond so many standard deviations from its middle the cut is all or nothing.
_EDGE = 4.0
_ROOT_HALF = math.sqrt(0.5)
# Neighbours are asked for where a pixel is so near to the border of a cell, 0.5 being the border itself.
_NEAR_BORDER = 0.46
_DIRECTIONS = 32


def walk(lattice: Lattice, own: NDArray[np.float32]) -> tuple[Any, ...]:
    """What the kernels need to go from lens to lens along the rows of a flat: lattice, steps, light of each lens."""
    bend = np.zeros(6)
    if lattice.distortion is not None:
        d = lattice.distortion
        bend[:5] = (*d.centre, d.k1, d.k2, d.reach)
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    vectors = np.array(steps) @ lattice.basis
    # Pixels this near to their centre, squared, can belong to no other lens.
    bend[5] = (_NEAR_BORDER * np.hypot(*vectors.T).min()) ** 2
    faces = vectors / (vectors**2).sum(1, keepdims=True)
    starts = np.rint(
        lattice.to_index(np.column_stack([np.zeros(lattice.image_size[1]), np.arange(lattice.image_size[1])]))
    )
    indices = lattice.indices()
    if len(own) and len(own) != len(indices):
        raise ValueError(f"the gain map is of {len(own)} lenses, the lattice has {len(indices)}")
    low = indices.min(0) if len(indices) else np.zeros(2, int)
    grid = np.ones((1, 1), np.float32)
    if len(own):
        span = indices.max(0) - low + 1
        grid = np.ones((span[1], span[0]), np.float32)
        grid[indices[:, 1] - low[1], indices[:, 0] - low[0]] = own
    return (
        lattice.origin, lattice.basis, bend, np.array(steps, np.int64), faces, starts.astype(np.int64),
        grid, low.astype(np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def describe(cx, cy, field, shade, rim, cut, powers, lens):
    """Write what the shape of the lens at `(cx, cy)` is into `lens`; `powers` gets the field's monomials."""
    x, y = (cx - field[0]) / field[2], (cy - field[1]) / field[2]
    _monomials(x, y, max(shade.shape[1], rim.shape[1]), powers)
    for row in range(5):
        total = 0.0
        for t in range(shade.shape[1]):
            total += shade[row, t] * powers[t]
        lens[row] = total
    lens[5], lens[6] = cut[0] + cut[2] * x, cut[1] + cut[2] * y
    for row in range(rim.shape[0]):
        total = 0.0
        for t in range(rim.shape[1]):
            total += rim[row, t] * powers[t]
        lens[_FIXED + row] = total


@njit(cache=True, nogil=True)
def light(dx, dy, lens, radius, profile, step, cut):
    """Light at `delta` in a described lens over that of its brightest place, distance on the profile, light uncut."""
    r = math.sqrt(dx * dx + dy * dy)
    stretched = r
    count = len(lens) - _FIXED
    if count == 1:
        stretched = r * (1 - lens[_FIXED] / radius)
    elif r > 0:
        c, s = dx / r, dy / r
        ck, sk = c, s
        change = lens[_FIXED]
        for k in range(_FIXED + 1, _FIXED + count, 2):
            change += lens[k] * ck + lens[k + 1] * sk
            ck, sk = ck * c - sk * s, sk * c + ck * s
        stretched = max(r * (1 - change / radius), 0.0)
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
        if depth < -_EDGE:
            through = 0.0
        elif depth < _EDGE:
            through = 0.5 * (1 + math.erf(depth * _ROOT_HALF))
        value = cut[5] + (value - cut[5]) * through
    u, v = dx / radius, dy / radius
    value *= 1 + lens[0] * u + lens[1] * v + lens[2] * u * u + lens[3] * u * v + lens[4] * v * v
    return value, stretched, through


@njit(cache=True, nogil=True)
def centre_of(i, j, origin, basis, bend):
    """Where the lens of index `(i, j)` lies on the flat."""
    x = origin[0] + i * basis[0, 0] + j * basis[1, 0]
    y = origin[1] + i * basis[0, 1] + j * basis[1, 1]
    if bend[4] > 0:
        ox, oy = x - bend[0], y - bend[1]
        square = (ox * ox + oy * oy) / (bend[4] * bend[4])
        stretch = bend[2] * (square - 0.5) + bend[3] * (square * square - 0.25)
        x += ox * stretch
        y += oy * stretch
    return x, y


@njit(cache=True, nogil=True)
def nearest(x, y, i, j, cx, cy, origin, basis, bend, steps, faces):
    """Index and centre of the lens nearest to a pixel, looked for from lens `(i, j)` on."""
    while True:
        dx, dy = x - cx, y - cy
        least = dx * dx + dy * dy
        if least < bend[5]:
            return i, j, cx, cy
        found = -1
        bx, by = cx, cy
        for k in range(steps.shape[0]):
            if dx * faces[k, 0] + dy * faces[k, 1] > _NEAR_BORDER:
                nx, ny = centre_of(i + steps[k, 0], j + steps[k, 1], origin, basis, bend)
                far = (x - nx) ** 2 + (y - ny) ** 2
                if far < least:
                    least, found, bx, by = far, k, nx, ny
        if found < 0:
            return i, j, cx, cy
        i, j, cx, cy = i + steps[found, 0], j + steps[found, 1], bx, by


@njit(cache=True, nogil=True)
def level_of(i, j, cx, cy, field, level, grid, low, powers):
    """Light of the brightest place of a lens; 0 where the lens is known to have none."""
    a, b = i - low[0], j - low[1]
    own = 1.0
    if 0 <= b < grid.shape[0] and 0 <= a < grid.shape[1]:
        own = grid[b, a]
    if own == 0:
        return 0.0
    _monomials((cx - field[0]) / field[2], (cy - field[1]) / field[2], len(level), powers)
    total = 0.0
    for t in range(len(level)):
        total += level[t] * powers[t]
    return own * math.exp(total)


@njit(cache=True, nogil=True, parallel=True)
def fill(
    flat, out, highest, origin, basis, bend, steps, faces, starts, grid, low, level, field, radius, profile, step,
    shade, rim, cut,
):  # fmt: skip
    height, width, channels = out.shape
    divide = flat.shape[0] > 0
    for y in prange(height):
        powers = np.empty(64)
        lens = np.empty(_FIXED + rim.shape[0])
        i, j = starts[y, 0], starts[y, 1]
        cx, cy = centre_of(i, j, origin, basis, bend)
        fresh, bright = True, 0.0
        for x in range(width):
            ni, nj, cx, cy = nearest(x, y, i, j, cx, cy, origin, basis, bend, steps, faces)
            if fresh or ni != i or nj != j:
                i, j, fresh = ni, nj, False
                describe(cx, cy, field, shade, rim, cut, powers, lens)
                bright = level_of(i, j, cx, cy, field, level, grid, low, powers)
            value = light(x - cx, y - cy, lens, radius, profile, step, cut)[0] if bright > 0 else 0.0
            known = value >= LEAST_LIGHT
            for k in range(channels):
                if not divide:
                    out[y, x, k] = value * bright if known else np.nan
                elif not known:
                    out[y, x, k] = flat[y, x, k]
                else:
                    even = flat[y, x, k] / (value * bright)
                    if highest > 0:
                        even = min(even + 0.5, highest)
                    out[y, x, k] = even


@njit(cache=True, nogil=True, parallel=True)
def usable(centres, own, limit, out, field, radius, profile, step, shade, rim, cut):
    for n in prange(centres.shape[0]):
        if own[n] == 0:
            continue
        powers = np.empty(64)
        lens = np.empty(_FIXED + rim.shape[0])
        describe(centres[n, 0], centres[n, 1], field, shade, rim, cut, powers, lens)
        least = limit
        for d in range(_DIRECTIONS):
            c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
            before, r = light(0.0, 0.0, lens, radius, profile, step, cut)[0], 0.0
            if before < 0.5:
                least = 0.0
            while r < least:
                r += step
                after = light(r * c, r * s, lens, radius, profile, step, cut)[0]
                if after < 0.5:
                    least = min(least, r - step * (0.5 - after) / max(before - after, 1e-9))
                    break
                before = after
        out[n] = least


@njit(cache=True, nogil=True, parallel=True)
def mean_light(centres, out, field, radius, profile, step, shade, rim, cut):
    """Light at distances `0, step, ...`, the mean over all directions of each lens; `out` is of shape (n, k)."""
    for n in prange(centres.shape[0]):
        powers = np.empty(64)
        lens = np.empty(_FIXED + rim.shape[0])
        describe(centres[n, 0], centres[n, 1], field, shade, rim, cut, powers, lens)
        for k in range(out.shape[1]):
            total = 0.0
            for d in range(_DIRECTIONS):
                c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
                total += light(k * step * c, k * step * s, lens, radius, profile, step, cut)[0]
            out[n, k] = total / _DIRECTIONS
