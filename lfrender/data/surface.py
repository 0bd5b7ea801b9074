"""The depth of every scene point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

__all__ = ["Surface", "mark_changed_places", "patch_size_at"]

# Side of the squares of grid values of which it is known whether any differ.
_SQUARE = 4


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def patch_size_at(surface, x, y, grid_x, grid_y, cell, edge):
    """Patch size at scene point (x, y): linear between grid values, nearest across a depth edge."""
    rows, columns = surface.shape
    gx = min(max((x - grid_x) / cell, np.float32(0.0)), np.float32(columns - 1))
    gy = min(max((y - grid_y) / cell, np.float32(0.0)), np.float32(rows - 1))
    i, j = min(int(gx), max(columns - 2, 0)), min(int(gy), max(rows - 2, 0))
    i1, j1 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    fx, fy = gx - i, gy - j
    a, b, c, d = surface[j, i], surface[j, i1], surface[j1, i], surface[j1, i1]
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < edge:
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    return surface[j1 if fy > 0.5 else j, i1 if fx > 0.5 else i]


@njit(cache=True, nogil=True, parallel=True)
def _nearest(values, first_x, first_y, spacing, points, out):
    rows, columns = values.shape
    for k in prange(len(out)):
        u, v = np.rint((points[k, 0] - first_x) / spacing), np.rint((points[k, 1] - first_y) / spacing)
        out[k] = values[min(max(int(v), 0), rows - 1), min(max(int(u), 0), columns - 1)]


@njit(cache=True, nogil=True)
def _differ(old, new, top, bottom, left, right):
    """Whether any of the values of some rows and columns are not the same."""
    for v in range(top, bottom):
        for u in range(left, right):
            if old[v, u] != new[v, u]:
                return True
    return False


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _mark_changes(old, new, first_x, first_y, spacing, centres, reach, changed):
    """Set `changed` of lenses with a value within `reach` that differs between two surfaces."""
    rows, columns = new.shape
    # Which squares of values hold any that differ: where none about a lens does, nobody looks at their values.
    down, across = (rows + _SQUARE - 1) // _SQUARE, (columns + _SQUARE - 1) // _SQUARE
    some = np.empty((down, across), np.bool_)
    for j in prange(down):
        for i in range(across):
            v, u = j * _SQUARE, i * _SQUARE
            some[j, i] = _differ(old, new, v, min(v + _SQUARE, rows), u, min(u + _SQUARE, columns))
    for lens in prange(len(centres)):
        if changed[lens]:
            continue
        x, y = (centres[lens, 0] - first_x) / spacing, (centres[lens, 1] - first_y) / spacing
        side = reach / spacing
        top, bottom = max(0, int(np.ceil(y - side))), min(rows, int(np.floor(y + side)) + 1)
        left, right = max(0, int(np.ceil(x - side))), min(columns, int(np.floor(x + side)) + 1)
        for j in range(top // _SQUARE, (bottom + _SQUARE - 1) // _SQUARE):
            for i in range(left // _SQUARE, (right + _SQUARE - 1) // _SQUARE):
                if some[j, i] and not changed[lens]:
                    v, u = j * _SQUARE, i * _SQUARE
                    changed[lens] = _differ(
                        old, new, max(v, top), min(v + _SQUARE, bottom), max(u, left), min(u + _SQUARE, right)
                    )  # fmt: skip


@dataclass(frozen=True)
class Surface:
    """Signed patch size on a regular grid of scene points.

    Parameters
    ----------
    patch_size : (h, w) float32 [px]
        Finite everywhere.
    first : (float, float) [px]
        Scene coordinates of grid value `[0, 0]`, order `x, y`.
    spacing : float [px]
        Distance between grid values in scene coordinates.
    """

    patch_size: NDArray[np.float32]
    first: tuple[float, float]
    spacing: float

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n,) float32 [px]: patch size of the grid value nearest to scene points (n, 2)."""
        out = np.empty(len(points), np.float32)
        _nearest(self.patch_size, *self.first, self.spacing, points, out)
        return out


def mark_changed_places(
    before: Surface, after: Surface, places: NDArray[np.floating], reach: float, changed: NDArray[np.bool_]
) -> None:
    """Set `changed` (n,) where a grid value within `reach` [px] to each side of `places` (n, 2) is another one.

    The grids are the same.
    """
    _mark_changes(before.patch_size, after.patch_size, *after.first, after.spacing, places, reach, changed)
