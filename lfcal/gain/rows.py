"""Gain of all pixels of a region, row by row from lens to lens.

Along a row of pixels the nearest lens changes where the bisector to one of its neighbours is
crossed, so no pixel has to search for its lens.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..lattice.cell import nearest_lenses
from ..lattice.lattice import Lattice
from ..runtime.arrays import Array, Booleans, Floats, Integers, Singles
from ..runtime.kernels import kernel
from .gain_map import GainMap
from .kernel import flatten_rows, relative_light

__all__ = ["RegionGain"]

# Rows that are made even together, so that memory does not grow with the flat.
_BAND = 512
# [pitch] A distortion may turn a step to a lens ahead backwards by this.
_BACKWARDS = 0.2


class RegionGain:
    """Gain of rectangular regions of a flat; its tables are made once for all of them.

    Parameters
    ----------
    gain_map : GainMap
    lattice : Lattice
    """

    def __init__(self, gain_map: GainMap, lattice: Lattice) -> None:
        self._model = _make_row_tables(lattice, gain_map), gain_map.shape, gain_map.profiles

    def at(
        self, left: int, top: int, width: int, height: int, least_light: float = 0.25
    ) -> Singles:
        """Gain (height, width) of the region whose first pixel is `left, top`.

        It is NaN below `least_light` of the light of the lens, where noise and stray light
        dominate.
        """
        out = np.empty((height, width), np.float32)
        _fill_gain(out, top, left, least_light, *self._model)
        return out

    def flatten(self, pixels: Array, left: int = 0, top: int = 0) -> tuple[Array, Booleans]:
        """Divide a region of a flat by its gain.

        Parameters
        ----------
        pixels : (h, w) or (h, w, c) unsigned integers or floats
        left, top : int [px]
            Flat coordinates of the first pixel.

        Returns
        -------
        even : array of the shape and type of `pixels`
            As in `Calibration.flatten`.
        unknown : (h, w) bool
            Pixels of unknown gain, which keep their values.
        """
        deep = pixels.reshape(*pixels.shape[:2], -1)
        out = np.empty_like(deep)
        unknown = np.empty(deep.shape[:2], np.bool_)
        highest = 0.0
        if pixels.dtype.kind in "ui":
            highest = float(np.iinfo(pixels.dtype).max)
        # In bands of rows, so that memory does not grow with the flat.
        for first in range(0, len(deep), _BAND):
            rows = slice(first, first + _BAND)
            gain = self.at(left, top + first, deep.shape[1], len(deep[rows]))
            flatten_rows(deep[rows], gain, out[rows], highest)
            np.isnan(gain, out=unknown[rows])
        return out.reshape(pixels.shape), unknown


class _RowTables(NamedTuple):
    """Tables for going from lens to lens along the rows of a flat."""

    centres: Floats  # (b, a, 2) [px] of all lenses on the flat and some around it, by lattice index
    light: Floats  # (b, a) of each lens
    lenses: Singles  # (b, a, s) their descriptions
    types: NDArray[np.int8]  # (b, a) 0 where they do not differ
    # (h, 2) column and row, here, of the lens nearest to the first pixel of each row of the flat
    starts: Integers
    ahead: Integers  # (k, 2) steps, here, to the neighbours of a lens that may follow it in a row


def _make_row_tables(lattice: Lattice, gain: GainMap) -> _RowTables:
    """Tables of a flat. ValueError if the gain map is of other lenses."""
    width, height = lattice.image_size
    indices = lattice.indices()
    if len(gain.lens_gain) not in (0, len(indices)):
        raise ValueError(
            f"the gain map is of {len(gain.lens_gain)} lenses, the lattice has {len(indices)}"
        )
    starts, ends = (
        nearest_lenses(lattice, np.column_stack([np.full(height, column), np.arange(height)]))
        for column in (0, width - 1)
    )
    # Rows begin and end in lenses around the flat.
    every = [np.concatenate([of[:, axis] for of in (starts, ends, indices)]) for axis in (0, 1)]
    low = np.array([of.min() for of in every]) - 4
    high = np.array([of.max() for of in every]) + 4
    i, j = (np.arange(low[axis], high[axis] + 1) for axis in (0, 1))
    centres = lattice.points(np.stack(np.meshgrid(i, j), -1))
    points = centres.reshape(-1, 2)
    field = lattice.field_place(points)
    light = gain.light(field).reshape(centres.shape[:2])
    if len(gain.lens_gain):
        light[indices[:, 1] - low[1], indices[:, 0] - low[0]] *= gain.lens_gain
    types = np.zeros(light.shape, np.int8)
    cell = gain.type_cell
    if cell.size:
        types[:] = cell[i[None, :] % len(cell), j[:, None] % len(cell)]
    # With the shorter diagonal: cells have at most six sides.
    cross = min(((1, 1), (1, -1)), key=lambda step: float(np.hypot(*(step @ lattice.basis))))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), cross, (-cross[0], -cross[1])])
    ahead = sides[(sides @ lattice.basis)[:, 0] > -_BACKWARDS * lattice.pitch]
    lenses = gain.describe(field).astype(np.float32).reshape(*light.shape, -1)
    return _RowTables(centres, light, lenses, types, np.ascontiguousarray(starts - low), ahead)


@njit(error_model="numpy")
def _find_next_lens(y, a, b, width, centres, ahead):
    """First pixel of row `y` that is nearer to the next lens than to lens `(a, b)`.

    Also returns the indices of the next lens.
    """
    if a < 1 or b < 1 or a > centres.shape[1] - 2 or b > centres.shape[0] - 2:
        return width, a, b
    cx = centres[b, a, 0]
    cy = centres[b, a, 1]
    least = width - cx
    p = a
    q = b
    for k in range(len(ahead)):
        u = a + ahead[k, 0]
        v = b + ahead[k, 1]
        dx = centres[v, u, 0] - cx
        dy = centres[v, u, 1] - cy
        # Lenses above each other do not follow each other in a row.
        if dx > 1e-9:
            most = 0.5 * (dx * dx + dy * dy) - dy * (y - cy)
            if most < least * dx:
                least = most / dx
                p = u
                q = v
    return min(max(math.ceil(cx + least), 0), width), p, q


@kernel(error_model="numpy", share=lambda out, *_: len(out))
def _fill_gain(begin, end, out, top, left, least, tables, shape, profiles):
    """Write the gain of the rows from `top` and the columns from `left` on into `out`.

    Pixels with less than `least` of the light of their lens become NaN. `profiles` (t, k) are those
    of the lens types.
    """
    lens = np.empty(tables.lenses.shape[2])
    right = left + out.shape[1]
    centres = tables.centres
    ahead = tables.ahead
    step = shape.step
    cut = shape.cut
    for row in range(begin, end):
        y = top + row
        a, b = tables.starts[y]
        x = 0
        while x < right:
            stop, p, q = _find_next_lens(y, a, b, right, centres, ahead)
            if stop > left:
                # Copied: a view of the row would cost more than these few numbers.
                for k in range(len(lens)):
                    lens[k] = tables.lenses[b, a, k]
                light = tables.light[b, a]
                cx = centres[b, a, 0]
                cy = centres[b, a, 1]
                profile = profiles[tables.types[b, a]]
                for at in range(max(x, left), stop):
                    value = (
                        relative_light(at - cx, y - cy, lens, profile, step, cut)[0]
                        if light > 0
                        else 0.0
                    )
                    out[row, at - left] = value * light if value >= least else np.nan
            x = max(x, stop)
            a = p
            b = q
