"""Surface that each pixel of a microimage shows, by projection with a depth buffer.

The surface is projected only into lenses with a depth edge in reach. All pixels of any other lens
show one surface.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel, square

from ...data.surface import Surface

__all__ = ["project_surface"]

# Side of the squares of grid values whose range is computed first.
_SQUARE = 4


@kernel(error_model="numpy", fastmath=FAST, share=lambda surface, pitch, lows, highs: len(lows))
def _compute_ranges(begin, end, surface, pitch, lows, highs):
    """Least and largest nearness in each square of the surface: `s` before the microlenses, `s + 2
    D` behind them.
    """
    rows, columns = surface.shape
    for v in range(begin, end):
        for u in range(lows.shape[1]):
            low = np.float32(np.inf)
            high = np.float32(-np.inf)
            for y in range(v * _SQUARE, min((v + 1) * _SQUARE, rows)):
                for x in range(u * _SQUARE, min((u + 1) * _SQUARE, columns)):
                    near = surface[y, x] if surface[y, x] > 0 else surface[y, x] + 2 * pitch
                    low = min(low, near)
                    high = max(high, near)
            lows[v, u], highs[v, u] = low, high


@njit(fastmath=FAST, inline="always")
def _squares_in_reach(centre, first, side, reach, count):
    """The first square within `reach` of a lens along one axis, and the end of them."""
    return max(int((centre - reach - first) / side), 0), min(
        int((centre + reach - first) / side) + 1, count
    )


@kernel(
    error_model="numpy", fastmath=FAST, share=lambda lows, highs, place, centres, *_: len(centres)
)
def _find_edged(
    begin, end, lows, highs, place, centres, radius, reach, edge, corner, farthest, out
):
    """Write the nearness of the farthest surface in reach of each lens with a depth edge there, NaN
    for other lenses, and set the pixels of the lenses with an edge to NaN in `out`.
    """
    first_x = place[0]
    first_y = place[1]
    side = _SQUARE * place[2]
    left = corner[0]
    top = corner[1]
    right = corner[0] + out.shape[1]
    bottom = corner[1] + out.shape[0]
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        farthest[lens] = np.nan
        # Pixels next to the microimage are read too.
        x = max(int(cx - radius) - 1, left)
        end_x = min(int(cx + radius) + 3, right)
        y = max(int(cy - radius) - 1, top)
        end_y = min(int(cy + radius) + 3, bottom)
        if x >= end_x or y >= end_y:
            continue
        low_u, end_u = _squares_in_reach(cx, first_x, side, reach, lows.shape[1])
        low_v, end_v = _squares_in_reach(cy, first_y, side, reach, lows.shape[0])
        low = np.float32(np.inf)
        high = np.float32(-np.inf)
        for v in range(low_v, end_v):
            for u in range(low_u, end_u):
                low = min(low, lows[v, u])
                high = max(high, highs[v, u])
        if high - low >= edge:
            farthest[lens] = low
            out[y - top : end_y - top, x - left : end_x - left] = np.nan


@kernel(error_model="numpy", fastmath=FAST, share=lambda *given: len(given[4]))
def _project(
    begin,
    end,
    surface,
    lows,
    highs,
    place,
    centres,
    radius,
    pitch,
    reach,
    edge,
    corner,
    farthest,
    out,
):
    """Set `out` to the patch size that pixels of lenses with a depth edge in reach see."""
    rows, columns = surface.shape
    first_x, first_y, spacing = place
    left = corner[0]
    top = corner[1]
    right = corner[0] + out.shape[1]
    bottom = corner[1] + out.shape[0]
    half_pixel = np.float32(0.25)
    per_pitch = np.float32(1.0) / pitch
    side = _SQUARE * spacing
    for lens in range(begin, end):
        if np.isnan(farthest[lens]):
            continue
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        beyond_far = farthest[lens] + edge
        low_u, end_u = _squares_in_reach(cx, first_x, side, reach, lows.shape[1])
        low_v, end_v = _squares_in_reach(cy, first_y, side, reach, lows.shape[0])
        for square_v in range(low_v, end_v):
            for square_u in range(low_u, end_u):
                # The farthest surface occludes nothing.
                if highs[square_v, square_u] <= beyond_far:
                    continue
                # A square of nearly one depth is projected as a whole.
                whole = (
                    highs[square_v, square_u] - lows[square_v, square_u] < np.float32(0.5) * edge
                )
                size = _SQUARE if whole else 1
                beyond = np.float32(0.5) * np.float32(size - 1)
                for v in range(square_v * _SQUARE, min((square_v + 1) * _SQUARE, rows), size):
                    for u in range(
                        square_u * _SQUARE, min((square_u + 1) * _SQUARE, columns), size
                    ):
                        s = surface[min(v + size // 2, rows - 1), min(u + size // 2, columns - 1)]
                        near = s if s > 0 else s + 2 * pitch
                        if near <= beyond_far:
                            continue
                        tilt = s * per_pitch
                        dx = -np.float32(first_x + (u + beyond) * spacing - cx) * tilt
                        dy = -np.float32(first_y + (v + beyond) * spacing - cy) * tilt
                        # What is projected covers a square of this size in the microimage.
                        half = np.float32(0.5) * abs(tilt) * spacing * size + half_pixel
                        if dx * dx + dy * dy > square(radius + np.float32(1.42) * half):
                            continue
                        low_y = max(int(np.ceil(cy + dy - half)), top)
                        end_y = int(np.floor(cy + dy + half)) + 1
                        low_x = max(int(np.ceil(cx + dx - half)), left)
                        end_x = int(np.floor(cx + dx + half)) + 1
                        for y in range(low_y, min(end_y, bottom)):
                            for x in range(low_x, min(end_x, right)):
                                if square(x - cx) + square(y - cy) > radius * radius:
                                    continue
                                shown = out[y - top, x - left]
                                # True for NaN as well: nothing was projected to this pixel yet.
                                if not (shown if shown > 0 else shown + 2 * pitch) >= near:
                                    out[y - top, x - left] = s


def project_surface(
    surface: Surface,
    lattice: Lattice,
    reach: float,
    edge: float,
    part: tuple[int, int, int, int] | None = None,
    everywhere: bool = True,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Patch size (H, W) that each pixel of a part of the flat shows, and (n,) bool: lenses with a
    depth edge in reach.

    Pixels on the farthest surface that a lens shows are NaN. Pixels of lenses without an edge are
    NaN too if `everywhere`, else they are not set. Scene points up to `reach` [px] from a lens are
    projected; patch sizes that differ by less than `edge` [px] belong to one surface.
    """
    left, top, right, bottom = part or (0, 0, *lattice.image_size)
    out = np.empty((bottom - top, right - left), np.float32)
    if everywhere:
        out.fill(np.nan)
    values = surface.patch_size
    farthest = np.empty(len(lattice), np.float32)
    lows, highs = np.empty(
        (2, -(-values.shape[0] // _SQUARE), -(-values.shape[1] // _SQUARE)), np.float32
    )
    # No two lenses share a pixel, but for rounding of their centres.
    apart = float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min()) / 2 - 0.01
    radius, reach, step, pitch = np.array(
        [min(lattice.radius, apart), reach, edge, lattice.pitch], np.float32
    )
    place = np.float32(surface.first[0]), np.float32(surface.first[1]), np.float32(surface.spacing)
    _compute_ranges(values, pitch, lows, highs)
    centres = lattice.centres().astype(np.float32)
    _find_edged(lows, highs, place, centres, radius, reach, step, (left, top), farthest, out)
    _project(
        values, lows, highs, place, centres, radius, pitch, reach, step, (left, top), farthest, out
    )
    return out, ~np.isnan(farthest)
