"""Kernels of the gain map: light at a place of a lens, and the way from lens to lens along the rows of a flat."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = [
    "ASIDE", "Walk", "cut_table", "describe", "divide", "field_level", "fill", "level_at", "light", "light_of_any",
    "light_of_round", "mean_light", "usable", "walk",
]  # fmt: skip

# Where a lens delivers a smaller share of its light, correction would show noise and stray light: nothing is known.
_LEAST_LIGHT = 0.25
# Numbers that describe one lens before those of its rim: shading (5) and displacement of the cutting disc (2).
_FIXED = 7
# Beyond so many standard deviations from its middle the cut is all or nothing.
_EDGE = 4.0
# So many entries for each of them in a table of the edge of the cut.
_PER_SIGMA = 32
_ROOT_HALF = math.sqrt(0.5)
# Lenses around the flat that rows may begin or end in, and those beside them.
_HALO = 4
# Lenses that lie above or below each other [px] do not follow each other in a row.
ASIDE = 1e-9
# Distortion may turn steps by so much.
_BENT = 0.2
# Rows that are gone through together, and lenses remembered meanwhile: those of a row of lenses and of the next one.
_BLOCK, _SLOTS = 64, 2048
# Lenses above each other are so far apart in that memory; a prime, so that it fills evenly.
_SPREAD = 701
_DIRECTIONS = 32
# Places that share the memory for their monomials.
_TOGETHER = 256
# Sums may be put in another order, but what is not a number stays so.
_FAST = {"contract", "arcp", "nsz", "reassoc"}


@dataclass(frozen=True)
class Walk:
    """What a kernel needs to go from lens to lens along the rows of a flat.

    Parameters
    ----------
    middles : (b, a, 2) float64 [px]
        Centres of all lenses on the flat and some around it, by index.
    own : (b, a) float32
        Light of each over that of the polynomial of the field.
    starts : (h, 2) int64
        Column and row, in these tables, of a lens near to the first pixel of each row of the flat.
    sides : (6, 2) int64
        Steps in these tables to the lenses that can lie beside a lens.
    ahead : (k, 2) int64
        Those to lenses that can follow upon a lens in a row.
    """

    middles: NDArray[np.float64]
    own: NDArray[np.float32]
    starts: NDArray[np.int64]
    sides: NDArray[np.int64]
    ahead: NDArray[np.int64]


def walk(lattice: Lattice, own: NDArray[np.float32]) -> Walk:
    """Tables for going along the rows of a flat; ValueError where `own` is of another number of lenses."""
    width, height = lattice.image_size
    rows = np.arange(height, dtype=np.float64)
    starts = np.rint(lattice.to_index(np.column_stack([np.zeros(height), rows]))).astype(np.int64)
    ends = np.rint(lattice.to_index(np.column_stack([np.full(height, width - 1.0), rows]))).astype(np.int64)
    indices = lattice.indices()
    if len(own) and len(own) != len(indices):
        raise ValueError(f"the gain map is of {len(own)} lenses, the lattice has {len(indices)}")
    # Columns one by one: NumPy takes ten times as long over rows of two.
    every = [np.concatenate([of[:, axis] for of in (starts, ends, indices)]) for axis in (0, 1)]
    low, high = (np.array([end(of) for of in every]) + far for end, far in ((np.min, -_HALO), (np.max, _HALO)))
    index = np.empty((high[1] - low[1] + 1, high[0] - low[0] + 1, 2))
    index[..., 0], index[..., 1] = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)[:, None]
    middles = np.ascontiguousarray(lattice.points(index.reshape(-1, 2)).reshape(index.shape))
    light = np.ones(index.shape[:2], np.float32)
    if len(own):
        light[indices[:, 1] - low[1], indices[:, 0] - low[0]] = own
    # The shorter diagonal: cells have six sides at most.
    cross = min(((1, 1), (1, -1)), key=lambda step: float(np.hypot(*(step @ lattice.basis))))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), cross, (-cross[0], -cross[1])])
    ahead = sides[(sides @ lattice.basis)[:, 0] > -_BENT * lattice.pitch]
    return Walk(middles, light, np.ascontiguousarray(starts - low), sides, ahead)


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def describe(cx, cy, field, radius, shade, rim, cut, powers, lens):
    """Write what the shape of the lens at `(cx, cy)` is, in px, into `lens`; `powers` gets the field's monomials."""
    x, y = (cx - field[0]) / field[2], (cy - field[1]) / field[2]
    _monomials(x, y, max(shade.shape[1], rim.shape[1]), powers)
    # Side by side: one sum after the other would wait for each of its terms.
    u = v = uu = uv = vv = 0.0
    for t in range(shade.shape[1]):
        power = powers[t]
        u += shade[0, t] * power
        v += shade[1, t] * power
        uu += shade[2, t] * power
        uv += shade[3, t] * power
        vv += shade[4, t] * power
    over = 1 / radius
    lens[0], lens[1], lens[2], lens[3], lens[4] = (
        u * over,
        v * over,
        uu * over * over,
        uv * over * over,
        vv * over * over,
    )
    lens[5], lens[6] = cut[0] + cut[2] * x, cut[1] + cut[2] * y
    for row in range(rim.shape[0]):
        total = 0.0
        for t in range(rim.shape[1]):
            total += rim[row, t] * powers[t]
        lens[_FIXED + row] = total / radius


