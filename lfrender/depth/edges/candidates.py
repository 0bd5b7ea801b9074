"""The depths that the pixels of a microimage may show: those that the surface has about the places
they would be at.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .microimage import BINS, DEPTHS, NEARBY, OWN

__all__ = ["list_candidates", "list_depths", "mark_levels"]

# Patch sizes of up to 0.8 pitches either way are told apart in so many levels, one bit each.
_LEVELS = 64
# Levels and bins begin beside simple fractions of a pitch, by this share of their width: constant
# surfaces and steps of the search lie on such fractions, and rounding errors would sort them.
_BESIDE = 0.37
# Cost of a depth that is not present at a pixel, nearby, and that of the surface there, in units of
# the mismatch. With half of the second, ten scenes lose 0.04 dB less, but R5b has 82 instead of 69
# specks a megapixel and AntLeg 130 instead of 107.
_COSTS = np.array([1, 0.03, 0], np.float32)


@njit(inline="always")
def _level_of(s, pitch):
    return min(max(int((s / pitch + 0.8) * (_LEVELS / 1.6) + _BESIDE), 0), _LEVELS - 1)


def mark_levels(surface: NDArray[np.float32], pitch: float, reach: int) -> NDArray[np.uint64]:
    """(rows, columns): a bit for each level of patch sizes that the surface has within `reach`
    values each way.
    """
    one = np.uint64(1)
    level = ((surface / pitch + 0.8) * (_LEVELS / 1.6) + _BESIDE).astype(int)
    level = np.clip(level, 0, _LEVELS - 1)
    bits = np.zeros(surface.shape, np.uint64)
    for beside in (-1, 0, 1):
        bits |= one << np.clip(level + beside, 0, _LEVELS - 1).astype(np.uint64)
    for axis in (0, 1):
        bits = np.moveaxis(bits, axis, 0)
        wide = 1
        # The window doubles until it is as wide as it has to be.
        bits = np.pad(bits, ((reach, reach), (0, 0)))
        while wide < 2 * reach + 1:
            step = min(wide, 2 * reach + 1 - wide)
            bits = bits[step:] | bits[:-step]
            wide = wide + step
        bits = np.moveaxis(bits, 0, axis)
    return np.ascontiguousarray(bits)


@njit(error_model="numpy")
def list_depths(surface, grid, x, y, lenses, work):
    """Patch sizes of the surface that the lens at (x, y) may show, in `work.depths`; returns how
    many there are.
    """
    rows, columns = surface.shape
    first = grid.first
    spacing = grid.spacing
    pitch = lenses.pitch
    radius = lenses.radius
    bins = work.bins
    depths = work.depths
    bins[:] = 0
    width = 0.25 * lenses.gap
    # Lenses nearest to a scene point are within two pitches of it, and depths within one are tried
    # there.
    span = int(3 * pitch / spacing + 0.5) + 1
    at_u = int((x - first) / spacing + 0.5)
    at_v = int((y - first) / spacing + 0.5)
    # Every other value each way: no surface is narrower than these are apart.
    for v in range(max(0, at_v - span), min(rows, at_v + span + 1), 2):
        for u in range(max(0, at_u - span), min(columns, at_u + span + 1), 2):
            s = surface[v, u]
            away2 = (first + u * spacing - x) ** 2 + (first + v * spacing - y) ** 2
            # A microimage shows radius * pitch / s of the scene each way.
            if away2 * s * s <= (pitch * abs(s) + radius * pitch) ** 2:
                place = min(max(int(s / width + BINS // 2 + _BESIDE), 0), BINS - 1)
                bins[0, place] += 1
                bins[1, place] += s
    found = place = 0
    while place < BINS and found < DEPTHS:
        end = place
        number = 0.0
        amount = 0.0
        while end < BINS and bins[0, end] > 0 and end - place < 6:
            number = number + bins[0, end]
            amount = amount + bins[1, end]
            end = end + 1
        if number > 0:
            depths[found] = amount / number
            found += 1
        place = max(end, place + 1)
    return found


@njit(error_model="numpy")
def _outline(x, y, left, top, size, radius, shape, work):
    """Set the columns of each row of the microimage, a pixel off the border of the flat."""
    for row in range(size):
        half2 = radius * radius - (top + row - y) ** 2
        work.left[row], work.right[row] = 0, 0
        if half2 >= 0 and 1 <= top + row < shape[0] - 1:
            half = np.sqrt(half2)
            work.left[row] = max(int(np.ceil(x - half)), 1) - left
            work.right[row] = max(
                min(int(np.floor(x + half)), shape[1] - 2) + 1 - left, work.left[row]
            )


@njit(error_model="numpy", forceinline=True)
def _is_settled(before, px, py, gap):
    """Whether the first round found one surface on all pixels within two of this one."""
    s = before[py, px]
    height = before.shape[0]
    width = before.shape[1]
    for v in range(max(0, py - 2), min(height, py + 3)):
        for u in range(max(0, px - 2), min(width, px + 3)):
            if abs(before[v, u] - s) > gap:
                return False
    return True


@njit(error_model="numpy")
def _mark_present(k, x, y, left, top, size, stride, surface, grid, levels, lenses, work):
    first = grid.first
    spacing = grid.spacing
    pitch = lenses.pitch
    gap = lenses.gap
    rows, columns = surface.shape
    expected = work.depths[k]
    value = work.value
    present = work.present
    among = work.among
    # Near zero a microimage would span all of the scene.
    steep = max(abs(expected), 0.02 * pitch)
    steep = pitch / (steep if expected > 0 else -steep)
    bit = np.uint64(_level_of(expected, pitch))
    one = np.uint64(1)
    step = steep / spacing
    middle = (x - first) / spacing + 0.5 + (x - left) * step
    for row in range(size):
        v = int((y - first - (top + row - y) * steep) / spacing + 0.5)
        v = min(max(v, 0), rows - 1)
        for column in range(work.left[row], work.right[row]):
            u = min(max(int(middle - column * step), 0), columns - 1)
            p = row * stride + column
            s = surface[v, u]
            if abs(s - expected) < gap:
                value[k, p], present[k, p] = s, OWN
                among[p] += 1
            else:
                near = (levels[v, u] >> bit) & one != 0
                value[k, p], present[k, p] = expected, NEARBY if near else 0
                among[p] += near


@njit(error_model="numpy", forceinline=True)
def _keep_distinct(p, number, apart, work):
    """Drop the depths of a pixel that differ by less than `apart` from that of the surface."""
    value = work.value
    present = work.present
    among = work.among
    own = -1
    for k in range(number):
        if own < 0 and present[k, p] == OWN:
            own = k
    for k in range(number if own >= 0 else 0):
        if k != own and present[k, p] > 0 and abs(value[k, p] - value[own, p]) < apart:
            present[k, p] = 0
            among[p] -= 1


@njit(error_model="numpy")
def list_candidates(
    x, y, left, top, size, stride, number, surface, grid, levels, lenses, before, apart, shape, work
):
    """Fill `work` with the depths that each pixel may show; returns whether there is a choice.

    Depths must be `apart` [px] from that of the surface, and cost a little more.
    """
    widest = 0.0
    for k in range(number):
        widest = max(widest, abs(work.depths[k]))
    # Lenses nearest to a scene point show it within two patches of their centre.
    _outline(x, y, left, top, size, min(lenses.radius, 2 * widest), shape, work)
    among = work.among
    present = work.present
    cost = work.cost
    among[:] = 0
    present[:number] = 0
    for k in range(number):
        work.value[k] = work.depths[k]
        _mark_present(k, x, y, left, top, size, stride, surface, grid, levels, lenses, work)
    choice = False
    for row in range(size):
        for column in range(work.left[row], work.right[row]):
            p = row * stride + column
            px = left + column
            py = top + row
            if before.size > 1 and among[p] > 1 and _is_settled(before, px, py, lenses.gap):
                among[p] = 0
                for k in range(number):
                    if abs(work.value[k, p] - before[py, px]) >= lenses.gap:
                        present[k, p] = 0
                    among[p] += present[k, p] > 0
            _keep_distinct(p, number, apart, work)
            for k in range(number):
                cost[k, p] = _COSTS[present[k, p]]
            choice = choice or among[p] > 1
    return choice
