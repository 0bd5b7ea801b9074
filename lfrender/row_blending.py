"""Blended pictures, some rows at a time: what one lens adds to them is found for all of its pixels together.

The same mean as that of `mosaic.draw_rows`, in another order of work: there every pixel asks which lenses show it,
here every lens is laid over the pixels that it shows. A few rows lie column by column in memory, so that a lens shows
one run of pixels, which take the same steps, as vector instructions want it. Pixels that need more than one reading are
left to the other kernel.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .byte_reading import two_at
from .fastmath import FAST
from .mosaic import HIDDEN
from .prefetching import prefetch

__all__ = ["SECTION", "blend_rows"]

# So many rows, and columns of them, are a group of pixels, one vector register of single precision. So many pixels are
# worked on together at most, in whole groups, and not fewer of these than the last number, or no compiler takes them
# together. Counts and places are unsigned: signed ones are looked at for being counted from the end.
_ROWS, _GROUP, _LANES, _FEWEST = 4, 8, 96, 2
_ACROSS = _GROUP // _ROWS
#: Columns of a picture that are blended at once, so that places of the buffers lie a known way apart.
SECTION = 512
_LINE = _ROWS * SECTION + 2 * _LANES
_SECOND, _THIRD, _FOURTH = np.uint64(_LINE), np.uint64(2 * _LINE), np.uint64(3 * _LINE)
# Bands of rows that one thread blends one after the other with the same buffers.
_TOGETHER = 4
# Runs whose places are found before the first of them is read, and after how many pixels of a run memory is asked for.
_QUEUE, _AHEAD = 3, np.uint64(16)
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
        for k in range(first, first + np.uint64(_ROWS)):
            prefetch(line, np.uint64(np.uint32(whole[at + k])))
        prefetch(line, np.uint64(np.uint32(whole[at + first + np.uint64(_ROWS - 1)])) + down)
    for k in range(lanes - np.uint64(_ROWS), lanes):
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
    surface, x, y, spacing, grid_x, grid_y, cell, edge, columns, count, places, level, near, torn, sizes
):  # fmt: skip
    """Fill `sizes` with the patch sizes at some columns of a row, as `patch_size_at`; the four arguments before it are
    memory to work in."""
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


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _column_by_column(along, columns, count, pitch, radius, reach, across, sizes, slope, limits):
    """From the patch sizes `along` each row of a band, and its columns, those of its pixels as they lie in memory, with
    their share of the pitch and the squared distance at which lenses are read."""
    for k in range(count):
        for r in range(_ROWS):
            sizes[_ROWS * k + r] = along[r, k]
            across[_ROWS * k + r] = columns[k]
    per_pitch = np.float32(1.0) / pitch
    for k in range(_ROWS * count):
        tilt = sizes[k] * per_pitch
        limit = min(radius / max(abs(tilt), np.float32(1e-6)), reach)
        slope[k], limits[k] = tilt, limit * limit
    # Lanes beyond the last pixel find nothing.
    beyond = _ROWS * count
    slope[beyond : beyond + 2 * _LANES] = 0
    limits[beyond : beyond + 2 * _LANES] = -1
    across[beyond : beyond + 2 * _LANES] = 0


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
            _hide(seen, edge, np.int32(stride), sizes, np.uint64(runs[n, 0]), whole, q * _WORK, lanes, work)
    for n in range(begin, end):
        q, lanes = np.uint64(n % _QUEUE), _whole(runs[n, 2])
        _add(
            quads, q * _PER_RUN, lamps, q * _BOTH, work, q * _WORK, values, np.uint64(n) * _PER_RUN, sums,
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
def _lay_lenses(
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
    top, bottom = first[1] + row * spacing, first[1] + (row + _ROWS - 1) * spacing
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
        end = _GROUP * before[(end + _ACROSS - 1) // _ACROSS]
        for u in range(_GROUP * before[begin // _ACROSS], end, _LANES):
            if found == done + _QUEUE:
                _read_queue(
                    line, seen, glow, edge, down, sizes, runs, done, found, work, whole, quads, pairs, lamps,
                    lamp_pairs, values, sums,
                )  # fmt: skip
                done = found
            runs[found, 0], runs[found, 1] = u, edged[lens]
            runs[found, 2] = max((min(u + _LANES, end) - u) // _GROUP, _FEWEST)
            q, lanes = np.uint64(found % _QUEUE), _whole(runs[found, 2])
            kind = np.uint64(kinds[lens]) * np.uint64(_LINE)
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
def _store(totals, sizes, wanted, row, columns, count, end, largest, half, top, marks, out, valid, left, section):
    """Round and store the pixels of one row of a band that are read at one place; columns from `end` on are none."""
    for k in range(count):
        if columns[k] >= end:
            continue
        at, u = np.uint64(_ROWS * k + row), section + columns[k]
        if len(wanted) > 0 and not wanted[u]:
            continue
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
def _wanted_columns(wanted, first, end, section, count, some, before, columns):
    """Fill `columns` with those of the groups in which any of the rows from `first` to `end` is wanted, and `before`
    with how many such groups are before each; returns how many columns there are. All of them where `wanted` is (0, 0);
    `some` is memory to work in."""
    groups = (count + _ACROSS - 1) // _ACROSS
    some[: _ACROSS * groups] = wanted.size == 0
    for v in range(first, end if wanted.size else first):
        for k in range(count):
            some[k] |= wanted[v, section + k]
    found = 0
    for g in range(groups):
        before[g] = found
        any_here = False
        for k in range(_ACROSS * g, _ACROSS * (g + 1)):
            columns[_ACROSS * found + k - _ACROSS * g] = k
            any_here |= some[k]
        found += any_here
    before[groups] = found
    return _ACROSS * found


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
    row_of = np.empty(_LANES, np.int32)
    for k in range(_LANES):
        row_of[k] = k % _ROWS
    bands, tall = (rows + _ROWS - 1) // _ROWS, 0
    for band in range(bands):
        y = first[1] + (start[1] + _ROWS * band) * spacing
        above, below = y - reach, y + (_ROWS - 1) * spacing + reach
        tall = max(tall, np.searchsorted(centres[:, 1], below) - np.searchsorted(centres[:, 1], above))
    most = tall * (_ROWS * (int(2 * reach / spacing) + 1 + 2 * _ACROSS) // _LANES + 2)
    # Values of the surface beneath a row.
    beneath = int((min(SECTION, columns) + _ACROSS) * spacing / cell) + 4
    groups = (bands + _TOGETHER - 1) // _TOGETHER
    each = -(-groups // threads)
    for number in prange(each * threads):
        # What is wanted comes in clusters: every thread has rows from top to bottom.
        group = number % each * threads + number // each
        slope, limits, sizes = np.empty(_LINE, np.float32), np.empty(_LINE, np.float32), np.empty(_LINE, np.float32)
        places, level = np.empty(SECTION, np.int32), np.empty(beneath, np.float32)
        near, torn = np.empty(beneath, np.float32), np.empty(beneath, np.bool_)
        along, chosen = np.empty((_ROWS, SECTION), np.float32), np.empty(SECTION, np.int32)
        across = np.empty(_LINE, np.int32)
        some, before = np.empty(SECTION, np.bool_), np.empty(SECTION // _ACROSS + 1, np.int64)
        ratios, share = np.empty(_LINE, np.int32), np.ones(types * _LINE, np.float32)
        sums, totals = np.empty(4 * _LINE, np.float32), np.empty(4 * _LINE, np.float32)
        work, whole = np.empty(_QUEUE * 3 * _LANES, np.float32), np.empty(_QUEUE * 3 * _LANES, np.int32)
        quads, lamps = np.empty(_QUEUE * 4 * _LANES, flat.dtype), np.empty(_QUEUE * 2 * _LANES, np.float32)
        values, runs = np.empty(most * 4 * _LANES, np.float32), np.empty((most, 3), np.int64)
        ranges = np.empty((2, tall), np.int32)
        for band in range(group * _TOGETHER, min((group + 1) * _TOGETHER, bands)):
            upper, lower = _ROWS * band, min(_ROWS * (band + 1), rows)
            y = first[1] + (start[1] + upper) * spacing
            lowest = np.searchsorted(centres[:, 1], y - reach)
            highest = np.searchsorted(centres[:, 1], y + (_ROWS - 1) * spacing + reach)
            for section in range(0, columns, SECTION):
                count, column = min(SECTION, columns - section), start[0] + section
                left[upper:lower, section : section + count] = False
                asked = _wanted_columns(wanted, upper, lower, section, count, some, before, chosen)
                if asked == 0:
                    continue
                for r in range(_ROWS):
                    _depths_along(
                        surface, first[0] + column * spacing, first[1] + (start[1] + upper + r) * spacing, spacing,
                        grid_x, grid_y, cell, edge, chosen, asked, places, level, near, torn, along[r],
                    )  # fmt: skip
                _column_by_column(
                    along, chosen, asked, pitch, radius, np.float32(reach), across, sizes, slope, limits
                )  # fmt: skip
                lanes = _ROWS * asked
                if last_ratio > 0:
                    _shares_along(shares, slope, lanes, ratios, share)
                sums[:] = 0
                totals[:] = 0
                found = _lay_lenses(
                    line, seen_line, edged, glow_pairs, light_step, centres, kinds, lowest, highest, first,
                    start[1] + upper, spacing, column, radius, reach, edge, count, before, across, row_of, slope,
                    limits, sizes, share, size, flat.shape[1], corner, work, whole, quads, lamps, values, ranges, runs,
                    sums,
                )  # fmt: skip
                _normalise(sums, np.uint64(lanes))
                for n in range(found):
                    at, u = np.uint64(n) * _PER_RUN, np.uint64(runs[n, 0])
                    _agree(values, at, sums, u, _whole(runs[n, 2]), t2, per_channel, totals)
                _normalise(totals, np.uint64(lanes))
                for v in range(upper, lower):
                    _store(
                        totals, sizes, wanted[v] if wanted.size else wanted[:0, 0], v - upper, chosen, asked, count,
                        _OVER * scale, half, top, marks, out[v], valid[v], left[v], section,
                    )  # fmt: skip