@njit(cache=True, nogil=True, error_model="numpy")
def level_at(cx, cy, field, level, powers):
    """Exponential of a polynomial of the field at one place; `powers` gets the field's monomials."""
    _monomials((cx - field[0]) / field[2], (cy - field[1]) / field[2], len(level), powers)
    total = other = 0.0
    whole = len(level) // 2 * 2
    for t in range(0, whole, 2):
        total += level[t] * powers[t]
        other += level[t + 1] * powers[t + 1]
    if whole < len(level):
        total += level[whole] * powers[whole]
    return math.exp(total + other)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def field_level(centres, field, level, out):
    """Exponential of a polynomial of the field at places (n, 2)."""
    places = centres.shape[0]
    for block in prange((places + _TOGETHER - 1) // _TOGETHER):
        powers = np.empty(64)
        for n in range(block * _TOGETHER, min((block + 1) * _TOGETHER, places)):
            out[n] = level_at(centres[n, 0], centres[n, 1], field, level, powers)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def light(dx, dy, lens, profile, step, cut):
    """Light at `delta` in a described lens over that of its brightest place, distance on the profile, light uncut."""
    r = math.sqrt(dx * dx + dy * dy)
    stretched = r
    count = len(lens) - _FIXED
    if count == 1:
        stretched = r * (1 - lens[_FIXED])
    elif r > 0:
        c, s = dx / r, dy / r
        ck, sk = c, s
        change = lens[_FIXED]
        for k in range(_FIXED + 1, _FIXED + count, 2):
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
        if depth < -_EDGE:
            through = 0.0
        elif depth < _EDGE:
            through = 0.5 * (1 + math.erf(depth * _ROOT_HALF))
        value = cut[5] + (value - cut[5]) * through
    value *= 1 + dx * (lens[0] + lens[2] * dx + lens[3] * dy) + dy * (lens[1] + lens[4] * dy)
    return value, stretched, through


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def light_of_round(pixels, count, lens, profile, rise, scale, shape, ring):
    """`light` of a described round uncut lens at `count` places (2, k) float32, and its `ring` of the profile there.

    `profile` and the `rise` from ring to ring are float32, `scale` is rings per px. Long loops that read and write in
    order become vector instructions; what is looked up in between does not.
    """
    one, most, last = np.float32(1), np.float32(len(rise)), np.int32(len(rise) - 1)
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    for k in range(count):
        shape[k] = min(np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k]) * scale, most)
    for k in range(count):
        here = min(np.int32(shape[k]), last)
        ring[k] = here
        shape[k] = profile[here] + rise[here] * (shape[k] - np.float32(here))
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        shape[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)


