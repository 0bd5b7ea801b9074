"""Runs of pixels that one lens shows in some rows of a picture: where they are read, and what they add.

A few rows lie column by column in memory, so that a lens shows one run of pixels, which take the same steps, as vector
instructions want it (`row_blending`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ..runtime.intrinsics import prefetch, two_at
from .blend_pixels import OCCLUDED_WEIGHT

__all__ = [
    "ACROSS", "FOURTH", "LANES", "LINE", "PER_RUN", "QUEUE", "ROWS", "SECOND", "SECTION", "THIRD", "agree",
    "lay_lenses", "whole_groups",
]  # fmt: skip

# So many rows, and columns of them, are a group of pixels, one vector register of single precision. So many pixels are
# worked on together at most, in whole groups, and not fewer of these than the last number, or no compiler takes them
# together. Counts and places are unsigned: signed ones are looked at for being counted from the end.
ROWS, _GROUP, LANES, _FEWEST = 4, 8, 96, 2
ACROSS = _GROUP // ROWS
#: Columns of a picture that are blended at once, so that places of the buffers lie a known way apart.
SECTION = 512
LINE = ROWS * SECTION + 2 * LANES
SECOND, THIRD, FOURTH = np.uint64(LINE), np.uint64(2 * LINE), np.uint64(3 * LINE)
# Runs whose places are found before the first of them is read, and after how many pixels of a run memory is asked for.
QUEUE, _AHEAD = 3, np.uint64(16)
# Weight of a lens at the rim of its reach.
_RIM = np.float32(1.02)
# Where the second, third and fourth value of all pixels of a run begin, and what belongs to the next run.
_ONE, _F, _W, _THREE = np.uint64(1), np.uint64(LANES), np.uint64(2 * LANES), np.uint64(3 * LANES)
_BOTH, _WORK, PER_RUN = np.uint64(2 * LANES), np.uint64(3 * LANES), np.uint64(4 * LANES)


@njit(cache=True, nogil=True, inline="always")
def whole_groups(groups):
    """Pixels of so many groups."""
    return np.uint64(groups) * np.uint64(_GROUP)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _place(
    columns, rows, n_x, n_y, e_x, e_y, spacing, inner_x, inner_y, at_x, at_y, slope, limits, share, u, kind, border,
    width, height, stride, corner_x, corner_y, per_light_step, last_ring, lanes, work, whole, at,
):  # fmt: skip
    """Where some pixels read a lens, which may reach beyond the `border` of the flat, and how much that counts.

    Leaves the parts of a pixel and the weight in `work`, and in `whole` the pixel of the flat and the place in the
    light table. All numbers are of 32 bits: sums of whole ones would be of 64, half as many at a time.
    """
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
        weight = (_RIM - d2 / limit) * share[kind + u + k]
        work[at + k] = fx
        work[at + _F + k] = fy
        work[at + _W + k] = weight if ok else np.float32(0.0)
        place = np.int32(np.int32(np.int32(iy - corner_y) * stride) + np.int32(ix - corner_x))
        whole[at + k] = place if ok else np.int32(0)
        whole[at + _F + k] = np.int32(min(d2 * tilt * tilt * per_light_step, last_ring))


@njit(cache=True, nogil=True, inline="always")
def _ask_for(line, down, whole, at, lanes):
    """Have the memory fetched that some pixels are read from soon: lenses lie at too odd steps to be foreseen."""
    for first in range(np.uint64(0), lanes, _AHEAD):
        for k in range(first, first + np.uint64(ROWS)):
            prefetch(line, np.uint64(np.uint32(whole[at + k])))
        prefetch(line, np.uint64(np.uint32(whole[at + first + np.uint64(ROWS - 1)])) + down)
    for k in range(lanes - np.uint64(ROWS), lanes):
        prefetch(line, np.uint64(np.uint32(whole[at + k])))


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _fetch(line, down, whole, at, lanes, glow, quads, quads_at, pairs, pair_at, lamps, lamp_at):
    """The four pixels about each place, two by two where `pairs` are two of the `quads`, and what multiplies them."""
    for k in range(lanes):
        pixel = np.uint64(np.uint32(whole[at + k]))
        ring = np.uint64(np.uint32(whole[at + _F + k]))
        if len(pairs) < len(quads):
            pairs[pair_at + k] = two_at(line, pixel)
            pairs[pair_at + _F + k] = two_at(line, pixel + down)
        else:
            quads[quads_at + k + k], quads[quads_at + _ONE + k + k] = line[pixel], line[pixel + _ONE]
            pixel += down
            quads[quads_at + _BOTH + k + k], quads[quads_at + _BOTH + _ONE + k + k] = line[pixel], line[pixel + _ONE]
        lamps[lamp_at + k] = glow[ring]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _between(a, b, c, d, lowest, w00, w01, w10, w11):
    """Weighted sum of the `lowest` bits of four pixels."""
    upper = w00 * np.float32(np.int32(a & lowest)) + w01 * np.float32(np.int32(b & lowest))
    return upper + (w10 * np.float32(np.int32(c & lowest)) + w11 * np.float32(np.int32(d & lowest)))


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _add(quads, quads_at, lamps, lamp_at, work, at, values, base, sums, u, lanes):
    """Values of some readings, kept in `values`, and added to the `sums` of their pixels."""
    bits = quads.dtype.type(2 * quads.itemsize)
    lowest = (quads.dtype.type(1) << bits) - quads.dtype.type(1)
    for k in range(lanes):
        fx, fy, gain = work[at + k], work[at + _F + k], lamps[lamp_at + k + k]
        weight = work[at + _W + k] * lamps[lamp_at + _ONE + k + k]
        gx, gy = gain * fx, np.float32(1.0) - fy
        w01, w11 = gx * gy, gx * fy
        w00, w10 = gain * gy - w01, gain * fy - w11
        a, b = quads[quads_at + k + k], quads[quads_at + _ONE + k + k]
        c, d = quads[quads_at + _BOTH + k + k], quads[quads_at + _BOTH + _ONE + k + k]
        v0 = _between(a, b, c, d, lowest, w00, w01, w10, w11)
        a, b, c, d = a >> bits, b >> bits, c >> bits, d >> bits
        v1 = _between(a, b, c, d, lowest, w00, w01, w10, w11)
        a, b, c, d = a >> bits, b >> bits, c >> bits, d >> bits
        v2 = _between(a, b, c, d, lowest, w00, w01, w10, w11)
        values[base + k] = weight
        values[base + _F + k] = v0
        values[base + _W + k] = v1
        values[base + _THREE + k] = v2
        sums[u + k] += weight
        sums[SECOND + u + k] += weight * v0
        sums[THIRD + u + k] += weight * v1
        sums[FOURTH + u + k] += weight * v2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def agree(values, base, sums, u, lanes, t2, per_channel, totals):
    """Add readings to the `totals` of their pixels as far as they agree with the means in `sums`."""
    for k in range(lanes):
        v0, v1, v2 = values[base + _F + k], values[base + _W + k], values[base + _THREE + k]
        e0, e1, e2 = v0 - sums[SECOND + u + k], v1 - sums[THIRD + u + k], v2 - sums[FOURTH + u + k]
        agree = t2 / (t2 + (e0 * e0 + e1 * e1 + e2 * e2) * per_channel)
        weight = values[base + k] * agree * agree
        totals[u + k] += weight
        totals[SECOND + u + k] += weight * v0
        totals[THIRD + u + k] += weight * v1
        totals[FOURTH + u + k] += weight * v2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _hide(seen, edge, stride, sizes, u, whole, at, lanes, work):
    """Take the weight from readings whose nearest pixel sees another depth. Leaves that pixel in `whole`."""
    half = np.float32(0.5)
    for k in range(lanes):
        right = np.int32(1) if work[at + k] >= half else np.int32(0)
        below = stride if work[at + _F + k] >= half else np.int32(0)
        whole[at + k] = np.int32(np.int32(whole[at + k] + right) + below)
    for k in range(lanes):
        depth = seen[np.uint64(np.uint32(whole[at + k]))]
        # A branch that cannot be foretold would cost more.
        work[at + _W + k] *= OCCLUDED_WEIGHT if abs(depth - sizes[u + k]) > np.float32(2.0) * edge else np.float32(1.0)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _read_queue(
    line, seen, glow, edge, stride, sizes, runs, begin, end, work, whole, quads, pairs, lamps, lamp_pairs, values, sums
):  # fmt: skip
    """Read the runs from `begin` to `end`, whose places are found.

    Loops over several of them: what is written by single values cannot be read as vectors at once.
    """
    for n in range(begin, end):
        q, lanes = np.uint64(n % QUEUE), whole_groups(runs[n, 2])
        _fetch(
            line, stride, whole, q * _WORK, lanes, glow, quads, q * PER_RUN, pairs, q * _BOTH, lamp_pairs, q * _F
        )  # fmt: skip
    for n in range(begin, end):
        q = np.uint64(n % QUEUE)
        if runs[n, 1]:
            lanes = whole_groups(runs[n, 2])
            _hide(seen, edge, np.int32(stride), sizes, np.uint64(runs[n, 0]), whole, q * _WORK, lanes, work)
    for n in range(begin, end):
        q, lanes = np.uint64(n % QUEUE), whole_groups(runs[n, 2])
        _add(
            quads, q * PER_RUN, lamps, q * _BOTH, work, q * _WORK, values, np.uint64(n) * PER_RUN, sums,
            np.uint64(runs[n, 0]), lanes,
        )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _columns_of(centres, lowest, highest, x, top, bottom, spacing, column, reach, count, ranges):
    """Fill `ranges` (2, n) with the first column, and the one beyond the last, of what some lenses show in a band."""
    per_spacing, first, end = 1 / spacing, np.int32(column), np.int32(count)
    for n in range(np.uint64(highest - lowest)):
        lens = np.uint64(lowest) + n
        across, cy = centres[lens, 0] - x, centres[lens, 1]
        ey = max(max(top - cy, cy - bottom), 0.0)
        wide = np.sqrt(max(reach * reach - ey * ey, 0.0))
        ranges[0, n] = max(np.int32(np.ceil((across - wide) * per_spacing)) - first, np.int32(0))
        ranges[1, n] = min(np.int32(np.floor((across + wide) * per_spacing)) + np.int32(1) - first, end)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def lay_lenses(
    line, seen, edged, glow, light_step, centres, kinds, lowest, highest, first, row, spacing, column, radius, reach,
    edge, count, before, across, rows, slope, limits, sizes, share, size, stride, corner, work, whole, quads, lamps,
    values, ranges, runs, sums,
):  # fmt: skip
    """Read all lenses that show a part of a band, and add them up; returns how many runs of pixels that are."""
    width, height = np.int32(size[0]), np.int32(size[1])
    corner_x, corner_y = np.int32(corner[0]), np.int32(corner[1])
    down, step, per_spacing = np.uint64(stride), np.float32(spacing), 1 / spacing
    last_ring, per_light_step = np.float32(len(glow) - 1), np.float32(1 / light_step)
    pairs, lamp_pairs = quads.view(np.uint64), lamps.view(np.uint64)
    found = done = 0
    top, bottom = first[1] + row * spacing, first[1] + (row + ROWS - 1) * spacing
    _columns_of(centres, lowest, highest, first[0], top, bottom, spacing, column, reach, count, ranges)
    # Interpolation reads two pixels beyond a place at most.
    low, high_x, high_y = radius + 2, width - 3 - radius, height - 3 - radius
    for lens in range(lowest, highest):
        begin, end = ranges[0, lens - lowest], ranges[1, lens - lowest]
        if begin >= end:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        # As seen from the first pixel of the picture, whatever part of it is drawn.
        anchor_x = int(np.rint((cx - first[0]) * per_spacing))
        anchor_y = int(np.rint((cy - first[1]) * per_spacing))
        e_x = np.float32(first[0] + anchor_x * spacing - cx)
        e_y = np.float32(first[1] + anchor_y * spacing - cy)
        at_x, at_y = np.floor(cx), np.floor(cy)
        border = not (low <= cx <= high_x and low <= cy <= high_y)
        end = _GROUP * before[(end + ACROSS - 1) // ACROSS]
        for u in range(_GROUP * before[begin // ACROSS], end, LANES):
            if found == done + QUEUE:
                _read_queue(
                    line, seen, glow, edge, down, sizes, runs, done, found, work, whole, quads, pairs, lamps,
                    lamp_pairs, values, sums,
                )  # fmt: skip
                done = found
            runs[found, 0], runs[found, 1] = u, edged[lens]
            runs[found, 2] = max((min(u + LANES, end) - u) // _GROUP, _FEWEST)
            q, lanes = np.uint64(found % QUEUE), whole_groups(runs[found, 2])
            kind = np.uint64(kinds[lens]) * np.uint64(LINE)
            _place(
                across, rows, np.int32(column - anchor_x), np.int32(row - anchor_y), e_x, e_y, step,
                np.float32(cx - at_x), np.float32(cy - at_y), np.int32(at_x), np.int32(at_y), slope, limits, share,
                np.uint64(u), kind, border, width, height, np.int32(stride), corner_x, corner_y, per_light_step,
                last_ring, lanes, work, whole, q * _WORK,
            )  # fmt: skip
            _ask_for(line, down, whole, q * _WORK, lanes)
            if edged[lens]:
                _ask_for(seen, down, whole, q * _WORK, lanes)
            found += 1
    _read_queue(
        line, seen, glow, edge, down, sizes, runs, done, found, work, whole, quads, pairs, lamps, lamp_pairs, values,
        sums,
    )  # fmt: skip
    return found
