"""Blending row by row: each lens is read along the run of pixels that it shows, with vector
instructions.

Computes what `blend_pixels` does, for the usual picture: integers of up to three channels and one
sample per output pixel. Pixels that need several samples are left to that kernel. Readings of a run
are placed, weighed, interpolated and added, one step after the other.
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

# Where the values of a kind begin in `_Memory.band`: by column.
_SLOPE = np.uint64(0)
_LIMIT2 = np.uint64(_LINE)
_SIZE = np.uint64(2 * _LINE)
_NEAREST2 = np.uint64(3 * _LINE)
_SHARES = np.uint64(4 * _LINE)
# In `_Memory.run`: by reading.
_ACROSS = np.uint64(0)
_DOWN = np.uint64(_RUN)
_WEIGHT = np.uint64(2 * _RUN)
_GAIN = np.uint64(3 * _RUN)
_AWAY2 = np.uint64(4 * _RUN)
# In `_Memory.corners`: of each reading, the pixel to the upper left and so on.
_UPPER_RIGHT = np.uint64(_RUN)
_LOWER_LEFT = np.uint64(2 * _RUN)
_LOWER_RIGHT = np.uint64(3 * _RUN)
# In `_Memory.values`: weights of a run, then its channels.
_READ_1 = np.uint64(_RUN)
_READ_2 = np.uint64(2 * _RUN)
_READ_3 = np.uint64(3 * _RUN)
_READINGS = np.uint64(4 * _RUN)
# In `_Memory.sums` and `_Memory.totals`: weights of a row, then its channels.
_SUM_1 = np.uint64(_LINE)
_SUM_2 = np.uint64(2 * _LINE)
_SUM_3 = np.uint64(3 * _LINE)


class _Memory(NamedTuple):
    """Working memory of one thread. Numba counts references when arrays are taken out of it: not in
    loops over runs.
    """

    # (4 + types, LINE) float32, by column: slope s / D, squared reach, patch size, squared distance
    # of the nearest lens, weights of types
    band: Any
    # (2, m) float32: grid values of the surface between two rows of it, and of the nearer row
    grid: Any
    edge: Any  # (m,) bool: there is a depth edge in the grid cell
    cell: Any  # (SECTION,) int32: grid cell, or entry of the weights, of each column
    # (5, RUN) float32: position between pixels x, y, weight and gain of each reading of a run, and
    # squared distance from the centre of the lens to the scene point
    run: Any
    place: Any  # (RUN,) int32: pixel of the flat that is read
    entry: Any  # (RUN,) int32: entry of the light table
    corners: Any  # (4, RUN): the pixels about each reading
    values: Any  # (runs, 4, RUN) float32: weight and three channels of each reading of all runs
    runs: Any  # (runs, 2) uint64: first column, and number of readings
    sums: Any  # (4, LINE) float32: weights and weighted channels by column
    totals: Any  # likewise, with readings weighted by how well they agree


class _Lens(NamedTuple):
    """A lens, and how it is read in a row."""

    x: Any  # int32: pixel of the flat to the upper left of its centre
    y: Any
    inner_x: Any  # float32: the centre from there on
    inner_y: Any
    first_x: Any  # float32 [px]: from the centre to the column nearest to it
    away_y: Any  # float32 [px]: from the centre to the row
    at_border: Any  # bool: it may be read beside the flat
    table: Any  # int32: first entry of its light table
    share: Any  # uint64: the weights of its type in `_Memory.band`


class _Row(NamedTuple):
    """A section of a row of the picture."""

    column: Any  # int: first column in the picture
    count: Any  # int: number of columns
    y: Any  # float64 [px]: scene coordinate
    reach: Any  # float64 [px]: lenses farther away are not read


class _Reading(NamedTuple):
    """What all lenses of a picture are read by."""

    view_x: Any  # float32 [px] from centres of lenses to the viewpoint
    view_y: Any
    radius2: Any  # float32 [px^2] about the viewpoint, up to which they are read
    per_entry: Any  # float32 [1 / px^2]: entries of the light table
    last_entry: Any  # float32
    step: Any  # float32 [px]: distance of columns
    width: Any  # int32 [px]: of the whole flat
    height: Any
    corner_x: Any  # int32 [px]: of the part of it that is read
    corner_y: Any
    stride: Any  # int32: pixels of a row of the part


@njit
def _allocate(types, cells, runs, packed):
    single = np.float32
    return _Memory(
        np.ones((4 + types) * _LINE, single),
        np.empty((2, cells), single),
        np.empty(cells, np.bool_),
        np.empty(_SECTION, np.int32),
        np.empty(5 * _RUN, single),
        np.empty(_RUN, np.int32),
        np.empty(_RUN, np.int32),
        np.empty(4 * _RUN, packed.dtype),
        np.empty(runs * 4 * _RUN, single),
        np.empty((runs, 2), np.uint64),
        np.empty(4 * _LINE, single),
        np.empty(4 * _LINE, single),
    )


@njit(fastmath=FAST, error_model="numpy")
def _sample_surface(surface, depth, x, y, spacing, count, memory):
    """Fill the sizes of `count` columns from scene point (x, y) on, as `patch_size_at`."""
    sizes = memory.band[_SIZE:]
    cells = memory.cell
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
        cells[k] = min(np.int32(across), last)
        sizes[k] = across - np.float32(cells[k])
    down = min(max((np.float32(y) - depth.y) / depth.spacing, zero), np.float32(rows - 1))
    j = min(int(down), max(rows - 2, 0))
    above = surface[j]
    below = surface[min(j + 1, rows - 1)]
    fy = down - np.float32(j)
    start = cells[0]
    for k in range(cells[count - 1] + 2 - start):
        i = min(start + k, columns - 1)
        right = min(start + k + 1, columns - 1)
        a = above[i]
        b = above[right]
        c = below[i]
        d = below[right]
        level[k] = (one - fy) * a + fy * c
        near[k] = c if fy > half else a
        edge[k] = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) >= depth.edge
    for k in range(count):
        at = np.uint64(np.uint32(cells[k] - start))
        beyond = np.uint64(np.uint32(cells[k] - start + 1))
        fx = sizes[k]
        flat = (one - fx) * level[at] + fx * level[beyond]
        sizes[k] = (near[beyond] if fx > half else near[at]) if edge[at] else flat


@njit(fastmath=FAST, error_model="numpy")
def _fill_band(memory, count, pitch, shares, weighting):
    """Slopes, reach and weights of the lens types for the sizes of `count` columns; returns the
    largest reach.
    """
    band = memory.band
    cells = memory.cell
    slopes = band[:_LINE]
    limits = band[_LIMIT2 : 2 * _LINE]
    sizes = band[_SIZE : 3 * _LINE]
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
    limits[count : count + _RUN] = -1
    slopes[count : count + _RUN] = 0
    last = np.float32(shares.shape[1] - 1)
    if last > 0:
        for k in range(count):
            ratio = (slopes[k] + np.float32(1)) * (np.float32(0.5) * last) + np.float32(0.5)
            cells[k] = np.int32(min(max(ratio, np.float32(0)), last))
        for t in range(len(shares)):
            share = shares[t]
            own = band[(4 + t) * _LINE : (5 + t) * _LINE]
            for k in range(count):
                own[k] = share[np.uint64(np.uint32(cells[k]))]
    return np.float64(np.sqrt(farthest))


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _place_readings(lens, u, column, size, reading, band, run, place, entry):
    """Where the lens is read for `size` columns from `u` of the section on, and with what weight.

    All numbers have 32 bits, of which a register holds most. `column` is the first one, counted
    from the column nearest to the centre of the lens.
    """
    radius2 = reading.radius2
    per_radius2 = np.float32(1) / radius2
    last_x = np.int32(reading.width - 2)
    last_y = np.int32(reading.height - 2)
    end_x = np.float32(reading.width - 1)
    end_y = np.float32(reading.height - 1)
    zero = np.float32(0)
    one = np.float32(1)
    for k in range(size):
        away_x = np.float32(np.int32(np.int32(k) + column)) * reading.step + lens.first_x
        away2 = away_x * away_x + lens.away_y * lens.away_y
        slope = band[_SLOPE + u + k]
        limit2 = band[_LIMIT2 + u + k]
        dx = reading.view_x - away_x * slope
        dy = reading.view_y - lens.away_y * slope
        delta2 = dx * dx + dy * dy
        x = lens.inner_x + dx
        y = lens.inner_y + dy
        whole_x = np.floor(x)
        whole_y = np.floor(y)
        fx = x - whole_x
        fy = y - whole_y
        ix = np.int32(lens.x + np.int32(whole_x))
        iy = np.int32(lens.y + np.int32(whole_y))
        seen = (away2 <= limit2) & (delta2 <= radius2)
        if lens.at_border:
            seen &= (
                (ix >= 0)
                & (iy >= 0)
                & (np.float32(ix) + fx <= end_x)
                & (np.float32(iy) + fy <= end_y)
            )
            fx = one if ix > last_x else fx
            fy = one if iy > last_y else fy
            ix = min(max(ix, np.int32(0)), last_x)
            iy = min(max(iy, np.int32(0)), last_y)
        weight = (RIM - max(away2 / limit2, delta2 * per_radius2)) * band[lens.share + u + k]
        run[_ACROSS + k] = fx
        run[_DOWN + k] = fy
        run[_WEIGHT + k] = weight if seen else zero
        run[_AWAY2 + k] = away2
        row = np.int32(np.int32(iy - reading.corner_y) * reading.stride)
        pixel = np.int32(row + np.int32(ix - reading.corner_x))
        place[k] = pixel if seen else np.int32(0)
        of_light = min(delta2 * reading.per_entry, reading.last_entry)
        entry[k] = np.int32(np.int32(of_light) + lens.table)


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _weigh_by_light(size, run, entry, table, applied):
    """Weights by the squared light of the readings, and the gains that are applied."""
    one = np.float32(1)
    for k in range(size):
        run[_GAIN + k] = table[np.uint64(np.uint32(entry[k]))]
    for k in range(size):
        gain = run[_GAIN + k]
        run[_WEIGHT + k] /= gain * gain
        run[_GAIN + k] = one + applied * (gain - one)


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _weigh_by_depth(u, size, run, place, band, shown, stride, apart):
    """Hardly count readings of pixels that show another depth than the surface has."""
    half = np.float32(0.5)
    for k in range(size):
        at = np.uint64(np.uint32(place[k])) + np.uint64(run[_ACROSS + k] >= half)
        at += np.uint64(run[_DOWN + k] >= half) * stride
        if abs(shown[at] - band[_SIZE + u + k]) > apart:
            run[_WEIGHT + k] *= OCCLUDED
            run[_AWAY2 + k] += band[_LIMIT2 + u + k]


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _keep_nearest(u, size, run, band, sums):
    """Count the readings of lenses nearer than all before, in place of those."""
    for k in range(size):
        if run[_WEIGHT + k] > 0 and run[_AWAY2 + k] < band[_NEAREST2 + u + k]:
            band[_NEAREST2 + u + k] = run[_AWAY2 + k]
            run[_WEIGHT + k] = 1
            sums[u + k] = 0
            sums[_SUM_1 + u + k] = 0
            sums[_SUM_2 + u + k] = 0
            sums[_SUM_3 + u + k] = 0
        else:
            run[_WEIGHT + k] = 0


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _interpolate(a, b, c, d, lowest, w00, w01, w10, w11):
    """Weighted sum of the `lowest` bits of four pixels."""
    upper = w00 * np.float32(np.int32(a & lowest)) + w01 * np.float32(np.int32(b & lowest))
    return upper + (w10 * np.float32(np.int32(c & lowest)) + w11 * np.float32(np.int32(d & lowest)))


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _read_pixels(u, size, line, stride, run, place, corners, values, into, sums):
    """Interpolate the flat, and add the readings to the sums of their columns."""
    for k in range(size):
        at = np.uint64(np.uint32(place[k]))
        corners[k] = line[at]
        corners[_UPPER_RIGHT + k] = line[at + np.uint64(1)]
        corners[_LOWER_LEFT + k] = line[at + stride]
        corners[_LOWER_RIGHT + k] = line[at + stride + np.uint64(1)]
    kind = line.dtype.type
    bits = kind(2 * line.itemsize)
    lowest = (kind(1) << bits) - kind(1)
    one = np.float32(1)
    for k in range(size):
        fx = run[_ACROSS + k]
        fy = run[_DOWN + k]
        gain = run[_GAIN + k]
        weight = run[_WEIGHT + k]
        gx = gain * fx
        w01 = gx * (one - fy)
        w11 = gx * fy
        w00 = gain * (one - fy) - w01
        w10 = gain * fy - w11
        a = corners[k]
        b = corners[_UPPER_RIGHT + k]
        c = corners[_LOWER_LEFT + k]
        d = corners[_LOWER_RIGHT + k]
        first = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        a = a >> bits
        b = b >> bits
        c = c >> bits
        d = d >> bits
        second = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        a = a >> bits
        b = b >> bits
        c = c >> bits
        d = d >> bits
        third = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        values[into + k] = weight
        values[into + _READ_1 + k] = first
        values[into + _READ_2 + k] = second
        values[into + _READ_3 + k] = third
        sums[u + k] += weight
        sums[_SUM_1 + u + k] += weight * first
        sums[_SUM_2 + u + k] += weight * second
        sums[_SUM_3 + u + k] += weight * third


@njit(fastmath=FAST, error_model="numpy")
def _read_lenses(memory, flat, light, lenses, edge, weighting, grid, row):
    """Add up the readings of all lenses in reach of a row; returns the number of runs."""
    column, count, y, reach = row
    band = memory.band
    run = memory.run
    place = memory.place
    entry = memory.entry
    corners = memory.corners
    values = memory.values
    sums = memory.sums
    runs = memory.runs
    line = flat.pixels.reshape(-1)
    shown = flat.depth.reshape(-1)
    table = light.gains.reshape(-1)
    entries = light.gains.shape[1]
    width = flat.size[0]
    height = flat.size[1]
    stride = np.uint64(flat.pixels.shape[1])
    reading = _Reading(
        weighting.viewpoint[0],
        weighting.viewpoint[1],
        weighting.viewpoint[2],
        np.float32(1) / light.step,
        np.float32(entries - 1),
        np.float32(grid.spacing),
        np.int32(width),
        np.int32(height),
        np.int32(flat.corner[0]),
        np.int32(flat.corner[1]),
        np.int32(stride),
    )
    aside2 = reading.view_x * reading.view_x + reading.view_y * reading.view_y
    inner = np.sqrt(reading.radius2) + np.sqrt(aside2) + 2
    first = grid.first[0]
    spacing = grid.spacing
    per_spacing = 1 / spacing
    apart = np.float32(2) * edge
    centres = lenses.centres
    tables = lenses.tables
    types = lenses.types
    edged = lenses.edged
    number = np.uint64(0)
    for index in range(
        np.searchsorted(centres[:, 1], y - reach), np.searchsorted(centres[:, 1], y + reach)
    ):
        cx = centres[index, 0]
        cy = centres[index, 1]
        wide = np.sqrt(max(reach * reach - (y - cy) * (y - cy), 0.0))
        first_u = max(int(np.ceil((cx - wide - first) * per_spacing)) - column, 0)
        end_u = min(int(np.floor((cx + wide - first) * per_spacing)) + 1 - column, count)
        # Counted from the pixel nearest to the centre, whatever part of the picture is drawn.
        anchor = int(np.rint((cx - first) * per_spacing))
        x = np.floor(cx)
        above = np.floor(cy)
        lens = _Lens(
            np.int32(x),
            np.int32(above),
            np.float32(cx - x),
            np.float32(cy - above),
            np.float32(first + anchor * spacing - cx),
            np.float32(y - cy),
            not (inner <= cx <= width - 1 - inner and inner <= cy <= height - 1 - inner),
            np.int32(tables[index] * entries),
            _SHARES + np.uint64(types[index] * _LINE),
        )
        for begin in range(first_u, end_u, _RUN):
            u = np.uint64(begin)
            groups = max((min(end_u - begin, _RUN) + _GROUP - 1) // _GROUP, 2)
            size = np.uint64(groups) * np.uint64(_GROUP)
            offset = np.int32(column + begin - anchor)
            _place_readings(lens, u, offset, size, reading, band, run, place, entry)
            _weigh_by_light(size, run, entry, table, light.applied)
            if edged[index]:
                _weigh_by_depth(u, size, run, place, band, shown, stride, apart)
            if weighting.tolerance <= 0:
                _keep_nearest(u, size, run, band, sums)
            _read_pixels(
                u, size, line, stride, run, place, corners, values, number * _READINGS, sums
            )
            runs[number, 0] = u
            runs[number, 1] = size
            number += np.uint64(1)
    return number


@njit(fastmath=FAST, error_model="numpy")
def _normalise(sums, count):
    """Divide the weighted `sums` of `count` columns by their weights."""
    for k in range(np.uint64(count)):
        inverse = np.float32(1) / (sums[k] if sums[k] > 0 else np.float32(1))
        sums[_SUM_1 + k] *= inverse
        sums[_SUM_2 + k] *= inverse
        sums[_SUM_3 + k] *= inverse


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
        u = runs[n, 0]
        at = n * _READINGS
        for k in range(runs[n, 1]):
            first = values[at + _READ_1 + k]
            second = values[at + _READ_2 + k]
            third = values[at + _READ_3 + k]
            apart_1 = first - means[_SUM_1 + u + k]
            apart_2 = second - means[_SUM_2 + u + k]
            apart_3 = third - means[_SUM_3 + u + k]
            apart2 = (apart_1 * apart_1 + apart_2 * apart_2 + apart_3 * apart_3) * per_channel
            agree = t2 / (t2 + apart2)
            weight = values[at + k] * agree * agree
            totals[u + k] += weight
            totals[_SUM_1 + u + k] += weight * first
            totals[_SUM_2 + u + k] += weight * second
            totals[_SUM_3 + u + k] += weight * third


@kernel(error_model="numpy", share=lambda *given: len(given[7].image))
def blend_rows(begin, end, flat, light, lenses, surface, depth, grid, weighting, output):
    """Draw as `blend_pixels`, from packed pixels (`pack_flat`); those that need several samples are
    left to that kernel.
    """
    image = output.image
    valid = output.valid
    left = output.left
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
    totals = memory.totals if t2 > 0 else memory.sums
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
            memory.band[_NEAREST2:_SHARES] = np.inf
            row = _Row(column, count, y, reach)
            number = _read_lenses(memory, flat, light, lenses, depth.edge, weighting, grid, row)
            _normalise(memory.sums, count)
            if t2 > 0:
                _add_agreeing(memory, number, t2, per_channel)
                _normalise(totals, count)
            sizes = memory.band[_SIZE:]
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
