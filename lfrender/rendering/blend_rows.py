"""Blended pictures, some rows at a time: what one lens adds to them is found for all of its pixels together.

The same mean as that of `mosaic.draw_rows`, in another order of work: there every pixel asks which lenses show it,
here every lens is laid over the pixels that it shows. A few rows lie column by column in memory, so that a lens shows
one run of pixels (`lens_runs`). Pixels that need more than one reading are left to the other kernel.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from lfcal.runtime.fastmath import FAST

from .lens_runs import (
    ACROSS,
    FOURTH,
    LANES,
    LINE,
    PER_RUN,
    QUEUE,
    ROWS,
    SECOND,
    SECTION,
    THIRD,
    agree,
    lay_lenses,
    whole_groups,
)

__all__ = ["blend_rows"]

# Bands of rows that one thread blends one after the other with the same buffers.
_TOGETHER = 4
# An output pixel that is larger in the flat by no more than this is read at one place [px].
_OVER = np.float32(1.05)


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
        for r in range(ROWS):
            sizes[ROWS * k + r] = along[r, k]
            across[ROWS * k + r] = columns[k]
    per_pitch = np.float32(1.0) / pitch
    for k in range(ROWS * count):
        tilt = sizes[k] * per_pitch
        limit = min(radius / max(abs(tilt), np.float32(1e-6)), reach)
        slope[k], limits[k] = tilt, limit * limit
    # Lanes beyond the last pixel find nothing.
    beyond = ROWS * count
    slope[beyond : beyond + 2 * LANES] = 0
    limits[beyond : beyond + 2 * LANES] = -1
    across[beyond : beyond + 2 * LANES] = 0


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _normalise(sums, count):
    """Make means of the weighted `sums` of `count` pixels."""
    for k in range(count):
        weight = sums[k]
        inverse = np.float32(1.0) / (weight if weight > 0 else np.float32(1.0))
        sums[SECOND + k] *= inverse
        sums[THIRD + k] *= inverse
        sums[FOURTH + k] *= inverse


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _store(totals, sizes, wanted, row, columns, count, end, largest, half, top, marks, out, valid, left, section):
    """Round and store the pixels of one row of a band that are read at one place; columns from `end` on are none."""
    for k in range(count):
        if columns[k] >= end:
            continue
        at, u = np.uint64(ROWS * k + row), section + columns[k]
        if len(wanted) > 0 and not wanted[u]:
            continue
        left[u] = abs(sizes[at]) > largest
        if left[u]:
            continue
        valid[u] = totals[at] > 0
        out[u, 0] = min(totals[SECOND + at] + half, top)
        if len(marks) > 1:
            out[u, 1] = min(totals[THIRD + at] + half, top)
        if len(marks) > 2:
            out[u, 2] = min(totals[FOURTH + at] + half, top)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _wanted_columns(wanted, first, end, section, count, some, before, columns):
    """Fill `columns` with those of the groups in which any of the rows from `first` to `end` is wanted, and `before`
    with how many such groups are before each; returns how many columns there are. All of them where `wanted` is (0, 0);
    `some` is memory to work in."""
    groups = (count + ACROSS - 1) // ACROSS
    some[: ACROSS * groups] = wanted.size == 0
    for v in range(first, end if wanted.size else first):
        for k in range(count):
            some[k] |= wanted[v, section + k]
    found = 0
    for g in range(groups):
        before[g] = found
        any_here = False
        for k in range(ACROSS * g, ACROSS * (g + 1)):
            columns[ACROSS * found + k - ACROSS * g] = k
            any_here |= some[k]
        found += any_here
    before[groups] = found
    return ACROSS * found


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _shares_along(shares, slope, count, places, share):
    """How much each type of lenses counts along a row; `places` is memory to work in."""
    last = np.float32(shares.shape[1] - 1)
    for k in range(count):
        ratio = (slope[k] + np.float32(1.0)) * (np.float32(0.5) * last) + np.float32(0.5)
        places[k] = np.int32(min(max(ratio, np.float32(0.0)), last))
    for t in range(len(shares)):
        for k in range(count):
            share[t * LINE + k] = shares[t, np.uint64(np.uint32(places[k]))]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def blend_rows(
    flat, marks, seen, edged, gains, lights, light_step, centres, kinds, shares, radius, pitch, surface, grid_x, grid_y,
    cell, edge, scale, first, spacing, reach, tolerance, corner, size, start, wanted, half, top, out, valid, left,
    threads,
):  # fmt: skip
    """Fill `out` (h, w, C) as `mosaic.draw_rows` does, for whole numbers in the middle view.

    `flat` (H, W) uint32 or uint64 are pixels as `prefilter_packed`. Lenses have their `centres` (n, 2) on the flat,
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
    row_of = np.empty(LANES, np.int32)
    for k in range(LANES):
        row_of[k] = k % ROWS
    bands, tall = (rows + ROWS - 1) // ROWS, 0
    for band in range(bands):
        y = first[1] + (start[1] + ROWS * band) * spacing
        above, below = y - reach, y + (ROWS - 1) * spacing + reach
        tall = max(tall, np.searchsorted(centres[:, 1], below) - np.searchsorted(centres[:, 1], above))
    most = tall * (ROWS * (int(2 * reach / spacing) + 1 + 2 * ACROSS) // LANES + 2)
    # Values of the surface beneath a row.
    beneath = int((min(SECTION, columns) + ACROSS) * spacing / cell) + 4
    groups = (bands + _TOGETHER - 1) // _TOGETHER
    each = -(-groups // threads)
    for number in prange(each * threads):
        # What is wanted comes in clusters: every thread has rows from top to bottom.
        group = number % each * threads + number // each
        slope, limits, sizes = np.empty(LINE, np.float32), np.empty(LINE, np.float32), np.empty(LINE, np.float32)
        places, level = np.empty(SECTION, np.int32), np.empty(beneath, np.float32)
        near, torn = np.empty(beneath, np.float32), np.empty(beneath, np.bool_)
        along, chosen = np.empty((ROWS, SECTION), np.float32), np.empty(SECTION, np.int32)
        across = np.empty(LINE, np.int32)
        some, before = np.empty(SECTION, np.bool_), np.empty(SECTION // ACROSS + 1, np.int64)
        ratios, share = np.empty(LINE, np.int32), np.ones(types * LINE, np.float32)
        sums, totals = np.empty(4 * LINE, np.float32), np.empty(4 * LINE, np.float32)
        work, whole = np.empty(QUEUE * 3 * LANES, np.float32), np.empty(QUEUE * 3 * LANES, np.int32)
        quads, lamps = np.empty(QUEUE * 4 * LANES, flat.dtype), np.empty(QUEUE * 2 * LANES, np.float32)
        values, runs = np.empty(most * 4 * LANES, np.float32), np.empty((most, 3), np.int64)
        ranges = np.empty((2, tall), np.int32)
        for band in range(group * _TOGETHER, min((group + 1) * _TOGETHER, bands)):
            upper, lower = ROWS * band, min(ROWS * (band + 1), rows)
            y = first[1] + (start[1] + upper) * spacing
            lowest = np.searchsorted(centres[:, 1], y - reach)
            highest = np.searchsorted(centres[:, 1], y + (ROWS - 1) * spacing + reach)
            for section in range(0, columns, SECTION):
                count, column = min(SECTION, columns - section), start[0] + section
                left[upper:lower, section : section + count] = False
                asked = _wanted_columns(wanted, upper, lower, section, count, some, before, chosen)
                if asked == 0:
                    continue
                for r in range(ROWS):
                    _depths_along(
                        surface, first[0] + column * spacing, first[1] + (start[1] + upper + r) * spacing, spacing,
                        grid_x, grid_y, cell, edge, chosen, asked, places, level, near, torn, along[r],
                    )  # fmt: skip
                _column_by_column(
                    along, chosen, asked, pitch, radius, np.float32(reach), across, sizes, slope, limits
                )  # fmt: skip
                lanes = ROWS * asked
                if last_ratio > 0:
                    _shares_along(shares, slope, lanes, ratios, share)
                sums[:] = 0
                totals[:] = 0
                found = lay_lenses(
                    line, seen_line, edged, glow_pairs, light_step, centres, kinds, lowest, highest, first,
                    start[1] + upper, spacing, column, radius, reach, edge, count, before, across, row_of, slope,
                    limits, sizes, share, size, flat.shape[1], corner, work, whole, quads, lamps, values, ranges, runs,
                    sums,
                )  # fmt: skip
                _normalise(sums, np.uint64(lanes))
                for n in range(found):
                    at, u = np.uint64(n) * PER_RUN, np.uint64(runs[n, 0])
                    agree(values, at, sums, u, whole_groups(runs[n, 2]), t2, per_channel, totals)
                _normalise(totals, np.uint64(lanes))
                for v in range(upper, lower):
                    _store(
                        totals, sizes, wanted[v] if wanted.size else wanted[:0, 0], v - upper, chosen, asked, count,
                        _OVER * scale, half, top, marks, out[v], valid[v], left[v], section,
                    )  # fmt: skip