@njit(cache=True, nogil=True, error_model="numpy")
def cut_table():
    """Light through the edge of a cutting disc from so many standard deviations outside of it to as many inside."""
    table = np.empty(2 * round(_EDGE) * _PER_SIGMA + 2, np.float32)
    for k in range(len(table)):
        table[k] = 0.5 * (1 + math.erf((k / _PER_SIGMA - _EDGE) * _ROOT_HALF))
    table[0], table[-2], table[-1] = 0.0, 1.0, 1.0
    return table


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def light_of_any(pixels, count, lens, profile, rise, step, cut, table, spare, shape, ring):
    """`light_of_round` of a lens whose rim differs with the direction, or that is cut; `table` is the `cut_table`.

    `spare` (5, k) float32 is room to calculate in.
    """
    one, none, tiny = np.float32(1), np.float32(0), np.float32(1e-6)
    most, last = np.float32(len(rise)), np.int32(len(rise) - 1)
    scale, around = np.float32(1 / step), (len(lens) - _FIXED) // 2
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    even = one - np.float32(lens[_FIXED])
    far, cos, sin, cosine, sine = spare[0], spare[1], spare[2], spare[3], spare[4]
    for k in range(count):
        far[k] = np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k])
        shape[k] = even
    if around > 0:
        for k in range(count):
            over = one / max(far[k], tiny)
            cos[k], sin[k] = pixels[0, k] * over, pixels[1, k] * over
            cosine[k], sine[k] = cos[k], sin[k]
    for m in range(around):
        a, b = np.float32(lens[_FIXED + 1 + 2 * m]), np.float32(lens[_FIXED + 2 + 2 * m])
        for k in range(count):
            shape[k] -= a * cosine[k] + b * sine[k]
        if m + 1 < around:
            for k in range(count):
                turned = cosine[k] * cos[k] - sine[k] * sin[k]
                sine[k] = sine[k] * cos[k] + cosine[k] * sin[k]
                cosine[k] = turned
    for k in range(count):
        shape[k] = min(max(far[k] * shape[k], none) * scale, most)
    for k in range(count):
        here = min(np.int32(shape[k]), last)
        ring[k] = here
        shape[k] = profile[here] + rise[here] * (shape[k] - np.float32(here))
    if cut[4] > 0:
        mx, my, dark = np.float32(lens[5]), np.float32(lens[6]), np.float32(cut[5])
        inside, per = np.float32(cut[3] / cut[4] + _EDGE) * _PER_SIGMA, np.float32(_PER_SIGMA / cut[4])
        end = np.float32(len(table) - 2)
        for k in range(count):
            ex, ey = pixels[0, k] - mx, pixels[1, k] - my
            far[k] = min(max(np.float32(inside) - np.sqrt(ex * ex + ey * ey) * per, none), end)
        for k in range(count):
            here = np.int32(far[k])
            far[k] = table[here] + (table[here + 1] - table[here]) * (far[k] - np.float32(here))
        for k in range(count):
            shape[k] = dark + (shape[k] - dark) * far[k]
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        shape[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)


@njit(cache=True, nogil=True, error_model="numpy")
def _first_lens(y, a, b, middles):
    """Column and row of the lens nearest to the first pixel of row `y`, looked for from `(a, b)` on."""
    while True:
        least = middles[b, a, 0] ** 2 + (middles[b, a, 1] - y) ** 2
        p, q = a, b
        for v in range(max(b - 1, 0), min(b + 2, middles.shape[0])):
            for u in range(max(a - 1, 0), min(a + 2, middles.shape[1])):
                far = middles[v, u, 0] ** 2 + (middles[v, u, 1] - y) ** 2
                if far < least:
                    least, p, q = far, u, v
        if p == a and q == b:
            return a, b
        a, b = p, q


@njit(cache=True, nogil=True, error_model="numpy")
def _next_lens(y, a, b, width, middles, ahead):
    """First pixel of row `y` that is nearer to the next lens than to `(a, b)`, and that lens."""
    if a < 1 or b < 1 or a > middles.shape[1] - 2 or b > middles.shape[0] - 2:
        return width, a, b
    cx, cy = middles[b, a, 0], middles[b, a, 1]
    least, p, q = width - cx, a, b
    for k in range(len(ahead)):
        u, v = a + ahead[k, 0], b + ahead[k, 1]
        dx, dy = middles[v, u, 0] - cx, middles[v, u, 1] - cy
        if dx > ASIDE:
            most = 0.5 * (dx * dx + dy * dy) - dy * (y - cy)
            if most < least * dx:
                least, p, q = most / dx, u, v
    return min(max(math.ceil(cx + least), 0), width), p, q


