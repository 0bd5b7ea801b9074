"""Surface that each pixel of a microimage shows, by projection with a depth buffer.

The surface is projected only into lenses with a depth edge in sight. All pixels of any other lens
show one surface. Patch sizes of binocular scene points shrink towards the camera, so that a lens sees
a near point from farther away than the point that it occludes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel, square

from ...data.surface import Surface
from ...depth.same_surface import depth_order

__all__ = ["project_surface", "projection_reach"]

# Side of the squares of grid values whose range is computed first.
_SQUARE = 4
# [px] Values cover so much more of a microimage on each side that no pixel between them is missed.
_HALF_PIXEL = np.float32(0.25)
# Scene points are projected into lenses up to so far away [pitch]: all of `|s|` above D / 6 that
# they show.
_FARTHEST = 3.0


class _Lengths(NamedTuple):
    """Lengths of a projection, float32 [px]."""

    pitch: Any
    radius: Any  # of microimages
    reach: Any  # from lenses to scene points that are read from them
    sight: Any  # to those that may occlude them
    edge: Any  # patch sizes that differ by less belong to one surface


class _Lens(NamedTuple):
    """A microimage: centre and radius, float32 [px]."""

    x: Any
    y: Any
    radius: Any


@kernel(error_model="numpy", fastmath=FAST, share=lambda surface, pitch, ranges: ranges.shape[1])
def _compute_ranges(begin, end, surface, pitch, ranges):
    """Least and largest nearness, and least `|s|`, in each square of the surface."""
    rows, columns = surface.shape
    for v in range(begin, end):
        for u in range(ranges.shape[2]):
            low = np.float32(np.inf)
            high = np.float32(-np.inf)
            least = np.float32(np.inf)
            for y in range(v * _SQUARE, min((v + 1) * _SQUARE, rows)):
                for x in range(u * _SQUARE, min((u + 1) * _SQUARE, columns)):
                    near = depth_order(surface[y, x], pitch)
                    low = min(low, near)
                    high = max(high, near)
                    least = min(least, abs(surface[y, x]))
            ranges[0, v, u] = low
            ranges[1, v, u] = high
            ranges[2, v, u] = least


@njit(fastmath=FAST, inline="always")
def _squares_in_reach(centre, first, side, reach, count):
    """The first square within `reach` of a lens along one axis, and the end of them."""
    return max(int((centre - reach - first) / side), 0), min(
        int((centre + reach - first) / side) + 1, count
    )


@njit(fastmath=FAST, inline="always")
def _is_in_sight(u, v, least, x, y, place, lengths):
    """Whether a lens at (x, y) may show some point of square u, v, whose least `|s|` is `least`."""
    half = np.float32(0.5 * _SQUARE) * place[2]
    middle = np.float32(0.5 * (_SQUARE - 1)) * place[2]
    away_x = max(abs(place[0] + u * _SQUARE * place[2] + middle - x) - half, np.float32(0))
    away_y = max(abs(place[1] + v * _SQUARE * place[2] + middle - y) - half, np.float32(0))
    away2 = square(away_x) + square(away_y)
    return square(least) * away2 <= square((lengths.radius + _HALF_PIXEL) * lengths.pitch)


@kernel(error_model="numpy", fastmath=FAST, share=lambda ranges, centres, *_: len(centres))
def _find_edged(begin, end, ranges, centres, place, lengths, corner, farthest, out):
    """Write the nearness of the farthest surface in reach of each lens with a depth edge in sight,
    NaN for other lenses, and set the pixels of the lenses with an edge to NaN in `out`.
    """
    lows, highs, least = ranges
    radius = lengths.radius
    reach = lengths.reach
    sight = lengths.sight
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
        read_u, beyond_u = _squares_in_reach(cx, first_x, side, reach, lows.shape[1])
        read_v, beyond_v = _squares_in_reach(cy, first_y, side, reach, lows.shape[0])
        low_u, end_u = _squares_in_reach(cx, first_x, side, sight, lows.shape[1])
        low_v, end_v = _squares_in_reach(cy, first_y, side, sight, lows.shape[0])
        low = np.float32(np.inf)
        high = np.float32(-np.inf)
        for v in range(low_v, end_v):
            for u in range(low_u, end_u):
                is_read = read_u <= u < beyond_u and read_v <= v < beyond_v
                if highs[v, u] <= high and not (is_read and lows[v, u] < low):
                    continue
                if _is_in_sight(u, v, least[v, u], cx, cy, place, lengths):
                    high = max(high, highs[v, u])
                    low = min(low, lows[v, u]) if is_read else low
        if high - low >= lengths.edge:
            farthest[lens] = low
            out[y - top : end_y - top, x - left : end_x - left] = np.nan


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _paint(s, x, y, half, lens, pitch, corner, out):
    """Set the pixels of a microimage about (x, y), up to `half` away, to `s` unless they show a
    nearer surface.
    """
    left = max(int(np.ceil(x - half)), corner[0])
    right = min(int(np.floor(x + half)) + 1, corner[0] + out.shape[1])
    top = max(int(np.ceil(y - half)), corner[1])
    bottom = min(int(np.floor(y + half)) + 1, corner[1] + out.shape[0])
    for v in range(top, bottom):
        for u in range(left, right):
            if square(u - lens.x) + square(v - lens.y) > lens.radius * lens.radius:
                continue
            shown = out[v - corner[1], u - corner[0]]
            # True for NaN as well: nothing was projected to this pixel yet.
            if not depth_order(shown, pitch) >= depth_order(s, pitch):
                out[v - corner[1], u - corner[0]] = s


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _project_values(surface, place, first, end, size, lens, pitch, farthest, corner, out):
    """Project values of the surface into a microimage, from (u, v) `first` on to the `end`, `size`
    rows and columns at once.
    """
    rows, columns = surface.shape
    first_x, first_y, spacing = place
    beyond = np.float32(0.5) * np.float32(size - 1)
    for v in range(first[1], min(end[1], rows), size):
        for u in range(first[0], min(end[0], columns), size):
            s = surface[min(v + size // 2, rows - 1), min(u + size // 2, columns - 1)]
            if depth_order(s, pitch) <= farthest:
                continue
            tilt = s * (np.float32(1) / pitch)
            dx = -np.float32(first_x + (u + beyond) * spacing - lens.x) * tilt
            dy = -np.float32(first_y + (v + beyond) * spacing - lens.y) * tilt
            # Values cover a square of this size in the microimage.
            half = np.float32(0.5) * abs(tilt) * spacing * size + _HALF_PIXEL
            if dx * dx + dy * dy <= square(lens.radius + np.float32(1.42) * half):
                _paint(s, lens.x + dx, lens.y + dy, half, lens, pitch, corner, out)


@kernel(error_model="numpy", fastmath=FAST, share=lambda *given: len(given[2]))
def _project(begin, end, surface, ranges, centres, place, lengths, corner, farthest, out):
    """Set `out` to the patch size that pixels of lenses with a depth edge in sight see."""
    lows, highs, least = ranges
    for index in range(begin, end):
        if np.isnan(farthest[index]):
            continue
        lens = _Lens(centres[index, 0], centres[index, 1], lengths.radius)
        # The farthest surface occludes nothing.
        far = farthest[index] + lengths.edge
        side = _SQUARE * place[2]
        low_u, end_u = _squares_in_reach(lens.x, place[0], side, lengths.sight, lows.shape[1])
        low_v, end_v = _squares_in_reach(lens.y, place[1], side, lengths.sight, lows.shape[0])
        for v in range(low_v, end_v):
            for u in range(low_u, end_u):
                if highs[v, u] <= far:
                    continue
                if not _is_in_sight(u, v, least[v, u], lens.x, lens.y, place, lengths):
                    continue
                # A square of nearly one depth is projected as a whole.
                whole = highs[v, u] - lows[v, u] < np.float32(0.5) * lengths.edge
                first = (u * _SQUARE, v * _SQUARE)
                last = ((u + 1) * _SQUARE, (v + 1) * _SQUARE)
                size = _SQUARE if whole else 1
                _project_values(
                    surface, place, first, last, size, lens, lengths.pitch, far, corner, out
                )


def projection_reach(lattice: Lattice, reach: float) -> float:
    """Distance [px] from lenses to the scene points that may occlude those within `reach` [px]."""
    return max(reach, _FARTHEST * lattice.pitch)


def project_surface(
    surface: Surface,
    lattice: Lattice,
    reach: float,
    edge: float,
    part: tuple[int, int, int, int] | None = None,
    everywhere: bool = True,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Patch size (H, W) that each pixel of a part of the flat shows, and (n,) bool: lenses with a
    depth edge in sight.

    Pixels on the farthest surface that a lens shows are NaN. Pixels of lenses without an edge are
    NaN too if `everywhere`, else they are not set. Scene points up to `reach` [px] from a lens are
    read from it; patch sizes that differ by less than `edge` [px] belong to one surface.
    """
    left, top, right, bottom = part or (0, 0, *lattice.image_size)
    out = np.empty((bottom - top, right - left), np.float32)
    if everywhere:
        out.fill(np.nan)
    values = surface.patch_size
    farthest = np.empty(len(lattice), np.float32)
    squares = (-(-count // _SQUARE) for count in values.shape)
    ranges = np.empty((3, *squares), np.float32)
    # No two lenses share a pixel, but for rounding of their centres.
    apart = float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min()) / 2 - 0.01
    radius = min(lattice.radius, apart)
    sight = projection_reach(lattice, reach)
    lengths = _Lengths(*map(np.float32, (lattice.pitch, radius, reach, sight, edge)))
    place = tuple(map(np.float32, (*surface.first, surface.spacing)))
    centres = lattice.centres().astype(np.float32)
    corner = (left, top)
    _compute_ranges(values, lengths.pitch, ranges)
    _find_edged(ranges, centres, place, lengths, corner, farthest, out)
    _project(values, ranges, centres, place, lengths, corner, farthest, out)
    return out, ~np.isnan(farthest)
