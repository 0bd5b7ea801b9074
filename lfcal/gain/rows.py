"""Gain of all pixels of a region, row by row from lens to lens.

Along a row of pixels the nearest lens changes where the bisector to one of its neighbours is crossed, so no pixel has
to search for its lens.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..runtime.kernels import kernel
from .kernel import RIM_START, evaluate_level, evaluate_shape, relative_light

__all__ = ["RowTables", "fill_gain", "make_row_tables"]


class RowTables(NamedTuple):
    """Tables for going from lens to lens along the rows of a flat.

    Parameters
    ----------
    centres : (b, a, 2) float64 [px]
        Of all lenses on the flat and some around it, by lattice index.
    lens_gain : (b, a) float32
        As in `GainMap`.
    types : (b, a) int8
        Types of the lenses, 0 where they do not differ.
    starts : (h, 2) int64
        Column and row, in these tables, of a lens near the first pixel of each row of the flat.
    ahead : (k, 2) int64
        Steps in these tables to the neighbours of a lens that may follow it in a row.
    """

    centres: NDArray[np.float64]
    lens_gain: NDArray[np.float32]
    types: NDArray[np.int8]
    starts: NDArray[np.int64]
    ahead: NDArray[np.int64]


# Slots of the cache of lenses: enough for a row of them and the next one.
_SLOTS = 2048


def make_row_tables(lattice: Lattice, lens_gain: NDArray[np.float32], type_cell: NDArray[np.int8]) -> RowTables:
    """Tables of a flat; `lens_gain` and `type_cell` as in `GainMap`. ValueError if there are other lenses."""
    width, height = lattice.image_size
    rows = np.arange(height, dtype=np.float64)
    starts = np.rint(lattice.to_index(np.column_stack([np.zeros(height), rows]))).astype(np.int64)
    ends = np.rint(lattice.to_index(np.column_stack([np.full(height, width - 1.0), rows]))).astype(np.int64)
    indices = lattice.indices()
    if len(lens_gain) and len(lens_gain) != len(indices):
        raise ValueError(f"the gain map is of {len(lens_gain)} lenses, the lattice has {len(indices)}")
    # Each column by itself: NumPy takes ten times as long over rows of two.
    every = [np.concatenate([of[:, axis] for of in (starts, ends, indices)]) for axis in (0, 1)]
    # Rows begin and end in lenses around the flat.
    low = np.array([np.min(of) for of in every]) - 4
    high = np.array([np.max(of) for of in every]) + 4
    centres = lattice.grid(*(np.arange(low[axis], high[axis] + 1) for axis in (0, 1)))
    gains = np.ones(centres.shape[:2], np.float32)
    if len(lens_gain):
        gains[indices[:, 1] - low[1], indices[:, 0] - low[0]] = lens_gain
    types = np.zeros(centres.shape[:2], np.int8)
    if type_cell.size:
        i, j = (np.arange(low[axis], high[axis] + 1) % len(type_cell) for axis in (0, 1))
        types[:] = type_cell[i[None, :], j[:, None]]
    # With the shorter diagonal: cells have at most six sides.
    cross = min(((1, 1), (1, -1)), key=lambda step: float(np.hypot(*(step @ lattice.basis))))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), cross, (-cross[0], -cross[1])])
    # A distortion may turn a step a little backwards.
    ahead = sides[(sides @ lattice.basis)[:, 0] > -0.2 * lattice.pitch]
    return RowTables(centres, gains, types, np.ascontiguousarray(starts - low), ahead)


@njit(error_model="numpy")
def _find_first_lens(y, a, b, centres):
    """Column and row of the lens nearest to the first pixel of row `y`, by descent from lens `(a, b)`."""
    while True:
        least = centres[b, a, 0] ** 2 + (centres[b, a, 1] - y) ** 2
        p, q = a, b
        for v in range(max(b - 1, 0), min(b + 2, centres.shape[0])):
            for u in range(max(a - 1, 0), min(a + 2, centres.shape[1])):
                far = centres[v, u, 0] ** 2 + (centres[v, u, 1] - y) ** 2
                if far < least:
                    least, p, q = far, u, v
        if p == a and q == b:
            return a, b
        a, b = p, q


@njit(error_model="numpy")
def _find_next_lens(y, a, b, width, centres, ahead):
    """First pixel of row `y` that is nearer to the next lens than to `(a, b)`, and column and row of that lens."""
    if a < 1 or b < 1 or a > centres.shape[1] - 2 or b > centres.shape[0] - 2:
        return width, a, b
    cx, cy = centres[b, a, 0], centres[b, a, 1]
    least, p, q = width - cx, a, b
    for k in range(len(ahead)):
        u, v = a + ahead[k, 0], b + ahead[k, 1]
        dx, dy = centres[v, u, 0] - cx, centres[v, u, 1] - cy
        # Lenses above each other do not follow each other in a row.
        if dx > 1e-9:
            most = 0.5 * (dx * dx + dy * dy) - dy * (y - cy)
            if most < least * dx:
                least, p, q = most / dx, u, v
    return min(max(math.ceil(cx + least), 0), width), p, q


@njit(error_model="numpy")
def _load_lens(a, b, tables, level, shape, keys, powers, lenses, lens):
    """Light of the lens `(a, b)`; its description is written into `lens`, from the cache `keys`, `lenses` if there."""
    centres = tables.centres
    # Lenses above each other are a prime number of slots apart, so that the cache fills evenly.
    slot, key = (a + 701 * b) % _SLOTS, a + b * centres.shape[1]
    if keys[slot] != key:
        keys[slot] = key
        cx, cy = centres[b, a, 0], centres[b, a, 1]
        evaluate_shape(cx, cy, shape, powers, lenses[slot, :-1])
        lenses[slot, -1] = tables.lens_gain[b, a] * evaluate_level(cx, cy, shape.frame, level, powers)
    # Copied: a view of the row would cost more than these few numbers.
    for k in range(len(lens)):
        lens[k] = lenses[slot, k]
    return lenses[slot, -1]


@kernel(error_model="numpy", share=lambda out, *_: len(out))
def fill_gain(begin, end, out, top, left, least, tables, level, shape, profiles):
    """Write the gain of the rows from `top` and the columns from `left` on into `out`; NaN where there is less than
    `least` of the light of a lens; `profiles` (t, k) are those of the types of lenses."""
    size = RIM_START + shape.rim.shape[0]
    keys, powers, lens, lenses = np.full(_SLOTS, -1), np.empty(64), np.empty(size), np.empty((_SLOTS, size + 1))
    right = left + out.shape[1]
    centres, starts, ahead, types = tables.centres, tables.starts, tables.ahead, tables.types
    step, cut = shape.step, shape.cut
    for row in range(begin, end):
        y = top + row
        a, b = _find_first_lens(y, starts[y, 0], starts[y, 1], centres)
        x = 0
        while x < right:
            stop, p, q = _find_next_lens(y, a, b, right, centres, ahead)
            if stop > left:
                bright = _load_lens(a, b, tables, level, shape, keys, powers, lenses, lens)
                cx, cy = centres[b, a, 0], centres[b, a, 1]
                profile = profiles[types[b, a]]
                for at in range(max(x, left), stop):
                    value = relative_light(at - cx, y - cy, lens, profile, step, cut)[0] if bright > 0 else 0.0
                    out[row, at - left] = value * bright if value >= least else np.nan
            x, a, b = max(x, stop), p, q