@njit(cache=True, nogil=True, error_model="numpy")
def _described(a, b, middles, own, level, field, radius, shade, rim, cut, keys, powers, lenses, lens):
    """Light of the lens `(a, b)`; what it is like is written into `lens`, from memory where it is there."""
    slot, key = (a + _SPREAD * b) % _SLOTS, a + b * middles.shape[1]
    if keys[slot] != key:
        keys[slot] = key
        cx, cy = middles[b, a, 0], middles[b, a, 1]
        describe(cx, cy, field, radius, shade, rim, cut, powers, lenses[slot, :-1])
        lenses[slot, -1] = own[b, a] * level_at(cx, cy, field, level, powers)
    # A view of the row would cost more than these few numbers.
    for k in range(len(lens)):
        lens[k] = lenses[slot, k]
    return lenses[slot, -1]


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def fill(out, top, left, middles, own, starts, ahead, level, field, radius, profile, step, shade, rim, cut):
    """Gain of the rows from `top` and columns from `left` on; NaN where too little light is."""
    rows, right = out.shape[0], left + out.shape[1]
    for block in prange((rows + _BLOCK - 1) // _BLOCK):
        keys, powers, lens = np.full(_SLOTS, -1), np.empty(64), np.empty(_FIXED + rim.shape[0])
        lenses = np.empty((_SLOTS, _FIXED + rim.shape[0] + 1))
        for row in range(block * _BLOCK, min((block + 1) * _BLOCK, rows)):
            y = top + row
            a, b = _first_lens(y, starts[y, 0], starts[y, 1], middles)
            x = 0
            while x < right:
                stop, p, q = _next_lens(y, a, b, right, middles, ahead)
                if stop > left:
                    bright = _described(
                        a, b, middles, own, level, field, radius, shade, rim, cut, keys, powers, lenses, lens
                    )
                    cx, cy = middles[b, a, 0], middles[b, a, 1]
                    for at in range(max(x, left), stop):
                        value = light(at - cx, y - cy, lens, profile, step, cut)[0] if bright > 0 else 0.0
                        out[row, at - left] = value * bright if value >= _LEAST_LIGHT else np.nan
                x, a, b = max(x, stop), p, q


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def divide(flat, gain, out, highest):
    """`flat` over `gain` where that is known; rounded and clipped at `highest` where that is above 0."""
    for y in prange(out.shape[0]):
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


@njit(cache=True, nogil=True, error_model="numpy")
def usable(centres, own, limit, out, field, radius, profile, step, shade, rim, cut):
    for n in range(centres.shape[0]):
        if own[n] == 0:
            continue
        powers = np.empty(64)
        lens = np.empty(_FIXED + rim.shape[0])
        describe(centres[n, 0], centres[n, 1], field, radius, shade, rim, cut, powers, lens)
        least = limit
        for d in range(_DIRECTIONS):
            c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
            before, r = light(0.0, 0.0, lens, profile, step, cut)[0], 0.0
            if before < 0.5:
                least = 0.0
            while r < least:
                r += step
                after = light(r * c, r * s, lens, profile, step, cut)[0]
                if after < 0.5:
                    least = min(least, r - step * (0.5 - after) / max(before - after, 1e-9))
                    break
                before = after
        out[n] = least


@njit(cache=True, nogil=True, error_model="numpy")
def mean_light(centres, out, field, radius, profile, step, shade, rim, cut):
    """Light at distances `0, step, ...`, the mean over all directions of each lens; `out` is of shape (n, k)."""
    for n in range(centres.shape[0]):
        powers = np.empty(64)
        lens = np.empty(_FIXED + rim.shape[0])
        describe(centres[n, 0], centres[n, 1], field, radius, shade, rim, cut, powers, lens)
        for k in range(out.shape[1]):
            total = 0.0
            for d in range(_DIRECTIONS):
                c, s = math.cos(2 * math.pi * d / _DIRECTIONS), math.sin(2 * math.pi * d / _DIRECTIONS)
                total += light(k * step * c, k * step * s, lens, profile, step, cut)[0]
            out[n, k] = total / _DIRECTIONS
