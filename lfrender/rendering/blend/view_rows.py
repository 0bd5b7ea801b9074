"""Blending lens by lens, as `rendering.blend_rows`, from a viewpoint off the middle of the main lens."""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels.jit import kernel

from ...runtime.order_statistics import count_below
from ..settings import WEIGHTS
from .blend_rows import (
    _allocate_band,
    _allocate_buffers,
    _allocate_row,
    _fill_band,
    _fill_shares,
    _most_runs,
    _normalise,
    _sample_row,
    _store,
    _wanted_columns,
)
from .lens_runs import LINE, PER_RUN, ROWS, SECTION, Source, add_agreeing, count_pixels
from .view_runs import read_lenses_about

__all__ = ["blend_view_rows"]


@njit(error_model="numpy")
def _blend_section(
    view, source, surface, depth, grid, tolerance, output, left, upper, section, memory, band, buffers, totals
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
    found = read_lenses_about(
        view, source, band, lowest, highest, first, row, column, spacing, count, memory.before, buffers
    )  # fmt: skip
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


@kernel(error_model="numpy", share=lambda *given: -(-len(given[8].image) // ROWS))
def blend_view_rows(begin, end, view, flat, light, lenses, surface, depth, grid, weighting, output, left):
    """Draw the pixels of a `Grid` into an `Output` as `blend_rows`, from a viewpoint.

    `view` are x, y of the viewpoint and the squared radius up to which microimages are read [px]; the radius of the
    `SortedLenses` is larger by the distance of the viewpoint.
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
                view, source, surface, depth, grid, weighting.tolerance, output, left, ROWS * n, section,
                memory, band, buffers, totals,
            )  # fmt: skip
