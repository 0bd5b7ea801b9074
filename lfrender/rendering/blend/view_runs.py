"""Runs of pixels that one lens shows in a band of rows, as `rendering.lens_runs`, read about a viewpoint.

A lens with its centre at `c` is read at `c + q - (Y - c) s / D` for the pixel at `Y`, as far as that lies in its
microimage.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.fastmath import FAST

from ..settings import WEIGHTS
from .lens_runs import (
    _F,
    _FEWEST,
    _GROUP,
    _W,
    _WORK,
    COLUMNS,
    LANES,
    PER_RUN,
    QUEUE,
    ROWS,
    _find_columns,
    _Flat,
    _locate_lens,
    _read_queue,
    count_pixels,
)

__all__ = ["read_lenses_about"]


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _place(
    columns, rows, slope, limits, share, lens, flat, steps, u, lanes, work, whole, at, view, values, base
):  # fmt: skip
    """Where some pixels from `u` on read a lens about the `view` (3,): x, y and squared radius of microimages [px].

    `steps` are those between pixels [px] and, reciprocal, between entries of the light table. Leaves in `work` and
    `whole` what `lens_runs` does, and squared distances of the lens in `values` from `base` on.
    """
    spacing, per_light_step = steps
    n_x, n_y, e_x, e_y, at_x, at_y = lens.n_x, lens.n_y, lens.e_x, lens.e_y, lens.at_x, lens.at_y
    inner_x, inner_y, type_at, border = lens.inner_x, lens.inner_y, lens.type_at, lens.border
    light_at = lens.light_at
    width, height, stride, last_entry = flat.width, flat.height, np.int32(flat.stride), flat.last_entry
    corner_x, corner_y = flat.corner_x, flat.corner_y
    last_x, last_y = np.int32(width - 2), np.int32(height - 2)
    end_x, end_y = np.float32(width - 1), np.float32(height - 1)
    view_x, view_y, radius2 = view
    for k in range(lanes):
        ex = np.float32(np.int32(n_x + columns[u + k])) * spacing + e_x
        ey = np.float32(np.int32(n_y + rows[k])) * spacing + e_y
        d2 = ex * ex + ey * ey
        values[base + k] = d2
        tilt = slope[u + k]
        dx, dy = view_x - ex * tilt, view_y - ey * tilt
        delta2 = dx * dx + dy * dy
        rx, ry = inner_x + dx, inner_y + dy
        step_x, step_y = np.floor(rx), np.floor(ry)
        fx, fy = rx - step_x, ry - step_y
        ix, iy = np.int32(at_x + np.int32(step_x)), np.int32(at_y + np.int32(step_y))
        limit = limits[u + k]
        ok = (d2 <= limit) & (delta2 <= radius2)
        if border:
            ok &= (ix >= 0) & (iy >= 0) & (np.float32(ix) + fx <= end_x) & (np.float32(iy) + fy <= end_y)
            fx = np.float32(1.0) if ix > last_x else fx
            fy = np.float32(1.0) if iy > last_y else fy
            ix, iy = min(max(ix, np.int32(0)), last_x), min(max(iy, np.int32(0)), last_y)
        # The second alone grows toward the rim of a microimage.
        weight = (WEIGHTS.rim - max(d2 / limit, delta2 / radius2)) * share[type_at + u + k]
        work[at + k] = fx
        work[at + _F + k] = fy
        work[at + _W + k] = weight if ok else np.float32(0.0)
        place = np.int32(np.int32(np.int32(iy - corner_y) * stride) + np.int32(ix - corner_x))
        whole[at + k] = place if ok else np.int32(0)
        whole[at + _F + k] = np.int32(np.int32(min(delta2 * per_light_step, last_entry)) + light_at)


@njit(fastmath=FAST, error_model="numpy")
def _reduce_occluded(depth, sizes, stride, edge, per_pitch2, runs, begin, end, work, whole, values):
    """Reduce the weight of readings whose nearest pixel shows another depth, of the runs from `begin` to `end`.

    The warped surface is what is visible from the viewpoint: lenses that look from nearby are preferred.
    """
    half = np.float32(0.5)
    for n in range(begin, end):
        if not runs[n, 1]:
            continue
        # The queue would do the same without regard to how far away lenses are.
        runs[n, 1] = 0
        u, at, base = np.uint64(runs[n, 0]), np.uint64(n % QUEUE) * _WORK, np.uint64(n) * PER_RUN
        for k in range(count_pixels(runs[n, 2])):
            right = np.uint64(1) if work[at + k] >= half else np.uint64(0)
            below = stride if work[at + _F + k] >= half else np.uint64(0)
            shown = depth[np.uint64(np.uint32(whole[at + k])) + right + below]
            beside = values[base + k] * per_pitch2 + WEIGHTS.occluded_near
            # Without a branch, which could not be predicted.
            occluded = abs(shown - sizes[u + k]) > np.float32(2.0) * edge
            work[at + _W + k] *= WEIGHTS.occluded / (beside * beside) if occluded else np.float32(1.0)


@njit(fastmath=FAST, error_model="numpy")
def read_lenses_about(view, source, band, lowest, highest, first, row, column, spacing, count, before, buffers):
    """Add up the readings of the lenses `lowest` to `highest` in a part of a band, as `lens_runs.read_lenses`."""
    line, depth, lights, stride = source.line, source.depth, source.lights, source.stride
    centres, edged = source.lenses.centres, source.lenses.edged
    columns, rows, slope, limits, share = band.column, band.row, band.slope, band.limit2, band.share
    work, whole, corners, pairs = buffers.work, buffers.place, buffers.corners, buffers.corner_pairs
    light, light_pairs, values, sums = buffers.light, buffers.light_pairs, buffers.values, buffers.sums
    sizes, runs, ranges = band.size, buffers.runs, buffers.ranges
    flat = _Flat(
        np.int32(source.size[0]), np.int32(source.size[1]), np.int32(source.corner[0]), np.int32(source.corner[1]),
        stride, source.words, source.edge, np.float32(source.rings - 1),
    )  # fmt: skip
    step, per_light_step = np.float32(spacing), np.float32(1 / source.light_step)
    found = done = 0
    per_pitch2 = np.float32(1.0) / (source.lenses.pitch * source.lenses.pitch)
    top, bottom = first[1] + row * spacing, first[1] + (row + ROWS - 1) * spacing
    _find_columns(centres, lowest, highest, first[0], top, bottom, spacing, column, source.reach, count, ranges)
    for number in range(lowest, highest):
        begin, end = ranges[0, number - lowest], ranges[1, number - lowest]
        if begin >= end:
            continue
        lens = _locate_lens(source.lenses, number, flat, first, row, column, spacing)
        end = _GROUP * before[(end + COLUMNS - 1) // COLUMNS]
        for u in range(_GROUP * before[begin // COLUMNS], end, LANES):
            if found == done + QUEUE:
                _reduce_occluded(
                    depth, sizes, stride, flat.edge, per_pitch2, runs, done, found, work, whole, values
                )  # fmt: skip
                _read_queue(
                    line, depth, lights, flat, sizes, runs, done, found, work, whole, corners, pairs, light,
                    light_pairs, values, sums,
                )  # fmt: skip
                done = found
            runs[found, 0], runs[found, 1] = u, edged[number]
            runs[found, 2] = max((min(u + LANES, end) - u) // _GROUP, _FEWEST)
            at, lanes = np.uint64(found % QUEUE) * _WORK, count_pixels(runs[found, 2])
            _place(
                columns, rows, slope, limits, share, lens, flat, (step, per_light_step), np.uint64(u), lanes, work,
                whole, at, view, values, np.uint64(found) * PER_RUN,
            )  # fmt: skip
            found += 1
    _reduce_occluded(depth, sizes, stride, flat.edge, per_pitch2, runs, done, found, work, whole, values)
    _read_queue(
        line, depth, lights, flat, sizes, runs, done, found, work, whole, corners, pairs, light, light_pairs, values,
        sums,
    )  # fmt: skip
    return found
