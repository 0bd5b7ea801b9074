"""Blending lens by lens: a lens is laid over all pixels of a few rows that it shows, with vector instructions.

Computes the robust mean of `blend_pixels` for the usual picture: integers of up to three channels, the middle view, one
sample per output pixel. It leaves the pixels that need several samples to that kernel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import kernel

from ...runtime.order_statistics import count_below
from ..settings import WEIGHTS
from .blend_pixels import put_value
from .lens_runs import (
    COLUMNS,
    FOURTH,
    LANES,
    LINE,
    PER_RUN,
    QUEUE,
    ROWS,
    SECOND,
    SECTION,
    THIRD,
    Band,
    Buffers,
    Source,
    add_agreeing,
    count_pixels,
    read_lenses,
)

__all__ = ["blend_rows"]


class _RowMemory(NamedTuple):
    """Memory of one thread for the patch sizes along a row, and the columns that are drawn."""

    along: Any  # (ROWS, SECTION) float32 [px]: patch sizes
    place: Any  # (SECTION,) int32: grid value left of each pixel
    level: Any  # float32 [px]: grid values interpolated between two rows of the grid
    near: Any  # float32 [px]: grid values of the nearer row
    edge: Any  # bool: the grid cell holds a depth edge
    columns: Any  # (SECTION,) int32: columns that are drawn
    some: Any  # (SECTION,) bool: some row wants the column
    before: Any  # int64: groups of columns that are drawn before each
    ratio: Any  # (LINE,) int32: entry of the shares


@njit(fastmath=FAST, error_model="numpy")
def _sample_row(surface, depth, x, y, spacing, count, memory, sizes):
    """Fill `sizes` with the patch sizes at the first `count` columns that are drawn, as `patch_size_at`."""
    columns, places, level, near, edge = memory.columns, memory.place, memory.level, memory.near, memory.edge
    rows, wide = surface.shape
    last_x, last_y, last = np.float32(wide - 1), np.float32(rows - 1), np.int32(max(wide - 2, 0))
    for k in range(count):
        gx = min(max((np.float32(x + columns[k] * spacing) - depth.x) / depth.spacing, np.float32(0.0)), last_x)
        places[k] = min(np.int32(gx), last)
        sizes[k] = gx - np.float32(places[k])
    gy = min(max((np.float32(y) - depth.y) / depth.spacing, np.float32(0.0)), last_y)
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
        edge[k] = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) >= depth.edge
    for k in range(count):
        at, fx = np.uint64(np.uint32(places[k] - start)), sizes[k]
        one = np.uint64(1)
        if edge[at]:
            sizes[k] = near[at + one] if fx > np.float32(0.5) else near[at]
        else:
            sizes[k] = (np.float32(1.0) - fx) * level[at] + fx * level[at + one]


@njit(fastmath=FAST, error_model="numpy")
def _fill_band(memory, count, pitch, radius, reach, band):
    """Put patch sizes and columns in the order of memory, column by column, with slope and squared reach."""
    along, columns = memory.along, memory.columns
    across, sizes, slope, limits = band.column, band.size, band.slope, band.limit2
    for k in range(count):
        for r in range(ROWS):
            sizes[ROWS * k + r] = along[r, k]
            across[ROWS * k + r] = columns[k]
    per_pitch = np.float32(1.0) / pitch
    for k in range(ROWS * count):
        tilt = sizes[k] * per_pitch
        limit = min(radius / max(abs(tilt), np.float32(1e-6)), reach)
        slope[k], limits[k] = tilt, limit * limit
    # Lanes beyond the last pixel are in reach of no lens.
    beyond = ROWS * count
    slope[beyond : beyond + 2 * LANES] = 0
    limits[beyond : beyond + 2 * LANES] = -1
    across[beyond : beyond + 2 * LANES] = 0


@njit(fastmath=FAST, error_model="numpy")
def _normalise(sums, count):
    """Divide the weighted `sums` of `count` pixels by their weights."""
    for k in range(count):
        weight = sums[k]
        inverse = np.float32(1.0) / (weight if weight > 0 else np.float32(1.0))
        sums[SECOND + k] *= inverse
        sums[THIRD + k] *= inverse
        sums[FOURTH + k] *= inverse


@njit(fastmath=FAST, error_model="numpy")
def _store(totals, sizes, wanted, row, columns, count, end, largest, output, v, left, section):
    """Round and store row `v` of the picture, `row` of the band; columns from `end` on do not exist."""
    out, valid, half, top = output.image[v], output.valid[v], output.half, output.top
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
        put_value(out, u, 0, min(totals[SECOND + at] + half, top))
        if out.shape[1] > 1:
            put_value(out, u, 1, min(totals[THIRD + at] + half, top))
        if out.shape[1] > 2:
            put_value(out, u, 2, min(totals[FOURTH + at] + half, top))


@njit(fastmath=FAST, error_model="numpy")
def _wanted_columns(wanted, first, end, section, count, memory):
    """List the columns of all groups in which some row from `first` to `end` is wanted; returns their number."""
    some, before, columns = memory.some, memory.before, memory.columns
    groups = (count + COLUMNS - 1) // COLUMNS
    some[: COLUMNS * groups] = wanted.size == 0
    for v in range(first, end if wanted.size else first):
        for k in range(count):
            some[k] |= wanted[v, section + k]
    found = 0
    for g in range(groups):
        before[g] = found
        any_here = False
        for k in range(COLUMNS * g, COLUMNS * (g + 1)):
            columns[COLUMNS * found + k - COLUMNS * g] = k
            any_here |= some[k]
        found += any_here
    before[groups] = found
    return COLUMNS * found


@njit(fastmath=FAST, error_model="numpy")
def _fill_shares(shares, slope, count, places, share):
    """Weight of each lens type at every pixel."""
    last = np.float32(shares.shape[1] - 1)
    for k in range(count):
        ratio = (slope[k] + np.float32(1.0)) * (np.float32(0.5) * last) + np.float32(0.5)
        places[k] = np.int32(min(max(ratio, np.float32(0.0)), last))
    for t in range(len(shares)):
        for k in range(count):
            share[t * LINE + k] = shares[t, np.uint64(np.uint32(places[k]))]


@njit
def _allocate_row(columns, cell, spacing):
    """Memory for rows of a picture on a depth grid whose cells are `cell` wide."""
    beneath = int((min(SECTION, columns) + COLUMNS) * spacing / cell) + 4
    return _RowMemory(
        np.empty((ROWS, SECTION), np.float32), np.empty(SECTION, np.int32), np.empty(beneath, np.float32),
        np.empty(beneath, np.float32), np.empty(beneath, np.bool_), np.empty(SECTION, np.int32),
        np.empty(SECTION, np.bool_), np.empty(SECTION // COLUMNS + 1, np.int64), np.empty(LINE, np.int32),
    )  # fmt: skip


@njit
def _allocate_band(types):
    """Memory for a band; all types of lenses count alike until their shares are filled in."""
    row_of = np.empty(LANES, np.int32)
    for k in range(LANES):
        row_of[k] = k % ROWS
    return Band(
        np.empty(LINE, np.int32), row_of, np.empty(LINE, np.float32), np.empty(LINE, np.float32),
        np.empty(LINE, np.float32), np.ones(types * LINE, np.float32),
    )  # fmt: skip


@njit
def _allocate_buffers(runs, lenses):
    """Memory for so many runs of pixels, and lenses beside a band."""
    pairs, light = np.empty(QUEUE * 4 * LANES, np.uint64), np.empty(QUEUE * 2 * LANES, np.float32)
    return Buffers(
        np.empty(QUEUE * 3 * LANES, np.float32), np.empty(QUEUE * 3 * LANES, np.int32), pairs.view(np.uint32),
        pairs, light, light.view(np.uint64), np.empty(runs * 4 * LANES, np.float32),
        np.empty((runs, 3), np.int64), np.empty((2, lenses), np.int32), np.empty(4 * LINE, np.float32),
    )  # fmt: skip


@njit(error_model="numpy")
def _blend_section(
    source, surface, depth, grid, tolerance, output, left, upper, section, memory, band, buffers, totals
):  # fmt: skip
    """Blend at most `SECTION` columns from column `section` on, of the band whose first row is `upper`."""
    rows, columns = output.valid.shape
    lenses, spacing, first = source.lenses, grid.spacing, grid.first
    lower, row = min(upper + ROWS, rows), grid.start[1] + upper
    count, column = min(SECTION, columns - section), grid.start[0] + section
    left[upper:lower, section : section + count] = False
    asked = _wanted_columns(grid.wanted, upper, lower, section, count, memory)
    if asked == 0:
        return
    for r in range(ROWS):
        _sample_row(
            surface, depth, first[0] + column * spacing, first[1] + (row + r) * spacing, spacing, asked, memory,
            memory.along[r],
        )  # fmt: skip
    _fill_band(memory, asked, lenses.pitch, lenses.radius, np.float32(source.reach), band)
    lanes = ROWS * asked
    if lenses.shares.shape[1] > 1:
        _fill_shares(lenses.shares, band.slope, lanes, memory.ratio, band.share)
    buffers.sums[:] = 0
    totals[:] = 0
    y = first[1] + row * spacing
    lowest = count_below(lenses.centres[:, 1], y - source.reach)
    highest = count_below(lenses.centres[:, 1], y + (ROWS - 1) * spacing + source.reach)
    found = read_lenses(source, band, lowest, highest, first, row, column, spacing, count, memory.before, buffers)
    _normalise(buffers.sums, np.uint64(lanes))
    t2, per_channel = tolerance * tolerance, np.float32(1 / output.image.shape[2])
    for n in range(found):
        at, u, pixels = np.uint64(n) * PER_RUN, np.uint64(buffers.runs[n, 0]), count_pixels(buffers.runs[n, 2])
        add_agreeing(buffers.values, at, buffers.sums, u, pixels, t2, per_channel, totals)
    _normalise(totals, np.uint64(lanes))
    largest = (np.float32(1.0) + WEIGHTS.one_sample) * grid.scale
    for v in range(upper, lower):
        wanted = grid.wanted[v] if grid.wanted.size else grid.wanted[:0, 0]
        _store(
            totals, band.size, wanted, v - upper, memory.columns, asked, count, largest, output, v, left[v],
            section,
        )  # fmt: skip


@njit
def _most_runs(centres, grid, bands, reach):
    """Most lenses that lie beside a band, and most runs of pixels that they show in a section of it."""
    tall = 0
    for band in range(bands):
        y = grid.first[1] + (grid.start[1] + ROWS * band) * grid.spacing
        above, below = y - reach, y + (ROWS - 1) * grid.spacing + reach
        tall = max(tall, count_below(centres[:, 1], below) - count_below(centres[:, 1], above))
    return tall, tall * (ROWS * (int(2 * reach / grid.spacing) + 1 + 2 * COLUMNS) // LANES + 2)


@kernel(error_model="numpy", share=lambda *given: -(-len(given[7].image) // ROWS))
def blend_rows(begin, end, flat, light, lenses, surface, depth, grid, weighting, output, left):
    """Draw the pixels of a `Grid` into an `Output`.

    As `blend_pixels`, with packed pixels (h, w, words) uint32 in `flat` (`prefilter_packed`), a picture (rows,
    columns, C, bytes) uint8 whose values have one byte, two, or are floats of four, and `SortedLenses`: one kernel for
    all of them. Pixels that need more than one sample are marked in `left` (h, w) instead.
    """
    rows, columns = output.valid.shape
    gains, transmission = light.gains.reshape(-1), light.lights.reshape(-1)
    lights = np.empty(2 * len(gains), np.float32)
    for k in range(len(gains)):
        lights[2 * k], lights[2 * k + 1] = gains[k], transmission[k] * transmission[k]
    light_pairs = lights.view(np.uint64)
    line, depth_line, stride = flat.pixels.reshape(-1), flat.depth.reshape(-1), np.uint64(flat.pixels.shape[1])
    words = np.uint64(flat.pixels.shape[2])
    bands = (rows + ROWS - 1) // ROWS
    tall, most = _most_runs(lenses.centres, grid, bands, weighting.reach)
    source = Source(
        line, depth_line, stride, words, flat.corner, flat.size, light_pairs, light.gains.shape[1], light.step, lenses,
        depth.edge, weighting.reach,
    )  # fmt: skip
    memory = _allocate_row(columns, depth.spacing, grid.spacing)
    band, buffers = _allocate_band(len(lenses.shares)), _allocate_buffers(most, tall)
    totals = np.empty(4 * LINE, np.float32)
    for n in range(begin, end):
        for section in range(0, columns, SECTION):
            _blend_section(
                source, surface, depth, grid, weighting.tolerance, output, left, ROWS * n, section,
                memory, band, buffers, totals,
            )  # fmt: skip
