"""The patch size of each scene point, from those that the pixels of the microimages show (depth map
fusion).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...flat.lens_graph import nearest_index
from ..same_surface import depth_order
from ..surface.scene_grid import LensArray, PointGrid, lens_at

__all__ = ["fuse_pixel_depths"]

# Depths of a scene point, at most.
_DEPTHS = 8
# Lenses nearest to a scene point, whose pixels vote for its depth; 5 lose up to 0.1 dB.
_VOTERS = 9


@njit(error_model="numpy", forceinline=True)
def _central_lenses(lenses, x, y, near, distance2):
    """Rows of the lenses nearest to scene point (x, y), the nearest first; returns how many there
    are.
    """
    centres = lenses.centres
    ring = lenses.ring
    found = 0
    most = len(near)
    i, j = nearest_index(x, y, lenses.origin, lenses.inverse, lenses.bend, lenses.bend_low)
    for r in range(len(ring)):
        lens = lens_at(lenses.rows, lenses.low, int(i) + ring[r, 0], int(j) + ring[r, 1])
        if lens < 0:
            continue
        away = (centres[lens, 0] - x) ** 2 + (centres[lens, 1] - y) ** 2
        if found == most and away >= distance2[most - 1]:
            continue
        place = min(found, most - 1)
        while place > 0 and distance2[place - 1] > away:
            near[place], distance2[place] = near[place - 1], distance2[place - 1]
            place -= 1
        near[place], distance2[place] = lens, away
        found = min(found + 1, most)
    return found


@njit(error_model="numpy", forceinline=True)
def _vote(pixels, centres, radius, pitch, gap, near, found, x, y, s):
    """Share of the lenses that show scene point (x, y) at depth `s`, and the mean patch size that
    they show.
    """
    slope = s / pitch
    votes = 0.0
    voters = 0.0
    size = 0.0
    for n in range(found):
        cx = centres[near[n], 0]
        cy = centres[near[n], 1]
        dx = (x - cx) * slope
        dy = (y - cy) * slope
        if dx * dx + dy * dy > radius * radius:
            continue
        u = int(cx - dx + 0.5)
        v = int(cy - dy + 0.5)
        if u < 0 or v < 0 or v >= pixels.shape[0] or u >= pixels.shape[1] or np.isnan(pixels[v, u]):
            continue
        # The nearest lens decides where the others are divided.
        weight = 1.5 if n == 0 else 1.0
        voters += weight
        if abs(pixels[v, u] - s) < gap:
            votes += weight
            size += weight * pixels[v, u]
    return (votes / voters, size / votes) if votes > 0 else (0.0, s)


@njit(error_model="numpy", forceinline=True)
def _list_depths(surface, v, first, end, reach, gap, pitch, depths):
    """Depths of the surface within `reach` [grid values] of points `first` to `end` of row v, the
    nearest to the camera first; their number.
    """
    rows, columns = surface.shape
    depths[0], number = surface[v, first], 1
    for line in range(max(0, v - reach) - 1, min(rows, v + reach + 1)):
        own = line < max(0, v - reach)
        beside = 0 if own else reach
        for column in range(max(0, first - beside), min(columns, end + beside)):
            s = surface[v if own else line, column]
            known = False
            for k in range(number):
                known = known or abs(depths[k] - s) < gap
            if not known and number < _DEPTHS:
                depths[number] = s
                number += 1
    for k in range(1, number):
        s = depths[k]
        at = k
        while at > 0 and depth_order(depths[at - 1], pitch) < depth_order(s, pitch):
            depths[at] = depths[at - 1]
            at -= 1
        depths[at] = s
    return number


@kernel(error_model="numpy", share=lambda pixels, lenses, surface, *_: len(surface))
def fuse_pixel_depths(
    begin, end, pixels, lenses: LensArray, surface, grid: PointGrid, several, reach, out
):
    """Fill `out` with the nearest depth that most of the central lenses show at each scene point,
    else the most frequent.

    `pixels` (H, W) [px] are the patch sizes that the pixels of the microimages show, NaN where none
    was measured. Depths of a point are those of the `surface` within `reach` [grid values]; only
    points that have `several` are filled. Each value of the surface is the middle of f x f points
    of `out`.
    """
    fine = out.shape[0] // surface.shape[0]
    near = np.empty(_VOTERS, np.int64)
    distance2 = np.empty(_VOTERS)
    depths = np.empty(_DEPTHS)
    centres = lenses.centres
    radius = lenses.radius
    pitch = lenses.pitch
    gap = lenses.gap
    for v in range(begin, end):
        number = 0
        listed = 0
        for u in range(surface.shape[1]):
            if not several[v, u]:
                continue
            if u >= listed:
                # Four points of a row share a list of depths.
                listed = min(u + 4, surface.shape[1])
                number = _list_depths(surface, v, u, listed, reach, gap, pitch, depths)
            found = _central_lenses(
                lenses,
                grid.first + u * grid.spacing,
                grid.first + v * grid.spacing,
                near,
                distance2,
            )
            for part in range(fine * fine):
                row = v * fine + part // fine
                column = u * fine + part % fine
                x = grid.first + ((column + 0.5) / fine - 0.5) * grid.spacing
                y = grid.first + ((row + 0.5) / fine - 0.5) * grid.spacing
                best = 0.0
                for k in range(number):
                    share, size = _vote(
                        pixels, centres, radius, pitch, gap, near, found, x, y, depths[k]
                    )
                    if share > best:
                        out[row, column], best = size, share
                    # No other depth is both nearer and shown by most lenses.
                    if share > 0.5:
                        break
