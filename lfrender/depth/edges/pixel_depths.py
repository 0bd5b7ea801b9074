"""The patch size that every pixel of a microimage shows, among those that the surface has nearby.

Each pixel is compared with the pixels that other lenses would show it at (multi-view stereo with the microimage as the
reference view), and semi-global matching (Hirschmueller 2008) inside the microimage regularises the choice. In the
first round the better part of the views counts, since some are occluded; in the second round, those views that
the first one finds occluded are left out (view selection, Schoenberger et al. 2016).
"""

from __future__ import annotations

import numpy as np

from lfcal.runtime.kernels.jit import njit

from .comparison import allow_mismatch, compare_depth
from .geometry import LensArray, PointGrid, level_of, value_at
from .microimage import BINS, DEPTHS, PixelCosts, make_microimage
from .regularisation import aggregate, price_jumps

__all__ = ["measure_pixel_depths"]

# The largest mismatch: of depths that the surface has nowhere near.
_NO_MATCH = 1.0
# [pitch] smaller patch sizes count as this, or a microimage would span all of the scene.
_LEAST = 0.02


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _list_depths(surface, grid, x, y, lenses, reach, work):
    """Patch sizes of the surface that the lens at (x, y) may show, in `work.depths`; returns how many there are."""
    rows, columns = surface.shape
    first, spacing = grid.first, grid.spacing
    count, total, depths = work.bins[0], work.bins[1], work.depths
    work.bins[:] = 0
    width, span = 0.25 * lenses.gap, int(3.5 * lenses.pitch / spacing)
    at_u, at_v = int((x - first) / spacing + 0.5), int((y - first) / spacing + 0.5)
    for v in range(max(0, at_v - span), min(rows, at_v + span + 1)):
        for u in range(max(0, at_u - span), min(columns, at_u + span + 1)):
            s = surface[v, u]
            away2 = (first + u * spacing - x) ** 2 + (first + v * spacing - y) ** 2
            # A microimage shows radius * pitch / s of the scene each way.
            if away2 * s * s <= (reach * abs(s) + lenses.radius * lenses.pitch) ** 2:
                place = min(max(int(s / width + BINS // 2), 0), BINS - 1)
                count[place] += 1
                total[place] += s
    found = place = 0
    while place < BINS and found < DEPTHS:
        end, number, amount = place, 0.0, 0.0
        while end < BINS and count[end] > 0 and end - place < 6:
            number, amount, end = number + count[end], amount + total[end], end + 1
        if number >= 2:
            depths[found] = amount / number
            found += 1
        place = max(end, place + 1)
    return found


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
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


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _list_candidates(x, y, left, top, size, surface, grid, levels, lenses, depths, number, before, c, work, shape):
    """Fill `work` with the depths that each pixel may show; returns whether there is a choice anywhere."""
    first, spacing, pitch, radius = grid.first, grid.spacing, lenses.pitch, lenses.radius
    settled, among = work.wanted, work.count
    for row in range(size):
        for column in range(size):
            px, py = left + column, top + row
            inside = (px - x) ** 2 + (py - y) ** 2 <= radius * radius
            inside = inside and 1 <= px < shape[1] - 1 and 1 <= py < shape[0] - 1
            work.inside[row, column] = inside
            settled[row * size + column] = inside and _is_settled(before, px, py, c.around, lenses.gap)
    among[:] = 0
    for k in range(number):
        expected = depths[k]
        if abs(expected) < _LEAST * pitch:
            expected = _LEAST * pitch if expected > 0 else -_LEAST * pitch
        reach, bit = pitch / expected, np.uint64(level_of(expected, pitch))
        for row in range(size):
            for column in range(size):
                at_x, at_y = x - (left + column - x) * reach, y - (top + row - y) * reach
                s = value_at(surface, first, spacing, at_x, at_y)
                present = abs(s - expected) < lenses.gap
                if not present:
                    s = expected
                    present = (value_at(levels, first, spacing, at_x, at_y) >> bit) & np.uint64(1) != 0
                if settled[row * size + column]:
                    present = abs(s - before[top + row, left + column]) < lenses.gap
                work.value[k, row, column], work.slope[k, row, column] = s, s / pitch
                work.present[k, row, column] = present
                work.cost[k, row, column] = 0.0 if present else _NO_MATCH
                among[row * size + column] += present
    choice = False
    for row in range(size):
        for column in range(size):
            work.open[row, column] = work.inside[row, column] and among[row * size + column] > 1
            choice = choice or work.open[row, column]
    return choice


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _measure_lens(lens, image, lenses, surface, grid, levels, before, c, work, out):
    """Fill `out` with the patch sizes of the pixels of one lens."""
    x, y = lenses.centres[lens, 0], lenses.centres[lens, 1]
    half = int(lenses.radius) + 2
    size, left, top = 2 * half + 1, int(x + 0.5) - half, int(y + 0.5) - half
    depths = work.depths
    number = _list_depths(surface, grid, x, y, lenses, c.reach, work)
    if number == 0:
        depths[0], number = value_at(surface, grid.first, grid.spacing, x, y), 1
    choice = _list_candidates(x, y, left, top, size, surface, grid, levels, lenses, depths, number, before, c, work,
                              image.shape)  # fmt: skip
    if choice:
        allow_mismatch(image, left, top, size, c, work)
        for k in range(number):
            share = 1.0 if before.size > 1 else c.visible_share
            compare_depth(image, lens, k, share, left, top, size, lenses, before, c, work)
        price_jumps(image, left, top, size, c, work)
        aggregate(size, number, lenses.gap, work)
    for row in range(size):
        for column in range(size):
            if work.inside[row, column]:
                best, least = 0, np.float32(np.inf)
                for k in range(number):
                    value = work.total[k, row, column] if choice else work.cost[k, row, column]
                    if value < least:
                        best, least = k, value
                out[top + row, left + column] = work.value[best, row, column]


@njit(cache=True, nogil=True, error_model="numpy", share=lambda image, lenses, *_: len(lenses.centres))
def measure_pixel_depths(begin, end, image, lenses: LensArray, surface, grid: PointGrid, levels, before,
                         c: PixelCosts, out):  # fmt: skip
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
    size = 2 * (int(lenses.radius) + 2) + 1
    work = make_microimage(size)
    for lens in range(begin, end):
        _measure_lens(lens, image, lenses, surface, grid, levels, before, c, work, out)
