"""The patch size that every pixel of a microimage shows, among those that the surface has nearby.

Each pixel is compared with the pixels that other lenses would show it at (multi-view stereo with the microimage as the
reference view), and semi-global matching (Hirschmueller 2008) inside the microimage regularises the choice. In the
first round the better part of the views counts, since some are occluded; in the second round, those views that
the first one finds occluded are left out (view selection, Schoenberger et al. 2016).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from lfcal.runtime.kernels.jit import njit

from ..surface.occlusion import depth_order
from .geometry import LensArray, PointGrid, level_of, value_at

__all__ = ["PixelCosts", "measure_pixel_depths"]

# Patch sizes of a lens, and other lenses that a pixel is compared with, at most.
_DEPTHS = 16
_VIEWS = 10
_BINS = 512
# [pitch] smallest patch size: beyond, a microimage spans more lenses than are looked at.
_LEAST = 0.02
# Mismatch of a pixel that no other lens shows; price of each lens that is missing to a few. Set by hand.
_UNSEEN = 0.6
_FEW_COST = 0.05
_FEW = 3


class PixelCosts(NamedTuple):
    """Values of `EdgeSettings` for the kernels, in squared units where they are compared with squares."""

    foreign: Any
    absent: Any
    noise2: Any
    contrast: Any
    colour2: Any
    open_share: Any
    occluded_share: Any
    jump: Any
    edge_share: Any
    edge2: Any
    slant: Any
    reach: Any  # [px]


@njit(cache=True, nogil=True)
def _list_depths(surface, first, spacing, x, y, lenses, reach, depths):
    """Patch sizes of the surface that the lens at (x, y) may show, in `depths`; returns how many there are."""
    rows, columns = surface.shape
    count, total = np.zeros(_BINS), np.zeros(_BINS)
    width, span = 0.25 * lenses.gap, int(3.5 * lenses.pitch / spacing)
    at_u, at_v = int((x - first) / spacing + 0.5), int((y - first) / spacing + 0.5)
    for v in range(max(0, at_v - span), min(rows, at_v + span + 1)):
        for u in range(max(0, at_u - span), min(columns, at_u + span + 1)):
            s = surface[v, u]
            away = np.hypot(first + u * spacing - x, first + v * spacing - y)
            if away <= reach + lenses.radius * lenses.pitch / max(abs(s), 1e-3):
                place = min(max(int(s / width + _BINS // 2), 0), _BINS - 1)
                count[place] += 1
                total[place] += s
    found = place = 0
    while place < _BINS and found < _DEPTHS:
        end, number, amount = place, 0.0, 0.0
        while end < _BINS and count[end] > 0 and end - place < 6:
            number, amount, end = number + count[end], amount + total[end], end + 1
        if number >= 2:
            depths[found] = amount / number
            found += 1
        place = max(end, place + 1)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _mismatch(image, lenses, lens, x, y, s, patch, weight, total, allowed, before, share, costs):
    """Mismatch of a pixel, whose 3 x 3 `patch` is given, with the `share` of the other lenses that fit it best at
    depth `s`, where it shows scene point (x, y); lenses that show a nearer depth `before` do not count."""
    centres, rows, low, ring = lenses.centres, lenses.rows, lenses.low, lenses.ring
    slope, count, radius = s / lenses.pitch, 0, lenses.radius
    at_i, at_j = lenses.indices[lens, 0] - low[0], lenses.indices[lens, 1] - low[1]
    height, width = image.shape[:2]
    for r in range(1, len(ring)):
        ci, cj = at_i + ring[r, 0], at_j + ring[r, 1]
        if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1]:
            continue
        other = rows[cj, ci]
        if other < 0:
            continue
        dx, dy = (x - centres[other, 0]) * slope, (y - centres[other, 1]) * slope
        if dx * dx + dy * dy > radius * radius:
            continue
        px, py = centres[other, 0] - dx, centres[other, 1] - dy
        if before.size > 1:
            u, v = int(px + 0.5), int(py + 0.5)
            if u < 0 or v < 0 or v >= before.shape[0] or u >= before.shape[1]:
                continue
            if depth_order(before[v, u], lenses.pitch) > depth_order(s, lenses.pitch) + lenses.gap:
                continue
        i, j = int(px), int(py)
        if i < 1 or j < 1 or i >= width - 2 or j >= height - 2:
            continue
        fx, fy = np.float32(px - i), np.float32(py - j)
        w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
        squares = np.float32(0.0)
        for e in range(9):
            v, u = j + e // 3 - 1, i + e % 3 - 1
            apart2 = np.float32(0.0)
            for channel in range(3):
                apart = w00 * image[v, u, channel] + w01 * image[v, u + 1, channel]
                apart += w10 * image[v + 1, u, channel] + w11 * image[v + 1, u + 1, channel] - patch[e * 3 + channel]
                apart2 += apart * apart
            squares += weight[e] * apart2
        squares /= total
        costs[count] = squares / (squares + allowed)
        count += 1
        if count == _VIEWS:
            break
    if count == 0:
        return _UNSEEN
    number = max(1, int(share * count + 0.5))
    best = np.sort(costs[:count])
    return best[:number].mean() + _FEW_COST * max(0, _FEW - count)


@njit(cache=True, nogil=True)
def _aggregate_line(cost, value, inside, image, left, top, number, lenses, c, v, u, down, across, total):
    """Add one path of semi-global matching, from pixel (u, v) on, to `total`."""
    size = len(inside)
    previous, current = np.zeros(number), np.zeros(number)
    lowest, linked, from_v, from_u = 0.0, False, 0, 0
    while 0 <= v < size and 0 <= u < size:
        if inside[v, u]:
            jump = c.jump
            if linked:
                apart = 0.0
                for channel in range(3):
                    apart += (image[top + v, left + u, channel] - image[top + from_v, left + from_u, channel]) ** 2
                jump = c.jump * (c.edge_share + (1 - c.edge_share) * np.exp(-apart / c.edge2))
            least = np.inf
            for k in range(number):
                best = jump if linked else 0.0
                if linked:
                    # Depths ascend: others than those beside it are a jump away.
                    for q in range(max(0, k - 1), min(number, k + 2)):
                        step = abs(value[v, u, k] - value[from_v, from_u, q]) / lenses.gap
                        price = min(jump, c.slant * step) if step < 1.5 else jump
                        best = min(best, previous[q] - lowest + price)
                current[k] = cost[v, u, k] + best
                total[v, u, k] += current[k]
                least = min(least, current[k])
            lowest = least
            previous[:] = current
            linked, from_v, from_u = True, v, u
        else:
            linked = False
        v, u = v + down, u + across


@njit(cache=True, nogil=True)
def _aggregate(cost, value, inside, image, left, top, number, lenses, c, total):
    """Semi-global matching along eight directions inside a microimage."""
    size = len(inside)
    for down in range(-1, 2):
        for across in range(-1, 2):
            if down == 0 and across == 0:
                continue
            for start in range(size):
                if down != 0:
                    v = 0 if down > 0 else size - 1
                    _aggregate_line(cost, value, inside, image, left, top, number, lenses, c, v, start, down, across,
                                    total)  # fmt: skip
                if across != 0 and not (down != 0 and start == (0 if down > 0 else size - 1)):
                    u = 0 if across > 0 else size - 1
                    _aggregate_line(cost, value, inside, image, left, top, number, lenses, c, start, u, down, across,
                                    total)  # fmt: skip


@njit(cache=True, nogil=True)
def _measure_lens(lens, image, lenses, surface, grid, levels, before, c, out):
    """Fill `out` with the patch sizes of the pixels of one lens."""
    first, spacing, pitch, radius = grid.first, grid.spacing, lenses.pitch, lenses.radius
    x, y = lenses.centres[lens, 0], lenses.centres[lens, 1]
    half = int(radius) + 1
    size, left, top = 2 * half + 1, int(x + 0.5) - half, int(y + 0.5) - half
    depths = np.empty(_DEPTHS)
    number = _list_depths(surface, first, spacing, x, y, lenses, c.reach, depths)
    cost, value = np.zeros((size, size, _DEPTHS), np.float32), np.zeros((size, size, _DEPTHS), np.float32)
    inside = np.zeros((size, size), np.bool_)
    patch, weight = np.empty(27, np.float32), np.empty(9, np.float32)
    costs = np.empty(_VIEWS)
    present, place = np.zeros(_DEPTHS, np.bool_), np.empty((_DEPTHS, 2))
    nearest = 0
    for k in range(1, number):
        if depth_order(depths[k], pitch) > depth_order(depths[nearest], pitch):
            nearest = k
    for row in range(size):
        for column in range(size):
            px, py = left + column, top + row
            dx, dy = px - x, py - y
            if dx * dx + dy * dy > radius * radius:
                continue
            if px < 1 or py < 1 or px >= image.shape[1] - 1 or py >= image.shape[0] - 1:
                continue
            inside[row, column] = True
            if number < 2:
                s = depths[0] if number else value_at(surface, first, spacing, x, y)
                if abs(s) > _LEAST * pitch:
                    s = value_at(surface, first, spacing, x - dx * pitch / s, y - dy * pitch / s)
                out[py, px] = s
                continue
            total, contrast = 0.0, 0.0
            for e in range(9):
                apart = 0.0
                for channel in range(3):
                    patch[e * 3 + channel] = image[py + e // 3 - 1, px + e % 3 - 1, channel]
                    apart += (patch[e * 3 + channel] - image[py, px, channel]) ** 2
                weight[e] = np.exp(-apart / (2 * c.colour2))
                total += weight[e]
            for channel in range(3):
                mean, squares = 0.0, 0.0
                for e in range(9):
                    mean += weight[e] * patch[e * 3 + channel]
                    squares += weight[e] * patch[e * 3 + channel] ** 2
                contrast += squares / total - (mean / total) ** 2
            allowed = c.contrast * contrast + c.noise2
            for k in range(number):
                s = depths[k]
                if abs(s) < _LEAST * pitch:
                    s = _LEAST * pitch if s > 0 else -_LEAST * pitch
                at_x, at_y = x - dx * pitch / s, y - dy * pitch / s
                here = value_at(surface, first, spacing, at_x, at_y)
                own = abs(here - s) < lenses.gap
                if own:
                    s = here
                    at_x, at_y = x - dx * pitch / s, y - dy * pitch / s
                value[row, column, k] = s
                bit = np.uint64(level_of(s, pitch))
                present[k] = own or (value_at(levels, first, spacing, at_x, at_y) >> bit) & np.uint64(1) != 0
                place[k, 0], place[k, 1] = at_x, at_y
                cost[row, column, k] = 0.0 if own else c.foreign
            alone = present[:number].sum() < 2
            for k in range(number):
                share = c.open_share if k == nearest or before.size > 1 else c.occluded_share
                if not present[k]:
                    cost[row, column, k] = c.absent
                elif not alone:
                    cost[row, column, k] += _mismatch(
                        image, lenses, lens, place[k, 0], place[k, 1], value[row, column, k], patch, weight, total,
                        allowed, before, share, costs,
                    )  # fmt: skip
    if number < 2:
        return
    aggregated = np.zeros((size, size, number), np.float32)
    _aggregate(cost, value, inside, image, left, top, number, lenses, c, aggregated)
    for row in range(size):
        for column in range(size):
            if inside[row, column]:
                out[top + row, left + column] = value[row, column, aggregated[row, column].argmin()]


@njit(cache=True, nogil=True, parallel=True)
def measure_pixel_depths(image, lenses: LensArray, surface, grid: PointGrid, levels, before, c: PixelCosts, out):
    """Fill `out` (H, W) with the patch size [px] that each pixel of the microimages shows.

    Parameters
    ----------
    image : (H, W, 3) float32
        The flat, divided by its gain; white = 1.
    lenses : LensArray
    surface : (rows, columns) float32 [px]
    grid : PointGrid
    levels : (rows, columns) uint64
        As `mark_levels`.
    before : (H, W) float32
        Result of the first round; (1, 1) in that.
    c : PixelCosts
    """
    for lens in prange(len(lenses.centres)):
        _measure_lens(lens, image, lenses, surface, grid, levels, before, c, out)
