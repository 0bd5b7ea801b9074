"""Blended pictures row by row: what one lens adds to a row of output pixels is found for all of them together.

The same mean as that of `mosaic.draw_rows`, in another order of work: there every pixel asks which lenses show it,
here every lens is laid over the pixels that it shows. Neighbours in a row then take the same steps, as vector
instructions want it. Pixels that need more than one reading are left to the other kernel.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .byte_reading import two_at
from .fastmath import FAST
from .mosaic import HIDDEN

__all__ = ["SECTION", "blend_rows"]

# So many pixels are worked on together at most, in whole groups of the second number, one vector register of single
# precision, and not fewer groups than the third, or no compiler takes them together. Counts and places are unsigned:
# signed ones are looked at for being counted from the end.
_LANES, _GROUP, _FEWEST = 32, 8, 2
#: Columns of a picture that are blended at once, so that places of a row's buffer lie a known way apart.
SECTION = 1024
_LINE = SECTION + 4 * _LANES
_SECOND, _THIRD, _FOURTH = np.uint64(_LINE), np.uint64(2 * _LINE), np.uint64(3 * _LINE)
# Rows that one thread blends one after the other with the same buffers.
_TOGETHER = 8
# Runs whose places are found before the first of them is read.
_QUEUE = 8
# Weight of a lens at the rim of its reach.
_RIM = np.float32(1.02)
# An output pixel that is larger in the flat by no more than this is read at one place [px].
_OVER = np.float32(1.05)
# Where the second, third and fourth value of all pixels of a run begin, and what belongs to the next run.
_ONE, _F, _W, _THREE = np.uint64(1), np.uint64(_LANES), np.uint64(2 * _LANES), np.uint64(3 * _LANES)
_BOTH, _WORK, _PER_RUN = np.uint64(2 * _LANES), np.uint64(3 * _LANES), np.uint64(4 * _LANES)


@njit(cache=True, nogil=True, inline="always")
def _whole(groups):
    """Pixels of so many groups."""
    return np.uint64(groups) * np.uint64(_GROUP)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _place(
    columns, n, e_x, e_y, spacing, inner_x, inner_y, at_x, at_y, slope, limits, share, u, kind, width, height, stride,
    corner_x, corner_y, per_light_step, last_ring, lanes, work, whole, at,
):  # fmt: skip
    """Where some pixels read a lens, and how much that counts.

    Leaves the parts of a pixel and the weight in `work`, and in `whole` the pixel of the flat, the place in the light
    table and the nearest pixel. All numbers are of 32 bits: sums of whole ones would be of 64, half as many at a time.
    """
    last_x, last_y = np.int32(width - 2), np.int32(height - 2)
    end_x, end_y = np.float32(width - 1), np.float32(height - 1)
    for k in range(lanes):
        ex = np.float32(np.int32(n + columns[u + k])) * spacing + e_x
        d2 = ex * ex + e_y * e_y
        tilt = slope[u + k]
        rx, ry = inner_x - ex * tilt, inner_y - e_y * tilt
        step_x, step_y = np.floor(rx), np.floor(ry)
        fx, fy = rx - step_x, ry - step_y
        ix, iy = np.int32(at_x + np.int32(step_x)), np.int32(at_y + np.int32(step_y))
        limit = limits[u + k]
        ok = (d2 <= limit) & (ix >= 0) & (iy >= 0)
        ok &= (np.float32(ix) + fx <= end_x) & (np.float32(iy) + fy <= end_y)
        fx = np.float32(1.0) if ix > last_x else fx
        fy = np.float32(1.0) if iy > last_y else fy
        ix, iy = min(max(ix, np.int32(0)), last_x), min(max(iy, np.int32(0)), last_y)
        weight = (_RIM - d2 / limit) * share[kind + u + k]
        work[at + k] = fx
        work[at + _F + k] = fy
        work[at + _W + k] = weight if ok else np.float32(0.0)
        place = np.int32(np.int32(np.int32(iy - corner_y) * stride) + np.int32(ix - corner_x))
        whole[at + k] = place if ok else np.int32(0)
        ring = min(d2 * tilt * tilt * per_light_step, last_ring)
        whole[at + _F + k] = np.int32(ring)
        right = np.int32(1) if fx >= np.float32(0.5) else np.int32(0)
        below = stride if fy >= np.float32(0.5) else np.int32(0)
        whole[at + _W + k] = np.int32(np.int32(place + right) + below) if ok else np.int32(0)


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
        sums[_SECOND + u + k] += weight * v0
        sums[_THIRD + u + k] += weight * v1
        sums[_FOURTH + u + k] += weight * v2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _agree(values, base, sums, u, lanes, t2, per_channel, totals):
    """Add readings to the `totals` of their pixels as far as they agree with the means in `sums`."""
    for k in range(lanes):
        v0, v1, v2 = values[base + _F + k], values[base + _W + k], values[base + _THREE + k]
        e0, e1, e2 = v0 - sums[_SECOND + u + k], v1 - sums[_THIRD + u + k], v2 - sums[_FOURTH + u + k]
        agree = t2 / (t2 + (e0 * e0 + e1 * e1 + e2 * e2) * per_channel)
        weight = values[base + k] * agree * agree
        totals[u + k] += weight
        totals[_SECOND + u + k] += weight * v0
        totals[_THIRD + u + k] += weight * v1
        totals[_FOURTH + u + k] += weight * v2


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _depths_along(
    surface, x, y, spacing, grid_x, grid_y, cell, edge, pitch, radius, reach, columns, count, slope, limits, sizes,
    places, level, near, torn,
):  # fmt: skip
    """Patch sizes at some columns of a row, as `patch_size_at`, their share of the pitch, and the squared distance at
    which lenses are read. The last four arguments are memory to work in."""
    rows, wide = surface.shape
    last_x, last_y, last = np.float32(wide - 1), np.float32(rows - 1), np.int32(max(wide - 2, 0))
    for k in range(count):
        gx = min(max((np.float32(x + columns[k] * spacing) - grid_x) / cell, np.float32(0.0)), last_x)
        places[k] = min(np.int32(gx), last)
        sizes[k] = gx - np.float32(places[k])
    gy = min(max((np.float32(y) - grid_y) / cell, np.float32(0.0)), last_y)
    j = min(int(gy), max(rows - 2, 0))
    above, below, fy = surface[j], surface[min(j + 1, rows - 1)], gy - np.float32(j)
    start, number = places[0], min(places[count - 1] + 2, wide) - places[0]
    for k in range(number):
        a, b = above[start + k], below[start + k]
        level[k] = (np.float32(1.0) - fy) * a + fy * b
        near[k] = b if fy > np.float32(0.5) else a
    level[number], near[number] = level[number - 1], near[number - 1]
    for k in range(number):
        right = min(start + k + 1, wide - 1)
        a, b, c, d = above[start + k], above[right], below[start + k], below[right]
        torn[k] = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) >= edge
    for k in range(count):
        at, fx = np.uint64(np.uint32(places[k] - start)), sizes[k]
        one = np.uint64(1)
        if torn[at]:
            sizes[k] = near[at + one] if fx > np.float32(0.5) else near[at]
        else:
            sizes[k] = (np.float32(1.0) - fx) * level[at] + fx * level[at + one]
    per_pitch = np.float32(1.0) / pitch
    for k in range(count):
        tilt = sizes[k] * per_pitch
        limit = min(radius / max(abs(tilt), np.float32(1e-6)), reach)
        slope[k], limits[k] = tilt, limit * limit
    # Lanes beyond the last pixel find nothing.
    slope[count : count + 2 * _LANES] = 0
    limits[count : count + 2 * _LANES] = -1


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _hide(seen, edge, sizes, u, whole, at, lanes, work):
    """Take the weight from readings that see another depth."""
    for k in range(lanes):
        depth = seen[np.uint64(np.uint32(whole[at + _W + k]))]
        # A branch that cannot be foretold would cost more.
        work[at + _W + k] *= HIDDEN if abs(depth - sizes[u + k]) > np.float32(2.0) * edge else np.float32(1.0)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _read_queue(
    line, seen, glow, edge, stride, sizes, runs, begin, end, work, whole, quads, pairs, lamps, lamp_pairs, values, sums
):  # fmt: skip
    """Read the runs from `begin` to `end`, whose places are found.

    Loops over several of them: what is written by single values cannot be read as vectors at once.
    """
    for n in range(begin, end):
        q, lanes = np.uint64(n % _QUEUE), _whole(runs[n, 2])
        _fetch(
            line, stride, whole, q * _WORK, lanes, glow, quads, q * _PER_RUN, pairs, q * _BOTH, lamp_pairs, q * _F
        )  # fmt: skip
    for n in range(begin, end):
        q = np.uint64(n % _QUEUE)
        if runs[n, 1]:
            lanes = _whole(runs[n, 2])
            _hide(seen, edge, sizes, np.uint64(runs[n, 0]), whole, q * _WORK, lanes, work)
    for n in range(begin, end):
        q, lanes = np.uint64(n % _QUEUE), _whole(runs[n, 2])
        _add(
            quads, q * _PER_RUN, lamps, q * _BOTH, work, q * _WORK, values, np.uint64(n) * _PER_RUN, sums,
            np.uint64(runs[n, 0]), lanes,
        )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _columns_of(centres, lowest, highest, x, y, spacing, column, reach, count, ranges):
    """Fill `ranges` (2, n) with the first column, and the one beyond the last, of what some lenses show in a row."""
    per_spacing, first, end = 1 / spacing, np.int32(column), np.int32(count)
    for n in range(np.uint64(highest - lowest)):
        lens = np.uint64(lowest) + n
        across, ey = centres[lens, 0] - x, y - centres[lens, 1]
        wide = np.sqrt(max(reach * reach - ey * ey, 0.0))
        ranges[0, n] = max(np.int32(np.ceil((across - wide) * per_spacing)) - first, np.int32(0))
        ranges[1, n] = min(np.int32(np.floor((across + wide) * per_spacing)) + np.int32(1) - first, end)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _lay_lenses(
    line, seen, edged, glow, light_step, centres, kinds, lowest, highest, x, y, spacing, column, reach, edge, count,
    before, columns, slope, limits, sizes, share, size, stride, corner, work, whole, quads, lamps, values, ranges,
    runs, sums,
):  # fmt: skip
    """Read all lenses that show a part of a row, and add them up; returns how many runs of pixels that are."""
    width, height = np.int32(size[0]), np.int32(size[1])
    corner_x, corner_y = np.int32(corner[0]), np.int32(corner[1])
    down, step, per_spacing = np.uint64(stride), np.float32(spacing), 1 / spacing
    last_ring, per_light_step = np.float32(len(glow) - 1), np.float32(1 / light_step)
    pairs, lamp_pairs = quads.view(np.uint64), lamps.view(np.uint64)
    found = done = 0
    _columns_of(centres, lowest, highest, x, y, spacing, column, reach, count, ranges)
    for lens in range(lowest, highest):
        begin, end = ranges[0, lens - lowest], ranges[1, lens - lowest]
        if begin >= end:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        ey = y - cy
        # As seen from the first column of the picture, whatever part of it is drawn.
        anchor = int(np.rint((cx - x) * per_spacing))
        e_x = np.float32(x + anchor * spacing - cx)
        at_x, at_y = np.floor(cx), np.floor(cy)
        end = before[end]
        for u in range(before[begin], end, _LANES):
            stop = min(u + _LANES, end)
            if found == done + _QUEUE:
                _read_queue(
                    line, seen, glow, edge, down, sizes, runs, done, found, work, whole, quads, pairs, lamps,
                    lamp_pairs, values, sums,
                )  # fmt: skip
                done = found
            runs[found, 0], runs[found, 1] = u, edged[lens]
            runs[found, 2] = max((stop - u + _GROUP - 1) // _GROUP, _FEWEST)
            q = np.uint64(found % _QUEUE)
            _place(
                columns, np.int32(column - anchor), e_x, np.float32(ey), step, np.float32(cx - at_x),
                np.float32(cy - at_y), np.int32(at_x), np.int32(at_y), slope, limits, share, np.uint64(u),
                np.uint64(kinds[lens]) * np.uint64(_LINE), width, height, np.int32(stride), corner_x, corner_y,
                per_light_step, last_ring, _whole(runs[found, 2]), work, whole, q * _WORK,
            )  # fmt: skip
            found += 1
    _read_queue(
        line, seen, glow, edge, down, sizes, runs, done, found, work, whole, quads, pairs, lamps, lamp_pairs, values,
        sums,
    )  # fmt: skip
    return found


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _normalise(sums, count):
    """Make means of the weighted `sums` of `count` pixels."""
    for k in range(count):
        weight = sums[k]
        inverse = np.float32(1.0) / (weight if weight > 0 else np.float32(1.0))
        sums[_SECOND + k] *= inverse
        sums[_THIRD + k] *= inverse
        sums[_FOURTH + k] *= inverse


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _store(totals, sizes, columns, count, largest, half, top, marks, out, valid, left, section):
    """Round and store the pixels at some columns of a row that are read at one place."""
    for k in range(count):
        at = np.uint64(k)
        u = section + columns[at]
        left[u] = abs(sizes[at]) > largest
        if left[u]:
            continue
        valid[u] = totals[at] > 0
        out[u, 0] = min(totals[_SECOND + at] + half, top)
        if len(marks) > 1:
            out[u, 1] = min(totals[_THIRD + at] + half, top)
        if len(marks) > 2:
            out[u, 2] = min(totals[_FOURTH + at] + half, top)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _wanted_columns(wanted, v, section, count, before, columns):
    """Fill `columns` with the wanted ones of a row, and `before` with how many of them are before each place; returns
    how many there are. All of them where `wanted` is (0, 0)."""
    found = 0
    for k in range(count):
        before[k] = found
        columns[found] = k
        found += wanted.size == 0 or wanted[v, section + k]
    before[count] = found
    # Lanes beyond the last.
    columns[found : found + 2 * _LANES] = 0
    return found


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _shares_along(shares, slope, count, places, share):
    """How much each type of lenses counts along a row; `places` is memory to work in."""
    last = np.float32(shares.shape[1] - 1)
    for k in range(count):
        ratio = (slope[k] + np.float32(1.0)) * (np.float32(0.5) * last) + np.float32(0.5)
        places[k] = np.int32(min(max(ratio, np.float32(0.0)), last))
    for t in range(len(shares)):
        for k in range(count):
            share[t * _LINE + k] = shares[t, np.uint64(np.uint32(places[k]))]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def blend_rows(
    flat, marks, seen, edged, gains, lights, light_step, centres, kinds, shares, radius, pitch, surface, grid_x, grid_y,
    cell, edge, scale, first, spacing, reach, tolerance, corner, size, start, wanted, half, top, out, valid, left,
    threads,
):  # fmt: skip
    """Fill `out` (h, w, C) as `mosaic.draw_rows` does, for whole numbers in the middle view.

    `flat` (H, W) uint32 or uint64 are pixels as `packed_to_read`. Lenses have their `centres` (n, 2) on the flat,
    sorted by y, are of the type `kinds` (n,) and `edged` (n,) where `seen` tells anything of them. Pixels that need
    more than one reading are marked in `left` (h, w), and are to be drawn by the other kernel. So many `threads` share
    the work. The other arguments are those of that one.
    """
    rows, columns, _ = out.shape
    glow = np.empty(2 * len(gains), np.float32)
    for k in range(len(gains)):
        glow[2 * k], glow[2 * k + 1] = gains[k], lights[k] * lights[k]
    glow_pairs = glow.view(np.uint64)
    line, seen_line = flat.reshape(-1), seen.reshape(-1)
    t2, per_channel = tolerance * tolerance, np.float32(1 / len(marks))
    last_ratio, types = shares.shape[1] - 1, len(shares)
    tall = 0
    for v in range(rows):
        y = first[1] + (start[1] + v) * spacing
        tall = max(tall, np.searchsorted(centres[:, 1], y + reach) - np.searchsorted(centres[:, 1], y - reach))
    most = tall * ((int(2 * reach / spacing) + 2) // _LANES + 2)
    # Values of the surface beneath a row.
    beneath = int(min(SECTION, columns) * spacing / cell) + 4
    groups = (rows + _TOGETHER - 1) // _TOGETHER
    each = -(-groups // threads)
    for number in prange(each * threads):
        # What is wanted comes in clusters: every thread has rows from top to bottom.
        group = number % each * threads + number // each
        slope, limits, sizes = np.empty(_LINE, np.float32), np.empty(_LINE, np.float32), np.empty(_LINE, np.float32)
        places, level = np.empty(_LINE, np.int32), np.empty(beneath, np.float32)
        chosen = np.empty(_LINE, np.int32)
        near, torn = np.empty(beneath, np.float32), np.empty(beneath, np.bool_)
        share, before = np.ones(types * _LINE, np.float32), np.empty(SECTION + 1, np.int64)
        sums, totals = np.empty(4 * _LINE, np.float32), np.empty(4 * _LINE, np.float32)
        work, whole = np.empty(_QUEUE * 3 * _LANES, np.float32), np.empty(_QUEUE * 3 * _LANES, np.int32)
        quads, lamps = np.empty(_QUEUE * 4 * _LANES, flat.dtype), np.empty(_QUEUE * 2 * _LANES, np.float32)
        values, runs = np.empty(most * 4 * _LANES, np.float32), np.empty((most, 3), np.int64)
        ranges = np.empty((2, tall), np.int32)
        for v in range(group * _TOGETHER, min((group + 1) * _TOGETHER, rows)):
            y = first[1] + (start[1] + v) * spacing
            lowest = np.searchsorted(centres[:, 1], y - reach)
            highest = np.searchsorted(centres[:, 1], y + reach)
            for section in range(0, columns, SECTION):
                count, column = min(SECTION, columns - section), start[0] + section
                left[v, section : section + count] = False
                asked = _wanted_columns(wanted, v, section, count, before, chosen)
                if asked == 0:
                    continue
                _depths_along(
                    surface, first[0] + column * spacing, y, spacing, grid_x, grid_y, cell, edge, pitch, radius,
                    np.float32(reach), chosen, asked, slope, limits, sizes, places, level, near, torn,
                )  # fmt: skip
                if last_ratio > 0:
                    _shares_along(shares, slope, asked, places, share)
                sums[:] = 0
                totals[:] = 0
                found = _lay_lenses(
                    line, seen_line, edged, glow_pairs, light_step, centres, kinds, lowest, highest, first[0], y,
                    spacing, column, reach, edge, count, before, chosen, slope, limits, sizes, share, size,
                    flat.shape[1], corner, work, whole, quads, lamps, values, ranges, runs, sums,
                )  # fmt: skip
                _normalise(sums, np.uint64(asked))
                for n in range(found):
                    at, u = np.uint64(n) * _PER_RUN, np.uint64(runs[n, 0])
                    _agree(values, at, sums, u, _whole(runs[n, 2]), t2, per_channel, totals)
                _normalise(totals, np.uint64(asked))
                _store(
                    totals, sizes, chosen, asked, _OVER * scale, half, top, marks, out[v], valid[v], left[v], section
                )  # fmt: skip
