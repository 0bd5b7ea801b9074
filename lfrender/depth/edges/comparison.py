"""How well the pixels of a microimage match those of other lenses, at one depth each."""

from __future__ import annotations

import numpy as np

from lfcal.runtime.kernels.jit import njit

from ..depth_order import depth_order
from .microimage import LEFT_OUT

__all__ = ["allow_mismatch", "compare_depth"]

# Other lenses that a pixel is compared with, at most.
_VIEWS = 10
# Steps to the pixels of a patch: above, on the left, none, on the right, below.
_DOWN = (-1, 0, 0, 0, 1)
_ACROSS = (0, -1, 0, 1, 0)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def allow_mismatch(image, left, top, size, c, work):
    """The mismatch that noise, blur and resampling explain, for an open pixel with the four beside it."""
    for row in range(size):
        for column in range(size):
            if not work.open[row, column]:
                continue
            contrast = np.float32(0.0)
            for channel in range(3):
                total, squares = np.float32(0.0), np.float32(0.0)
                for e in range(5):
                    value = image[top + row + _DOWN[e], left + column + _ACROSS[e], channel]
                    total += value
                    squares += value * value
                contrast += squares / 5 - (total / 5) ** 2
            work.allowed[row * size + column] = c.contrast * contrast + c.noise2


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, _nrt=False)
def _look_at_row(image, left, top, row, size, k, other_x, other_y, to_x, to_y, lenses, before, work):
    """Fill a row of `apart` and `seen` for another lens, (to_x, to_y) from this one."""
    height, width, pitch = image.shape[0], image.shape[1], lenses.pitch
    wider = lenses.radius + 2
    radius2, wider2 = np.float32(lenses.radius * lenses.radius), np.float32(wider * wider)
    # Pixel (column, row) is at the same place under the other lens if the slope is 0.
    start_x, start_y = np.float32(left + to_x - other_x), np.float32(top + row + to_y - other_y)
    centre_x, centre_y, to_x, to_y = np.float32(other_x), np.float32(other_y), np.float32(to_x), np.float32(to_y)
    seen, apart, wanted = work.seen[row * size :], work.apart[row * size :], work.wanted[row * size :]
    slopes, one = work.slope[k, row], np.uint32(1)
    seen[:size] = 0
    for column in range(work.columns[row, 0], work.columns[row, 1]):
        dx, dy = start_x + np.float32(column) + to_x * slopes[column], start_y + to_y * slopes[column]
        away, x, y = dx * dx + dy * dy, centre_x + dx, centre_y + dy
        if away > wider2 or x < 2 or y < 2 or x >= width - 3 or y >= height - 3:
            apart[column] = 0
            continue
        i, j = np.uint32(x), np.uint32(y)
        fx, fy = x - np.float32(i), y - np.float32(j)
        w11 = fx * fy
        w01, w10 = fx - w11, fy - w11
        w00 = np.float32(1.0) - fx - w10
        squares = np.float32(0.0)
        for channel in range(3):
            step = w00 * image[j, i, channel] + w01 * image[j, i + one, channel] + w10 * image[j + one, i, channel]
            step += w11 * image[j + one, i + one, channel] - image[top + row, left + column, channel]
            squares += step * step
        apart[column] = squares
        if away <= radius2 and wanted[column]:
            if before.size > 1:
                there = before[np.int32(y + np.float32(0.5)), np.int32(x + np.float32(0.5))]
                if depth_order(there, pitch) > depth_order(work.value[k, row, column], pitch) + lenses.gap:
                    continue
            seen[column] = 1


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _add_lens(first, end, size, leave_out, work):
    """Add the mismatch of pixels `first` to `end` with another lens; returns how many of them want no further one."""
    seen, allowed, mismatch = work.seen[first:end], work.allowed[first:end], work.mismatch[first:end]
    total, count, wanted = work.sum[first:end], work.count[first:end], work.wanted[first:end]
    for p in range(end - first):
        mismatch[p] = 0
    for e in range(5):
        apart = work.apart[first + _DOWN[e] * size + _ACROSS[e] :]
        for p in range(end - first):
            mismatch[p] += np.float32(0.2) * apart[p]
    for p in range(end - first):
        mismatch[p] *= seen[p] / (mismatch[p] + allowed[p])
        total[p] += mismatch[p]
        count[p] += seen[p]
    for n in range(leave_out):
        worst = work.worst[n, first:end]
        for p in range(end - first):
            worst[p], mismatch[p] = max(worst[p], mismatch[p]), min(worst[p], mismatch[p])
    full = 0
    for p in range(end - first):
        done = wanted[p] and count[p] >= _VIEWS
        full += done
        wanted[p] = wanted[p] and not done
    return full


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _start_depth(k, size, work):
    """Clear what is known of the comparison at depth k; returns how many pixels may show it."""
    number = 0
    for row in range(size):
        first, end = size, 0
        for beside in range(max(0, row - 1), min(size, row + 2)):
            for column in range(size):
                if work.open[beside, column] and work.present[k, beside, column]:
                    first, end = min(first, column - 1), max(end, column + 2)
        work.columns[row, 0], work.columns[row, 1] = max(0, first), min(size, end)
        for column in range(size):
            wanted = work.open[row, column] and work.present[k, row, column]
            work.wanted[row * size + column] = wanted
            number += wanted
    work.count[:], work.sum[:], work.worst[:] = 0, 0, 0
    return number


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _mean_of_best(p, share, c, work):
    """Mean of the `share` of the mismatches of a pixel that are the least."""
    count = int(work.count[p])
    if count == 0:
        return c.unseen
    number, total = max(1, int(share * count + 0.5), count - LEFT_OUT), work.sum[p]
    for n in range(count - number):
        total -= work.worst[n, p]
    return max(total, 0) / number


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def compare_depth(image, lens, k, share, left, top, size, lenses, before, c, work):
    """Add the mismatch with other lenses to the costs of depth k, for the pixels that may show it.

    The least `share` of the mismatches counts. If `before` is known, lenses that it finds occluded are left out.
    """
    rows, low, ring, centres = lenses.rows, lenses.low, lenses.ring, lenses.centres
    at_i, at_j = lenses.indices[lens, 0] - low[0], lenses.indices[lens, 1] - low[1]
    wanting, leave_out = _start_depth(k, size, work), LEFT_OUT if share < 1 else 0
    slope = work.depths[k] / lenses.pitch
    for r in range(1, len(ring)):
        if wanting == 0:
            break
        ci, cj = at_i + ring[r, 0], at_j + ring[r, 1]
        if ci < 0 or cj < 0 or cj >= rows.shape[0] or ci >= rows.shape[1] or rows[cj, ci] < 0:
            continue
        other_x, other_y = centres[rows[cj, ci], 0], centres[rows[cj, ci], 1]
        to_x, to_y = other_x - centres[lens, 0], other_y - centres[lens, 1]
        # The rows that both microimages show, a little more for pixels that show another depth.
        more = lenses.radius + lenses.gap * (abs(to_x) + abs(to_y)) / lenses.pitch + 1
        if np.hypot(to_x, to_y) * abs(slope) > lenses.radius + more:
            continue
        middle = centres[lens, 1] - to_y * slope - top
        first, end = max(1, int(middle - more)), min(size - 1, int(middle + more) + 2)
        for row in range(first, end):
            _look_at_row(image, left, top, row, size, k, other_x, other_y, to_x, to_y, lenses, before, work)
        if first < end:
            wanting -= _add_lens(first * size, end * size, size, leave_out, work)
    for row in range(size):
        for column in range(size):
            if work.open[row, column] and work.present[k, row, column]:
                work.cost[k, row, column] += _mean_of_best(row * size + column, share, c, work)
