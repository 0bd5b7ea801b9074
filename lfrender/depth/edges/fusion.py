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
# Lenses within this distance of a scene point [pitches], eight or nine, vote for its depth by their
# pixels.
_VOTERS = 1.6
# The nearest lens decides where the others are divided.
_FIRST_WEIGHT = 1.5
# Share of the votes with which a depth is taken although farther ones may have more. Six scenes
# lose 0.05 dB more with 0.45, ten 0.02 dB more with 0.35.
_ENOUGH = 0.4


@njit(error_model="numpy", forceinline=True)
def _central_lenses(lenses, x, y, near):
    """Rows of the lenses about point (x, y), the nearest first; returns how many there are."""
    reach2 = (_VOTERS * lenses.pitch) ** 2
    found = 0
    i, j = nearest_index(x, y, lenses.origin, lenses.inverse, lenses.bend, lenses.bend_low)
    for step in lenses.ring:
        lens = lens_at(lenses.rows, lenses.low, int(i) + step[0], int(j) + step[1])
        if lens < 0:
            continue
        dx = lenses.centres[lens, 0] - x
        dy = lenses.centres[lens, 1] - y
        if dx * dx + dy * dy < reach2:
            near[found] = lens
            found += 1
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
        px = cx - dx
        py = cy - dy
        u = int(px)
        v = int(py)
        if px < 0 or py < 0 or v >= pixels.shape[0] - 1 or u >= pixels.shape[1] - 1:
            continue
        lens_weight = _FIRST_WEIGHT if n == 0 else 1.0
        # The four pixels about the place vote by bilinear interpolation.
        for corner in range(4):
            right = corner & 1
            below = corner >> 1
            shown = pixels[v + below, u + right]
            if np.isnan(shown):
                continue
            weight_x = px - u if right else u + 1 - px
            weight_y = py - v if below else v + 1 - py
            weight = lens_weight * weight_x * weight_y
            voters += weight
            if abs(shown - s) < gap:
                votes += weight
                size += weight * shown
    return (votes / voters, size / votes) if votes > 0 else (0.0, s)


@njit(error_model="numpy", forceinline=True)
def _list_depths(surface, v, first, end, reach, gap, pitch, depths):
    """Depths of the surface within `reach` [grid values] of points `first` to `end` of row v, the
    nearest to the camera first; their number.
    """
    rows, columns = surface.shape
    depths[0] = surface[v, first]
    number = 1
    last = 0
    # Every other value each way: no surface is narrower than these are apart.
    for line in range(max(0, v - reach), min(rows, v + reach + 1), 2):
        for column in range(max(0, first - reach), min(columns, end + reach), 2):
            s = surface[line, column]
            # Most values are those of the last one beside them.
            if abs(depths[last] - s) < gap:
                continue
            last = 0
            while last < number and abs(depths[last] - s) >= gap:
                last += 1
            if last == number and number < _DEPTHS:
                depths[number] = s
                number += 1
            last = min(last, number - 1)
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
    """Fill `out` with the nearest depth that enough of the central lenses show at each scene point,
    else the most frequent.

    `pixels` (H, W) [px] are the patch sizes that the pixels of the microimages show, NaN where none
    was measured. Depths of a point are those of the `surface` within `reach` [grid values]; only
    points that have `several` are filled. Each value of the surface is the middle of f x f points
    of `out`.
    """
    fine = out.shape[0] // surface.shape[0]
    near = np.empty(len(lenses.ring), np.int64)
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
                    # No other depth is both nearer and shown by enough lenses.
                    if share > _ENOUGH:
                        break
