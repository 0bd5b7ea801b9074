"""Runs of pixels that one lens shows in a band of rows: where the lens is read for them, and what it adds.

The pixels of a band of `ROWS` rows lie column by column in memory, so that one lens shows a contiguous run of them,
which vector instructions work on (`blend_rows`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ..settings import WEIGHTS

__all__ = [
    "COLUMNS", "FOURTH", "LANES", "LINE", "PER_RUN", "QUEUE", "ROWS", "SECOND", "SECTION", "THIRD", "Band", "Buffers",
    "SortedLenses", "Source", "add_agreeing", "count_pixels", "read_lenses",
]  # fmt: skip

# A vector register of single precision holds a group of pixels: so many rows, and columns of them.
ROWS = 4
COLUMNS = 2
_GROUP = ROWS * COLUMNS
# Pixels that are worked on together at most, in whole groups; fewer than two groups no compiler turns into vectors.
LANES = 96
_FEWEST = 2
# Columns of a picture that are blended together, so that places of the buffers lie a known way apart. All counts and
# places are unsigned: signed ones are checked for being counted from the end.
SECTION = 512
LINE = ROWS * SECTION + 2 * LANES
SECOND = np.uint64(LINE)
THIRD = np.uint64(2 * LINE)
FOURTH = np.uint64(3 * LINE)
# Runs whose places are found before the first of them is read.
QUEUE = 3
# Where the second, third and fourth value of all pixels of a run begin.
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_F = np.uint64(LANES)
_W = np.uint64(2 * LANES)
_THREE = np.uint64(3 * LANES)
# Where the next run begins in buffers of two, three and four values per pixel.
_BOTH = _W
_WORK = _THREE
PER_RUN = np.uint64(4 * LANES)


class SortedLenses(NamedTuple):
    """The lenses by y."""

    centres: Any  # (n, 2) float64 [px]
    types: Any  # (n,) int64: 0 if all are alike
    tables: Any  # (n,) int64: light table of each
    edged: Any  # (n,) bool: `Flat.depth` is set on their pixels
    shares: Any  # (types, r) float32: weight of a type over s / D from -1 to 1
    radius: Any  # float32 [px]
    pitch: Any  # float32 [px]


class Source(NamedTuple):
    """What lenses are read from."""

    line: Any  # (h w words,) uint32: packed pixels of the flat
    depth: Any  # (h w,) float32 [px]: patch size that each pixel shows
    stride: Any  # uint64: pixels from a row to the next
    words: Any  # uint64: 1, or 2 for pixels of 16 bits a channel
    corner: Any  # (2,) int [px]: flat coordinates of the first pixel
    size: Any  # (2,) int [px]: of the whole flat
    lights: Any  # (t k,) uint64: gain and weight, two float32, over the squared distance from the lens centre
    rings: Any  # entries `k` of one light table
    light_step: Any  # [px^2]
    lenses: SortedLenses
    edge: Any  # patch sizes that differ by less belong to one surface [px]
    reach: Any  # [px]


class Band(NamedTuple):
    """Scene points of the pixels of a band, in the order of memory."""

    column: Any  # (LINE,) int32
    row: Any  # (LANES,) int32
    slope: Any  # (LINE,) float32: s / D
    limit2: Any  # (LINE,) float32: squared distance up to which lenses show it [px^2]
    size: Any  # (LINE,) float32: patch size [px]
    share: Any  # (types LINE,) float32: weight of each lens type


class Buffers(NamedTuple):
    """Memory of one thread for runs of pixels."""

    work: Any  # float32: position between pixels fx, fy and weight of each reading
    place: Any  # int32: pixel of the flat and entry of the light table of each reading
    corners: Any  # uint32: the four packed pixels about each reading
    corner_pairs: Any  # uint64: the same memory, two pixels of one word or one of two at a time
    light: Any  # float32: gain and weight of each reading
    light_pairs: Any  # the same memory, two at a time
    values: Any  # float32: weight and three channels of each reading
    runs: Any  # (runs, 3) int64: first pixel, whether the lens is `edged`, groups
    ranges: Any  # (2, n) int32: first and last column of each lens
    sums: Any  # (4 LINE,) float32: weights and weighted channels of each pixel


class _Flat(NamedTuple):
    """Size of the flat and of its part."""

    width: Any  # int32 [px]
    height: Any
    corner_x: Any  # int32 [px]
    corner_y: Any
    stride: Any  # uint64: pixels from a row to the next
    words: Any  # uint64: 1, or 2 for pixels of 16 bits a channel
    edge: Any  # patch sizes that differ by less belong to one surface [px]
    last_entry: Any  # float32: of a light table


# Numba counts references each time that an array is taken out of a tuple. Functions that run for every run of pixels
# hence take arrays one by one.


class _Lens(NamedTuple):
    """A lens relative to a band."""

    n_x: Any  # int32: column and row of the band's first pixel, from the pixel nearest to the centre
    n_y: Any
    e_x: Any  # float32 [px]: that pixel less the centre
    e_y: Any
    at_x: Any  # int32: the centre, whole pixels
    at_y: Any
    inner_x: Any  # float32 [px]: the rest of it
    inner_y: Any
    type_at: Any  # where the shares of its type begin
    light_at: Any  # int32: where its light table begins
    border: Any  # it may reach beyond the border of the flat


@njit(inline="always")
def count_pixels(groups):
    """Pixels of so many groups."""
    return np.uint64(groups) * np.uint64(_GROUP)


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _place(columns, rows, slope, limits, share, lens, flat, spacing, per_light_step, u, lanes, work, whole, at):
    """Where some pixels from `u` on read a lens, and with which weight.

    Leaves the position between pixels and the weight in `work`, and in `whole` the pixel of the flat and the entry of
    the light table. All numbers are of 32 bits: integer sums would be of 64, half as many at a time.
    """
    n_x, n_y, e_x, e_y, at_x, at_y = lens.n_x, lens.n_y, lens.e_x, lens.e_y, lens.at_x, lens.at_y
    inner_x, inner_y, type_at, border = lens.inner_x, lens.inner_y, lens.type_at, lens.border
    light_at = lens.light_at
    width, height, stride, last_entry = flat.width, flat.height, np.int32(flat.stride), flat.last_entry
    corner_x, corner_y = flat.corner_x, flat.corner_y
    last_x, last_y = np.int32(width - 2), np.int32(height - 2)
    end_x, end_y = np.float32(width - 1), np.float32(height - 1)
    for k in range(lanes):
        ex = np.float32(np.int32(n_x + columns[u + k])) * spacing + e_x
        ey = np.float32(np.int32(n_y + rows[k])) * spacing + e_y
        d2 = ex * ex + ey * ey
        tilt = slope[u + k]
        rx, ry = inner_x - ex * tilt, inner_y - ey * tilt
        step_x, step_y = np.floor(rx), np.floor(ry)
        fx, fy = rx - step_x, ry - step_y
        ix, iy = np.int32(at_x + np.int32(step_x)), np.int32(at_y + np.int32(step_y))
        limit = limits[u + k]
        ok = d2 <= limit
        if border:
            ok &= (ix >= 0) & (iy >= 0) & (np.float32(ix) + fx <= end_x) & (np.float32(iy) + fy <= end_y)
            fx = np.float32(1.0) if ix > last_x else fx
            fy = np.float32(1.0) if iy > last_y else fy
            ix, iy = min(max(ix, np.int32(0)), last_x), min(max(iy, np.int32(0)), last_y)
        weight = (WEIGHTS.rim - d2 / limit) * share[type_at + u + k]
        work[at + k] = fx
        work[at + _F + k] = fy
        work[at + _W + k] = weight if ok else np.float32(0.0)
        place = np.int32(np.int32(np.int32(iy - corner_y) * stride) + np.int32(ix - corner_x))
        whole[at + k] = place if ok else np.int32(0)
        whole[at + _F + k] = np.int32(np.int32(min(d2 * tilt * tilt * per_light_step, last_entry)) + light_at)


@njit(inline="always")
def _two_at(line, place):
    """The two numbers of four bytes from a place on, the first in the lower half."""
    return np.uint64(line[place]) | (np.uint64(line[place + _ONE]) << np.uint64(32))


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _fetch(line, words, down, lights, whole, pairs, light_pairs, q, lanes):
    """The four pixels about each place, two by two where they have one word, and the gain and weight of its light."""
    at, corners_at, pair_at, light_at = q * _WORK, q * PER_RUN, q * _BOTH, q * _F
    for k in range(lanes):
        pixel = np.uint64(np.uint32(whole[at + k]))
        entry = np.uint64(np.uint32(whole[at + _F + k]))
        if words == _ONE:
            pairs[pair_at + k] = _two_at(line, pixel)
            pairs[pair_at + _F + k] = _two_at(line, pixel + down)
        else:
            pixel += pixel
            pairs[corners_at + k + k] = _two_at(line, pixel)
            pairs[corners_at + _ONE + k + k] = _two_at(line, pixel + _TWO)
            pixel += down + down
            pairs[corners_at + _BOTH + k + k] = _two_at(line, pixel)
            pairs[corners_at + _BOTH + _ONE + k + k] = _two_at(line, pixel + _TWO)
        light_pairs[light_at + k] = lights[entry]


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _interpolate(a, b, c, d, lowest, w00, w01, w10, w11):
    """Weighted sum of the `lowest` bits of four pixels."""
    upper = w00 * np.float32(np.int32(a & lowest)) + w01 * np.float32(np.int32(b & lowest))
    return upper + (w10 * np.float32(np.int32(c & lowest)) + w11 * np.float32(np.int32(d & lowest)))


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _add(corners, light, work, values, sums, q, base, u, lanes):
    """Interpolate some readings, keep them in `values` from `base` on, and add them to the sums of their pixels."""
    corners_at, light_at, at = q * PER_RUN, q * _BOTH, q * _WORK
    bits = corners.dtype.type(2 * corners.itemsize)
    lowest = (corners.dtype.type(1) << bits) - corners.dtype.type(1)
    for k in range(lanes):
        fx, fy, gain = work[at + k], work[at + _F + k], light[light_at + k + k]
        weight = work[at + _W + k] * light[light_at + _ONE + k + k]
        gx, gy = gain * fx, np.float32(1.0) - fy
        w01, w11 = gx * gy, gx * fy
        w00, w10 = gain * gy - w01, gain * fy - w11
        a, b = corners[corners_at + k + k], corners[corners_at + _ONE + k + k]
        c, d = corners[corners_at + _BOTH + k + k], corners[corners_at + _BOTH + _ONE + k + k]
        v0 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        a, b, c, d = a >> bits, b >> bits, c >> bits, d >> bits
        v1 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        a, b, c, d = a >> bits, b >> bits, c >> bits, d >> bits
        v2 = _interpolate(a, b, c, d, lowest, w00, w01, w10, w11)
        values[base + k] = weight
        values[base + _F + k] = v0
        values[base + _W + k] = v1
        values[base + _THREE + k] = v2
        sums[u + k] += weight
        sums[SECOND + u + k] += weight * v0
        sums[THIRD + u + k] += weight * v1
        sums[FOURTH + u + k] += weight * v2


@njit(fastmath=FAST, error_model="numpy", inline="always")
def add_agreeing(values, base, means, u, lanes, t2, per_channel, totals):
    """Add readings to the `totals` of their pixels, weighted by how close they are to the `means` (Geman-McClure)."""
    for k in range(lanes):
        v0, v1, v2 = values[base + _F + k], values[base + _W + k], values[base + _THREE + k]
        e0, e1, e2 = v0 - means[SECOND + u + k], v1 - means[THIRD + u + k], v2 - means[FOURTH + u + k]
        agree = t2 / (t2 + (e0 * e0 + e1 * e1 + e2 * e2) * per_channel)
        weight = values[base + k] * agree * agree
        totals[u + k] += weight
        totals[SECOND + u + k] += weight * v0
        totals[THIRD + u + k] += weight * v1
        totals[FOURTH + u + k] += weight * v2


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _reduce_occluded(depth, edge, stride, sizes, u, whole, at, lanes, work):
    """Reduce the weight of readings whose nearest pixel shows another depth; leaves that pixel in `whole`."""
    half = np.float32(0.5)
    for k in range(lanes):
        right = np.int32(1) if work[at + k] >= half else np.int32(0)
        below = stride if work[at + _F + k] >= half else np.int32(0)
        whole[at + k] = np.int32(np.int32(whole[at + k] + right) + below)
    for k in range(lanes):
        shown = depth[np.uint64(np.uint32(whole[at + k]))]
        # Without a branch, which could not be predicted.
        occluded = abs(shown - sizes[u + k]) > np.float32(2.0) * edge
        work[at + _W + k] *= WEIGHTS.occluded if occluded else np.float32(1.0)


@njit(fastmath=FAST, error_model="numpy")
def _read_queue(
    line, depth, lights, flat, sizes, runs, begin, end, work, whole, corners, pairs, light, light_pairs, values, sums
):  # fmt: skip
    """Read the runs from `begin` to `end`, whose places are found.

    One loop over all of them for each step: values that were stored one by one cannot be loaded as vectors at once.
    """
    for n in range(begin, end):
        _fetch(
            line, flat.words, flat.stride, lights, whole, pairs, light_pairs, np.uint64(n % QUEUE),
            count_pixels(runs[n, 2]),
        )  # fmt: skip
    for n in range(begin, end):
        if runs[n, 1]:
            _reduce_occluded(
                depth, flat.edge, np.int32(flat.stride), sizes, np.uint64(runs[n, 0]), whole,
                np.uint64(n % QUEUE) * _WORK, count_pixels(runs[n, 2]), work,
            )  # fmt: skip
    for n in range(begin, end):
        q, u, lanes = np.uint64(n % QUEUE), np.uint64(runs[n, 0]), count_pixels(runs[n, 2])
        if flat.words == _ONE:
            _add(corners, light, work, values, sums, q, np.uint64(n) * PER_RUN, u, lanes)
        else:
            _add(pairs, light, work, values, sums, q, np.uint64(n) * PER_RUN, u, lanes)


@njit(fastmath=FAST, error_model="numpy")
def _find_columns(centres, lowest, highest, x, top, bottom, spacing, column, reach, count, ranges):
    """Fill `ranges` with the first column that each lens shows from `top` to `bottom`, and the one after the last."""
    per_spacing, first, end = 1 / spacing, np.int32(column), np.int32(count)
    for n in range(np.uint64(highest - lowest)):
        lens = np.uint64(lowest) + n
        across, cy = centres[lens, 0] - x, centres[lens, 1]
        ey = max(max(top - cy, cy - bottom), 0.0)
        wide = np.sqrt(max(reach * reach - ey * ey, 0.0))
        ranges[0, n] = max(np.int32(np.ceil((across - wide) * per_spacing)) - first, np.int32(0))
        ranges[1, n] = min(np.int32(np.floor((across + wide) * per_spacing)) + np.int32(1) - first, end)


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _locate_lens(lenses, lens, flat, first, row, column, spacing):
    """Place of a lens relative to a band, counted from the first pixel of the picture, whatever part is drawn."""
    cx, cy, radius = lenses.centres[lens, 0], lenses.centres[lens, 1], lenses.radius
    per_spacing = 1 / spacing
    anchor_x = int(np.rint((cx - first[0]) * per_spacing))
    anchor_y = int(np.rint((cy - first[1]) * per_spacing))
    at_x, at_y = np.floor(cx), np.floor(cy)
    # Interpolation reads two pixels beyond a place at most.
    low, high_x, high_y = radius + 2, flat.width - 3 - radius, flat.height - 3 - radius
    return _Lens(
        np.int32(column - anchor_x), np.int32(row - anchor_y), np.float32(first[0] + anchor_x * spacing - cx),
        np.float32(first[1] + anchor_y * spacing - cy), np.int32(at_x), np.int32(at_y), np.float32(cx - at_x),
        np.float32(cy - at_y), np.uint64(lenses.types[lens]) * np.uint64(LINE),
        np.int32(lenses.tables[lens] * (np.int64(flat.last_entry) + 1)),
        not (low <= cx <= high_x and low <= cy <= high_y),
    )  # fmt: skip


@njit(fastmath=FAST, error_model="numpy")
def read_lenses(source, band, lowest, highest, first, row, column, spacing, count, before, buffers):
    """Add up the readings of the lenses `lowest` to `highest` in a part of a band; returns the number of runs.

    `row` and `column` are those of its first pixel in the picture, whose pixel (0, 0) lies at `first`; `before` counts
    the groups of columns that are drawn before each of its `count` columns.
    """
    line, depth, lights, stride, words = source.line, source.depth, source.lights, source.stride, source.words
    centres, edged = source.lenses.centres, source.lenses.edged
    columns, rows, slope, limits, share = band.column, band.row, band.slope, band.limit2, band.share
    work, whole, corners, pairs = buffers.work, buffers.place, buffers.corners, buffers.corner_pairs
    light, light_pairs, values, sums = buffers.light, buffers.light_pairs, buffers.values, buffers.sums
    sizes, runs, ranges = band.size, buffers.runs, buffers.ranges
    flat = _Flat(
        np.int32(source.size[0]), np.int32(source.size[1]), np.int32(source.corner[0]), np.int32(source.corner[1]),
        stride, words, source.edge, np.float32(source.rings - 1),
    )  # fmt: skip
    step, per_light_step = np.float32(spacing), np.float32(1 / source.light_step)
    # Integers that are not known to be 0, which would be other types.
    found = done = np.int64(0)
    top, bottom = first[1] + row * spacing, first[1] + (row + ROWS - 1) * spacing
    _find_columns(
        centres, lowest, highest, first[0], top, bottom, spacing, column, source.reach, count, ranges
    )  # fmt: skip
    for number in range(lowest, highest):
        begin, end = ranges[0, number - lowest], ranges[1, number - lowest]
        if begin >= end:
            continue
        lens = _locate_lens(source.lenses, number, flat, first, row, column, spacing)
        end = _GROUP * before[(end + COLUMNS - 1) // COLUMNS]
        for u in range(_GROUP * before[begin // COLUMNS], end, LANES):
            if found == done + QUEUE:
                _read_queue(
                    line, depth, lights, flat, sizes, runs, done, found, work, whole, corners, pairs, light,
                    light_pairs, values, sums,
                )  # fmt: skip
                done = found
            runs[found, 0], runs[found, 1] = u, edged[number]
            runs[found, 2] = max((min(u + LANES, end) - u) // _GROUP, _FEWEST)
            at, lanes = np.uint64(found % QUEUE) * _WORK, count_pixels(runs[found, 2])
            _place(
                columns, rows, slope, limits, share, lens, flat, step, per_light_step, np.uint64(u), lanes, work, whole,
                at,
            )  # fmt: skip
            found += 1
    _read_queue(
        line, depth, lights, flat, sizes, runs, done, found, work, whole, corners, pairs, light, light_pairs, values,
        sums,
    )  # fmt: skip
    return found
