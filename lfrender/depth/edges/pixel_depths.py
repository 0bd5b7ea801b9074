"""The patch size that every pixel of a microimage shows, among those that the surface has nearby.

Each pixel is compared with the pixels that other lenses would show it at (multi-view stereo with the microimage as the
reference view), and semi-global matching (Hirschmueller 2008) inside the microimage regularises the choice. In the
first round the better part of the views counts, since some are occluded; in the second round, those views that
the first one finds occluded are left out (view selection, Schoenberger et al. 2016).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lfcal.runtime.kernels.jit import njit

from ..surface.occlusion import depth_order
from .geometry import LensArray, PointGrid, level_of, value_at

__all__ = ["PixelCosts", "measure_pixel_depths"]

# Patch sizes of a lens, and other lenses that a pixel is compared with, at most.
_DEPTHS = 16
_VIEWS = 10
_BINS = 512


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
    least: Any  # [px]
    unseen: Any
    few: Any
    few_cost: Any
    around: Any


class _Microimage(NamedTuple):
    """Work space for the pixels of one lens, `size` each way; k counts its depths."""

    inside: Any  # (size, size) bool: pixels of the microimage
    value: Any  # (size, size, k) [px] patch size that each depth has there
    cost: Any  # (size, size, k)
    open: Any  # (size, size) bool: pixels that several depths are possible for
    present: Any  # (size, size, k) bool: the surface has this depth nearby
    weight: Any  # (size, size, 9) of the pixels of a patch, sum 1
    allowed: Any  # (size, size) mismatch that noise and blur explain
    apart: Any  # (size, size) squared difference to another lens
    stamp: Any  # (size, size) which lens and depth `apart` is of
    count: Any  # (size, size) lenses that a pixel has been compared with
    views: Any  # (size, size, _VIEWS) mismatch of each
    total: Any  # (size, size, k) sum of the paths of semi-global matching
    jumps: Any  # (4, size, size) price of a depth edge to the neighbour in each of four directions


@njit(cache=True, nogil=True, error_model="numpy")
def _make_work_space(size):
    return _Microimage(
        np.zeros((size, size), np.bool_), np.zeros((size, size, _DEPTHS), np.float32),
        np.zeros((size, size, _DEPTHS), np.float32), np.zeros((size, size), np.bool_),
        np.zeros((size, size, _DEPTHS), np.bool_), np.zeros((size, size, 9), np.float32),
        np.zeros((size, size), np.float32), np.zeros((size, size), np.float32), np.zeros((size, size), np.int64),
        np.zeros((size, size), np.int64), np.zeros((size, size, _VIEWS), np.float32),
        np.zeros((size, size, _DEPTHS), np.float32), np.zeros((4, size, size), np.float32),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _list_depths(surface, grid, x, y, lenses, reach, depths):
    """Patch sizes of the surface that the lens at (x, y) may show, in `depths`; returns how many there are."""
    rows, columns = surface.shape
    first, spacing = grid.first, grid.spacing
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
def _is_settled(before, px, py, around, gap):
    """Whether the first round found one surface on all pixels around this one."""
    if before.size == 1:
        return False
    s, height, width = before[py, px], before.shape[0], before.shape[1]
    for v in range(max(0, py - around), min(height, py + around + 1)):
        for u in range(max(0, px - around), min(width, px + around + 1)):
            if abs(before[v, u] - s) > gap:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _list_candidates(x, y, left, top, size, surface, grid, levels, lenses, depths, number, before, c, work, shape):
    """Fill `work` with the depths that each pixel may show; returns whether there is a choice anywhere."""
    first, spacing, pitch, radius = grid.first, grid.spacing, lenses.pitch, lenses.radius
    choice = False
    for row in range(size):
        for column in range(size):
            work.open[row, column] = False
            px, py = left + column, top + row
            dx, dy = px - x, py - y
            work.inside[row, column] = (
                dx * dx + dy * dy <= radius * radius and 1 <= px < shape[1] - 1 and 1 <= py < shape[0] - 1
            )
            among = 0
            settled = work.inside[row, column] and _is_settled(before, px, py, c.around, lenses.gap)
            for k in range(number):
                s = depths[k]
                if abs(s) < c.least:
                    s = c.least if s > 0 else -c.least
                at_x, at_y = x - dx * pitch / s, y - dy * pitch / s
                here = value_at(surface, first, spacing, at_x, at_y)
                own = abs(here - s) < lenses.gap
                if own:
                    s = here
                    at_x, at_y = x - dx * pitch / s, y - dy * pitch / s
                bit = np.uint64(level_of(s, pitch))
                present = own or (value_at(levels, first, spacing, at_x, at_y) >> bit) & np.uint64(1) != 0
                if settled:
                    present = abs(s - before[py, px]) < lenses.gap
                work.value[row, column, k] = s
                work.present[row, column, k] = present
                work.cost[row, column, k] = c.absent if not present else 0.0 if own else c.foreign
                among += present
            work.open[row, column] = work.inside[row, column] and among > 1
            choice = choice or work.open[row, column]
    return choice


@njit(cache=True, nogil=True, error_model="numpy")
def _describe_patches(image, left, top, size, c, work):
    """Weights of the 3 x 3 pixels around each open pixel, which are few across edges, and the mismatch allowed."""
    for row in range(size):
        for column in range(size):
            if not work.open[row, column]:
                continue
            px, py, total = left + column, top + row, np.float32(0.0)
            weight = work.weight[row, column]
            for e in range(9):
                apart = np.float32(0.0)
                for channel in range(3):
                    step = image[py + e // 3 - 1, px + e % 3 - 1, channel] - image[py, px, channel]
                    apart += step * step
                weight[e] = 1 / (1 + apart / (2 * c.colour2))
                total += weight[e]
            contrast = np.float32(0.0)
            for e in range(9):
                weight[e] /= total
            for channel in range(3):
                mean, squares = np.float32(0.0), np.float32(0.0)
                for e in range(9):
                    value = image[py + e // 3 - 1, px + e % 3 - 1, channel]
                    mean += weight[e] * value
                    squares += weight[e] * value * value
                contrast += squares - mean * mean
            work.allowed[row, column] = c.contrast * contrast + c.noise2


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _squared_difference(image, px, py, x, y):
    """Squared difference of pixel (px, py) and the flat at (x, y), over the colours."""
    i, j = int(x), int(y)
    fx, fy = np.float32(x - i), np.float32(y - j)
    w11 = fx * fy
    w01, w10 = fx - w11, fy - w11
    w00 = np.float32(1.0) - fx - w10
    squares = np.float32(0.0)
    for channel in range(4):
        step = w00 * image[j, i, channel] + w01 * image[j, i + 1, channel] + w10 * image[j + 1, i, channel]
        step += w11 * image[j + 1, i + 1, channel] - image[py, px, channel]
        squares += step * step
    return squares


@njit(cache=True, nogil=True, error_model="numpy")
def _compare_lens(image, other_x, other_y, to_x, to_y, mark, left, top, size, k, depth, lenses, before, work):
    """Compare the open pixels with those of another lens, which lies (to_x, to_y) from this one, at their depth k."""
    height, width, radius2, pitch = image.shape[0], image.shape[1], lenses.radius * lenses.radius, lenses.pitch
    x, y = other_x - to_x, other_y - to_y
    # The microimages overlap in a box, a little larger for the pixels that show another depth than `depth`.
    middle_x, middle_y = x - left - to_x * depth / pitch, y - top - to_y * depth / pitch
    more = lenses.radius + lenses.gap * max(abs(to_x), abs(to_y)) / pitch + 1
    first_row, last_row = max(1, int(middle_y - more)), min(size - 1, int(middle_y + more) + 2)
    first_column, last_column = max(1, int(middle_x - more)), min(size - 1, int(middle_x + more) + 2)
    for row in range(first_row, last_row):
        for column in range(first_column, last_column):
            if work.count[row, column] >= _VIEWS:
                continue
            s = work.value[row, column, k]
            dx, dy = left + column - x + to_x * s / pitch, top + row - y + to_y * s / pitch
            if dx * dx + dy * dy > radius2:
                continue
            u, v = int(other_x + dx + 0.5), int(other_y + dy + 0.5)
            if u < 2 or v < 2 or u >= width - 3 or v >= height - 3:
                continue
            if before.size > 1 and depth_order(before[v, u], pitch) > depth_order(s, pitch) + lenses.gap:
                continue
            squares = np.float32(0.0)
            for e in range(9):
                r, q = row + e // 3 - 1, column + e % 3 - 1
                if work.stamp[r, q] != mark:
                    work.stamp[r, q] = mark
                    slope = work.value[r, q, k] / pitch
                    at_x = min(max(left + q + to_x * (1 + slope), 0.0), width - 2.0)
                    at_y = min(max(top + r + to_y * (1 + slope), 0.0), height - 2.0)
                    work.apart[r, q] = _squared_difference(image, left + q, top + r, at_x, at_y)
                squares += work.weight[row, column, e] * work.apart[r, q]
            work.views[row, column, work.count[row, column]] = squares / (squares + work.allowed[row, column])
            work.count[row, column] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_of_best(views, count, share, c):
    """Mean of the `share` of the first `count` values that are the least; they are sorted."""
    if count == 0:
        return c.unseen
    for n in range(1, count):
        value, place = views[n], n
        while place > 0 and views[place - 1] > value:
            views[place] = views[place - 1]
            place -= 1
        views[place] = value
    number = max(1, int(share * count + 0.5))
    return views[:number].sum() / number + c.few_cost * max(0, c.few - count)


@njit(cache=True, nogil=True, error_model="numpy")
def _compare_depth(image, lens, k, depth, share, mark, left, top, size, lenses, before, c, work):
    """Add the mismatch with the other lenses to the costs of depth k; returns the last mark in `work.stamp`."""
    rows, low, ring, centres = lenses.rows, lenses.low, lenses.ring, lenses.centres
    at_i, at_j = lenses.indices[lens, 0] - low[0], lenses.indices[lens, 1] - low[1]
    candidates = 0
    for row in range(size):
        for column in range(size):
            compared = work.open[row, column] and work.present[row, column, k]
            work.count[row, column] = 0 if compared else _VIEWS
            candidates += compared
    if candidates == 0:
        return mark
    for r in range(1, len(ring)):
        ci, cj = at_i + ring[r, 0], at_j + ring[r, 1]
        if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1] or rows[cj, ci] < 0:
            continue
        other = rows[cj, ci]
        mark += 1
        _compare_lens(image, centres[other, 0], centres[other, 1], centres[other, 0] - centres[lens, 0],
                      centres[other, 1] - centres[lens, 1], mark, left, top, size, k, depth, lenses, before,
                      work)  # fmt: skip
    for row in range(size):
        for column in range(size):
            if work.open[row, column] and work.present[row, column, k]:
                work.cost[row, column, k] += _mean_of_best(work.views[row, column], work.count[row, column], share, c)
    return mark


@njit(cache=True, nogil=True, error_model="numpy")
def _price_jumps(image, left, top, size, c, work):
    """Prices of depth edges between neighbouring pixels: lower where their colours differ."""
    for direction in range(4):
        down, across = (0, 1, 1, 1)[direction], (1, -1, 0, 1)[direction]
        for row in range(size - down):
            for column in range(max(0, -across), size - max(0, across)):
                if work.inside[row, column] and work.inside[row + down, column + across]:
                    apart = np.float32(0.0)
                    for channel in range(3):
                        step = image[top + row, left + column, channel]
                        step -= image[top + row + down, left + column + across, channel]
                        apart += step * step
                    work.jumps[direction, row, column] = c.jump * (
                        c.edge_share + (1 - c.edge_share) * np.exp(-apart / c.edge2)
                    )


@njit(cache=True, nogil=True, error_model="numpy")
def _aggregate_line(work, size, number, gap, slant, v, u, down, across):
    """Add one path of semi-global matching, from pixel (u, v) on, to the total."""
    previous, current = np.zeros(number, np.float32), np.zeros(number, np.float32)
    lowest, linked, from_v, from_u = np.float32(0.0), False, 0, 0
    forward = down > 0 or (down == 0 and across > 0)
    direction = 0 if down == 0 else 2 + across * down
    while 0 <= v < size and 0 <= u < size:
        if work.inside[v, u]:
            least = np.float32(np.inf)
            if linked:
                jump = work.jumps[direction, from_v, from_u] if forward else work.jumps[direction, v, u]
                for k in range(number):
                    best = jump
                    for q in range(max(0, k - 1), min(number, k + 2)):
                        # Depths ascend: others than those beside it are a jump away.
                        step = abs(work.value[v, u, k] - work.value[from_v, from_u, q]) / gap
                        if step < 1.5:
                            best = min(best, previous[q] - lowest + slant * step)
                    current[k] = work.cost[v, u, k] + best
                    work.total[v, u, k] += current[k]
                    least = min(least, current[k])
            else:
                for k in range(number):
                    current[k] = work.cost[v, u, k]
                    work.total[v, u, k] += current[k]
                    least = min(least, current[k])
            lowest = least
            previous[:] = current
            linked, from_v, from_u = True, v, u
        else:
            linked = False
        v, u = v + down, u + across


@njit(cache=True, nogil=True, error_model="numpy")
def _aggregate(size, number, lenses, c, work):
    """Semi-global matching along eight directions inside a microimage."""
    work.total[:size, :size] = 0
    for down in range(-1, 2):
        for across in range(-1, 2):
            if down == 0 and across == 0:
                continue
            for start in range(size):
                if down != 0:
                    v = 0 if down > 0 else size - 1
                    _aggregate_line(work, size, number, lenses.gap, c.slant, v, start, down, across)
                if across != 0 and not (down != 0 and start == (0 if down > 0 else size - 1)):
                    u = 0 if across > 0 else size - 1
                    _aggregate_line(work, size, number, lenses.gap, c.slant, start, u, down, across)


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_lens(lens, image, lenses, surface, grid, levels, before, c, work, mark, out):
    """Fill `out` with the patch sizes of the pixels of one lens; returns the last mark in `work.stamp`."""
    pitch, radius = lenses.pitch, lenses.radius
    x, y = lenses.centres[lens, 0], lenses.centres[lens, 1]
    half = int(radius) + 2
    size, left, top = 2 * half + 1, int(x + 0.5) - half, int(y + 0.5) - half
    depths = np.empty(_DEPTHS)
    number = _list_depths(surface, grid, x, y, lenses, c.reach, depths)
    if number == 0:
        depths[0], number = value_at(surface, grid.first, grid.spacing, x, y), 1
    choice = _list_candidates(x, y, left, top, size, surface, grid, levels, lenses, depths, number, before, c, work,
                              image.shape)  # fmt: skip
    if choice:
        _describe_patches(image, left, top, size, c, work)
        nearest = 0
        for k in range(1, number):
            if depth_order(depths[k], pitch) > depth_order(depths[nearest], pitch):
                nearest = k
        for k in range(number):
            share = c.open_share if k == nearest or before.size > 1 else c.occluded_share
            mark = _compare_depth(image, lens, k, depths[k], share, mark, left, top, size, lenses, before, c, work)
        _price_jumps(image, left, top, size, c, work)
        _aggregate(size, number, lenses, c, work)
    for row in range(size):
        for column in range(size):
            if work.inside[row, column]:
                best, least = 0, np.float32(np.inf)
                for k in range(number):
                    value = work.total[row, column, k] if choice else work.cost[row, column, k]
                    if value < least:
                        best, least = k, value
                out[top + row, left + column] = work.value[row, column, best]
    return mark


@njit(cache=True, nogil=True, error_model="numpy", share=lambda image, lenses, *_: len(lenses.centres))
def measure_pixel_depths(begin, end, image, lenses: LensArray, surface, grid: PointGrid, levels, before,
                         c: PixelCosts, out):  # fmt: skip
    """Fill `out` (H, W) with the patch size [px] that each pixel of the microimages shows.

    Parameters
    ----------
    image : (H, W, 4) float32
        The flat, divided by its gain; white = 1. The last channel is 0.
    lenses : LensArray
    surface : (rows, columns) float32 [px]
    grid : PointGrid
    levels : (rows, columns) uint64
        As `mark_levels`.
    before : (H, W) float32
        Result of the first round; (1, 1) in that.
    c : PixelCosts
    """
    work, mark = _make_work_space(2 * (int(lenses.radius) + 2) + 1), 0
    for lens in range(begin, end):
        mark = _measure_lens(lens, image, lenses, surface, grid, levels, before, c, work, mark, out)
