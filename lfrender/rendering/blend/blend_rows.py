"""Blending row by row: each lens is read along the run of pixels that it shows, with vector
instructions.

Computes the robust mean of `blend_pixels` for the usual picture: integers of up to three channels
and one sample per output pixel. Pixels that need several samples are left to that kernel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST, kernel

from .blend_pixels import count_samples
from .records import OCCLUDED, RIM

__all__ = ["blend_rows"]

# Columns that are blended together, and pixels of a run, in groups of a vector register; fewer than
# two groups no compiler turns into vectors. Values of one kind follow each other at known distances
# in one array: for arrays that may overlap there would be no vector instructions. Places are
# unsigned: signed ones are checked for being counted from the end.
_SECTION = 1024
_RUN = 64
_GROUP = 8
_LINE = _SECTION + _RUN
_L1 = np.uint64(_LINE)
_L2 = np.uint64(2 * _LINE)
_L3 = np.uint64(3 * _LINE)
_R1 = np.uint64(_RUN)
_R2 = np.uint64(2 * _RUN)
_R3 = np.uint64(3 * _RUN)
_R4 = np.uint64(4 * _RUN)


class _Memory(NamedTuple):
    """Working memory of one thread. Numba counts references when arrays are taken out of it: not in
    loops over runs.
    """

    # (3 + types, LINE) float32, by column: slope s / D, squared reach, patch size, weights of types
    band: Any
    # (2, m) float32: grid values of the surface between two rows of it, and of the nearer row
    grid: Any
    edge: Any  # (m,) bool: there is a depth edge in the grid cell
    place: Any  # (SECTION,) int32: grid cell, or entry of the weights, of each column
    # (4, RUN) float32: position between pixels x, y, weight and gain of each reading of a run
    work: Any
    whole: Any  # (2, RUN) int32: pixel of the flat and entry of the light table
    corners: Any  # (4, RUN): the pixels about each reading
    values: Any  # (runs, 4, RUN) float32: weight and three channels of each reading of all runs
    runs: Any  # (runs, 2) int64: first column, and groups of pixels
    sums: Any  # (4, LINE) float32: weights and weighted channels by column
    totals: Any  # likewise, with readings weighted by how well they agree


@njit
def _allocate(types, cells, runs, packed):
    single = np.float32
    return _Memory(
        np.ones((3 + types) * _LINE, single),
        np.empty((2, cells), single),
        np.empty(cells, np.bool_),
        np.empty(_SECTION, np.int32),
        np.empty(4 * _RUN, single),
        np.empty(2 * _RUN, np.int32),
        np.empty(4 * _RUN, packed.dtype),
        np.empty(runs * 4 * _RUN, single),
        np.empty((runs, 2), np.int64),
        np.empty(4 * _LINE, single),
        np.empty(4 * _LINE, single),
    )


@njit(fastmath=FAST, error_model="numpy")
def _sample_surface(surface, depth, x, y, spacing, count, memory):
    """Fill the sizes of `count` columns from scene point (x, y) on, as `patch_size_at`."""
    sizes = memory.band[2 * _LINE : 3 * _LINE]
    places = memory.place
    edge = memory.edge
    level = memory.grid[0]
    near = memory.grid[1]
    rows, columns = surface.shape
    zero = np.float32(0)
    half = np.float32(0.5)
    one = np.float32(1)
    last_x = np.float32(columns - 1)
    last = np.int32(max(columns - 2, 0))
    for k in range(count):
        across = min(max((np.float32(x + k * spacing) - depth.x) / depth.spacing, zero), last_x)
        places[k] = min(np.int32(across), last)
        sizes[k] = across - np.float32(places[k])
    down = min(max((np.float32(y) - depth.y) / depth.spacing, zero), np.float32(rows - 1))
    j = min(int(down), max(rows - 2, 0))
    above = surface[j]
    below = surface[min(j + 1, rows - 1)]
    fy = down - np.float32(j)
    start = places[0]
    for k in range(places[count - 1] + 2 - start):
        i = min(start + k, columns - 1)
        right = min(start + k + 1, columns - 1)
        a = above[i]
        b = above[right]
        c = below[i]
        d = below[right]
        level[k], near[k] = (one - fy) * a + fy * c, c if fy > half else a
        edge[k] = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) >= depth.edge
    for k in range(count):
        at = np.uint64(np.uint32(places[k] - start))
        beyond = np.uint64(np.uint32(places[k] - start + 1))
        fx = sizes[k]
        flat = (one - fx) * level[at] + fx * level[beyond]
        sizes[k] = (near[beyond] if fx > half else near[at]) if edge[at] else flat


@njit(fastmath=FAST, error_model="numpy")
def _fill_band(memory, count, pitch, shares, weighting):
    """Slopes, reach and weights of the lens types for the sizes of `count` columns; returns the
    largest reach.
    """
    band = memory.band
    places = memory.place
    slopes = band[:_LINE]
    limits = band[_LINE : 2 * _LINE]
    sizes = band[2 * _LINE : 3 * _LINE]
    per_pitch = np.float32(1) / pitch
    widest = weighting.widest
    reach = weighting.reach
    least = np.float32(1e-6)
    for k in range(count):
        slopes[k] = sizes[k] * per_pitch
        limit = min(widest / max(abs(slopes[k]), least), reach)
        limits[k] = limit * limit
    farthest = np.float32(0)
    for k in range(count):
        farthest = max(farthest, limits[k])
    # Pixels beyond the last one are in reach of no lens.
    limits[count : count + _RUN], slopes[count : count + _RUN] = -1, 0
    last = np.float32(shares.shape[1] - 1)
    if last > 0:
        for k in range(count):
            ratio = (slopes[k] + np.float32(1)) * (np.float32(0.5) * last) + np.float32(0.5)
            places[k] = np.int32(min(max(ratio, np.float32(0)), last))
        for t in range(len(shares)):
            share = shares[t]
            own = band[(3 + t) * _LINE : (4 + t) * _LINE]
            for k in range(count):
                own[k] = share[np.uint64(np.uint32(places[k]))]
    return np.float64(np.sqrt(farthest))


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _interpolate(a, b, c, d, lowest, w00, w01, w10, w11):
    """Weighted sum of the `lowest` bits of four pixels."""
    upper = w00 * np.float32(np.int32(a & lowest)) + w01 * np.float32(np.int32(b & lowest))
    return upper + (w10 * np.float32(np.int32(c & lowest)) + w11 * np.float32(np.int32(d & lowest)))


@njit(fastmath=FAST, error_model="numpy")
def _read_lenses(memory, flat, light, lenses, edge, weighting, grid, column, count, y, reach):
    """Add up the readings of all lenses within `reach` of a row of `count` columns; returns the
    number of runs.
    """
    band = memory.band
    work = memory.work
    whole = memory.whole
    corners = memory.corners
    values = memory.values
    sums = memory.sums
    runs = memory.runs
    line = flat.pixels.reshape(-1)
    shown = flat.depth.reshape(-1)
    table = light.gains.reshape(-1)
    width = np.int32(flat.size[0])
    height = np.int32(flat.size[1])
    entries = light.gains.shape[1]
    corner_x = np.int32(flat.corner[0])
    corner_y = np.int32(flat.corner[1])
    stride = np.int32(flat.pixels.shape[1])
    down = np.uint64(flat.pixels.shape[1])
    apart = np.float32(2) * edge
    last_x = np.int32(width - 2)
    last_y = np.int32(height - 2)
    end_x = np.float32(width - 1)
    end_y = np.float32(height - 1)
    view_x = weighting.viewpoint[0]
    view_y = weighting.viewpoint[1]
    radius2 = weighting.viewpoint[2]
    per_radius2 = np.float32(1) / radius2
    per_entry = np.float32(1) / light.step
    last_entry = np.float32(entries - 1)
    first = grid.first[0]
    spacing = grid.spacing
    step = np.float32(grid.spacing)
    per_spacing = 1 / grid.spacing
    zero = np.float32(0)
    half = np.float32(0.5)
    one = np.float32(1)
    next_one = np.uint64(1)
    applied = light.applied
    bits = line.dtype.type(2 * line.itemsize)
    lowest = (line.dtype.type(1) << bits) - line.dtype.type(1)
    inner = np.sqrt(radius2) + np.sqrt(view_x * view_x + view_y * view_y) + 2
    centres = lenses.centres
    tables = lenses.tables
    types = lenses.types
    edged = lenses.edged
    number = np.uint64(0)
    for lens in range(
        np.searchsorted(centres[:, 1], y - reach), np.searchsorted(centres[:, 1], y + reach)
    ):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        wide = np.sqrt(max(reach * reach - (y - cy) * (y - cy), 0.0))
        first_u = max(int(np.ceil((cx - wide - first) * per_spacing)) - column, 0)
        end_u = min(int(np.floor((cx + wide - first) * per_spacing)) + 1 - column, count)
        # Counted from the pixel nearest to the centre, whatever part of the picture is drawn.
        anchor = int(np.rint((cx - first) * per_spacing))
        e_x = np.float32(first + anchor * spacing - cx)
        ey = np.float32(y - cy)
        at_x = np.int32(np.floor(cx))
        at_y = np.int32(np.floor(cy))
        inner_x = np.float32(cx - at_x)
        inner_y = np.float32(cy - at_y)
        border = not (inner <= cx <= width - 1 - inner and inner <= cy <= height - 1 - inner)
        own_table = np.int32(tables[lens] * entries)
        own_share = np.uint64(3 + types[lens]) * _L1
        for begin in range(first_u, end_u, _RUN):
            n_x = np.int32(column + begin - anchor)
            u = np.uint64(begin)
            to = number * _R4
            groups = max((min(end_u - begin, _RUN) + _GROUP - 1) // _GROUP, 2)
            size = np.uint64(groups) * np.uint64(_GROUP)
            # Where the lens is read, and with which weight: all numbers have 32 bits, of which a
            # register holds most.
            for k in range(size):
                ex = np.float32(np.int32(np.int32(k) + n_x)) * step + e_x
                d2 = ex * ex + ey * ey
                tilt = band[u + k]
                limit = band[_L1 + u + k]
                dx = view_x - ex * tilt
                dy = view_y - ey * tilt
                delta2 = dx * dx + dy * dy
                rx = inner_x + dx
                ry = inner_y + dy
                step_x = np.floor(rx)
                step_y = np.floor(ry)
                fx = rx - step_x
                fy = ry - step_y
                ix = np.int32(at_x + np.int32(step_x))
                iy = np.int32(at_y + np.int32(step_y))
                ok = (d2 <= limit) & (delta2 <= radius2)
                if border:
                    ok &= (
                        (ix >= 0)
                        & (iy >= 0)
                        & (np.float32(ix) + fx <= end_x)
                        & (np.float32(iy) + fy <= end_y)
                    )
                    fx = one if ix > last_x else fx
                    fy = one if iy > last_y else fy
                    ix = min(max(ix, np.int32(0)), last_x)
                    iy = min(max(iy, np.int32(0)), last_y)
                weight = (RIM - max(d2 / limit, delta2 * per_radius2)) * band[own_share + u + k]
                work[k], work[_R1 + k], work[_R2 + k] = fx, fy, weight if ok else zero
                place = np.int32(
                    np.int32(np.int32(iy - corner_y) * stride) + np.int32(ix - corner_x)
                )
                whole[k] = place if ok else np.int32(0)
                whole[_R1 + k] = np.int32(np.int32(min(delta2 * per_entry, last_entry)) + own_table)
            for k in range(size):
                at = np.uint64(np.uint32(whole[k]))
                entry = np.uint64(np.uint32(whole[_R1 + k]))
                corners[k], corners[_R1 + k] = line[at], line[at + next_one]
                corners[_R2 + k], corners[_R3 + k] = line[at + down], line[at + down + next_one]
                work[_R3 + k] = table[entry]
            if edged[lens]:
                for k in range(size):
                    at = np.uint64(np.uint32(whole[k])) + np.uint64(work[k] >= half)
                    at += np.uint64(work[_R1 + k] >= half) * down
                    work[_R2 + k] *= OCCLUDED if abs(shown[at] - band[_L2 + u + k]) > apart else one
            for k in range(size):
                fx = work[k]
                fy = work[_R1 + k]
                gain = work[_R3 + k]
                weight = work[_R2 + k] / (gain * gain)
                gain = one + applied * (gain - one)
                gx = gain * fx
                gy = one - fy
                w01 = gx * gy
                w11 = gx * fy
                w00 = gain * gy - w01
                w10 = gain * fy - w11
                a = corners[k]
                b = corners[_R1 + k]
                c = corners[_R2 + k]
                d = corners[_R3 + k]
                v0 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
                a = a >> bits
                b = b >> bits
                c = c >> bits
                d = d >> bits
                v1 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
                a = a >> bits
                b = b >> bits
                c = c >> bits
                d = d >> bits
                v2 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
                values[to + k], values[to + _R1 + k] = weight, v0
                values[to + _R2 + k], values[to + _R3 + k] = v1, v2
                sums[u + k] += weight
                sums[_L1 + u + k] += weight * v0
                sums[_L2 + u + k] += weight * v1
                sums[_L3 + u + k] += weight * v2
            runs[number, 0], runs[number, 1] = u, groups
            number += next_one
    return number


@njit(fastmath=FAST, error_model="numpy")
def _normalise(sums, count):
    """Divide the weighted `sums` of `count` columns by their weights."""
    for k in range(np.uint64(count)):
        inverse = np.float32(1) / (sums[k] if sums[k] > 0 else np.float32(1))
        sums[_L1 + k] *= inverse
        sums[_L2 + k] *= inverse
        sums[_L3 + k] *= inverse


@njit(fastmath=FAST, error_model="numpy")
def _add_agreeing(memory, number, t2, per_channel):
    """Add readings to the totals, weighted by how close they are to the mean of their pixel
    (Geman-McClure).
    """
    values = memory.values
    means = memory.sums
    totals = memory.totals
    runs = memory.runs
    for n in range(number):
        u = np.uint64(runs[n, 0])
        size = np.uint64(runs[n, 1]) * np.uint64(_GROUP)
        at = n * _R4
        for k in range(size):
            v0 = values[at + _R1 + k]
            v1 = values[at + _R2 + k]
            v2 = values[at + _R3 + k]
            e0 = v0 - means[_L1 + u + k]
            e1 = v1 - means[_L2 + u + k]
            e2 = v2 - means[_L3 + u + k]
            agree = t2 / (t2 + (e0 * e0 + e1 * e1 + e2 * e2) * per_channel)
            weight = values[at + k] * agree * agree
            totals[u + k] += weight
            totals[_L1 + u + k] += weight * v0
            totals[_L2 + u + k] += weight * v1
            totals[_L3 + u + k] += weight * v2


@kernel(error_model="numpy", share=lambda *given: len(given[7].image))
def blend_rows(begin, end, flat, light, lenses, surface, depth, grid, weighting, output, left):
    """Draw as `blend_pixels`, from packed pixels (`prefilter_packed`); those that need several
    samples are marked in `left`.
    """
    image = output.image
    valid = output.valid
    spacing = grid.spacing
    start = grid.start
    columns = image.shape[1]
    channels = image.shape[2]
    # A lens is read in pieces along a row; as many lie beside it as twice the reach, and a pitch,
    # hold.
    across = int(_SECTION * spacing / lenses.pitch) + 2 * int(weighting.reach / lenses.pitch) + 4
    beside = 4 * (2 * int(weighting.reach / lenses.pitch) + 3)
    pieces = int(2 * weighting.reach / spacing) // _RUN + 2
    cells = int(_SECTION * spacing / depth.spacing) + 4
    memory = _allocate(len(lenses.shares), cells, across * beside * pieces, flat.pixels)
    t2 = weighting.tolerance * weighting.tolerance
    per_channel = np.float32(1 / channels)
    for v in range(begin, end):
        y = grid.first[1] + (start[1] + v) * spacing
        for section in range(0, columns, _SECTION):
            count = min(_SECTION, columns - section)
            column = start[0] + section
            _sample_surface(
                surface, depth, grid.first[0] + column * spacing, y, spacing, count, memory
            )
            reach = _fill_band(memory, count, lenses.pitch, lenses.shares, weighting)
            memory.sums[:] = 0
            memory.totals[:] = 0
            number = _read_lenses(
                memory, flat, light, lenses, depth.edge, weighting, grid, column, count, y, reach
            )
            _normalise(memory.sums, count)
            _add_agreeing(memory, number, t2, per_channel)
            _normalise(memory.totals, count)
            sizes = memory.band[2 * _LINE :]
            totals = memory.totals
            for k in range(count):
                left[v, section + k] = False
                if abs(sizes[k]) > grid.scale:
                    x = grid.first[0] + (column + k) * spacing
                    samples, _ = count_samples(
                        surface, depth, x, y, sizes[k], grid, lenses.pitch, weighting.squares
                    )
                    left[v, section + k] = samples > 1
                valid[v, section + k] = totals[k] > 0
                for c in range(channels):
                    image[v, section + k, c] = totals[(1 + c) * _LINE + k]
