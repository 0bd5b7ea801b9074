"""The way from lens to lens along the rows of a flat, and the gain of all its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from .kernel import LEAST_LIGHT, RIM_START, evaluate_level, evaluate_shape, relative_light

__all__ = ["ASIDE", "Walk", "fill", "walk"]

# Lenses around the flat that rows may begin or end in, and those beside them.
_HALO = 4
#: Lenses that lie above or below each other [px] do not follow each other in a row.
ASIDE = 1e-9
# Distortion may turn steps by so much.
_BENT = 0.2
# Rows that are gone through together, and lenses remembered meanwhile: those of a row of lenses and of the next one.
_BLOCK, _SLOTS = 64, 2048
# Lenses above each other are so far apart in that memory; a prime, so that it fills evenly.
_SPREAD = 701


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
    lens_gain: NDArray[np.float32]
    starts: NDArray[np.int64]
    sides: NDArray[np.int64]
    ahead: NDArray[np.int64]


def walk(lattice: Lattice, own: NDArray[np.float32]) -> Walk:
    """Tables for going along the rows of a flat; ValueError where `lens_gain` is of another number of lenses."""
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
    middles = lattice.grid(*(np.arange(low[axis], high[axis] + 1) for axis in (0, 1)))
    relative_light = np.ones(middles.shape[:2], np.float32)
    if len(own):
        relative_light[indices[:, 1] - low[1], indices[:, 0] - low[0]] = own
    # The shorter diagonal: cells have six sides at most.
    cross = min(((1, 1), (1, -1)), key=lambda step: float(np.hypot(*(step @ lattice.basis))))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), cross, (-cross[0], -cross[1])])
    ahead = sides[(sides @ lattice.basis)[:, 0] > -_BENT * lattice.pitch]
    return Walk(middles, relative_light, np.ascontiguousarray(starts - low), sides, ahead)


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
        evaluate_shape(cx, cy, field, radius, shade, rim, cut, powers, lenses[slot, :-1])
        lenses[slot, -1] = own[b, a] * evaluate_level(cx, cy, field, level, powers)
    # A view of the row would cost more than these few numbers.
    for k in range(len(lens)):
        lens[k] = lenses[slot, k]
    return lenses[slot, -1]


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def fill(out, top, left, middles, own, starts, ahead, level, field, radius, profile, step, shade, rim, cut):
    """Gain of the rows from `top` and columns from `left` on; NaN where too little light is."""
    rows, right = out.shape[0], left + out.shape[1]
    for block in prange((rows + _BLOCK - 1) // _BLOCK):
        keys, powers, lens = np.full(_SLOTS, -1), np.empty(64), np.empty(RIM_START + rim.shape[0])
        lenses = np.empty((_SLOTS, RIM_START + rim.shape[0] + 1))
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
                        value = relative_light(at - cx, y - cy, lens, profile, step, cut)[0] if bright > 0 else 0.0
                        out[row, at - left] = value * bright if value >= LEAST_LIGHT else np.nan
                x, a, b = max(x, stop), p, q
