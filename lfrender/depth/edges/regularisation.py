"""Semi-global matching (Hirschmueller 2008) of the pixels inside one microimage."""

from __future__ import annotations

import numpy as np

from lfcal.runtime.kernels.jit import njit

__all__ = ["aggregate", "price_jumps"]


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def price_jumps(image, left, top, size, c, work):
    """Prices of depth edges between neighbouring pixels: lower where their colours differ."""
    for direction in range(2):
        down, across = direction, 1 - direction
        for row in range(size - down):
            for column in range(size - across):
                if work.inside[row, column] and work.inside[row + down, column + across]:
                    apart = np.float32(0.0)
                    for channel in range(3):
                        step = image[top + row, left + column, channel]
                        step -= image[top + row + down, left + column + across, channel]
                        apart += step * step
                    work.jumps[direction, row, column] = c.jump * np.exp(-apart / c.edge2)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _aggregate_line(work, size, number, gap, v, u, down, across):
    """Add one path of semi-global matching, from pixel (u, v) on, to the total."""
    previous, current, jumps = work.path[0], work.path[1], work.jumps[abs(down)]
    lowest, linked = np.float32(0.0), False
    for _ in range(size):
        if work.inside[v, u]:
            if linked:
                # Between a pixel and the next, in the order of rows or columns.
                jump = jumps[v - max(down, 0), u - max(across, 0)]
                for k in range(number):
                    best = jump
                    for q in range(max(0, k - 1), min(number, k + 2)):
                        # Depths ascend: others than those beside it are a jump away.
                        if abs(work.value[k, v, u] - work.value[q, v - down, u - across]) < gap:
                            best = min(best, previous[q] - lowest)
                    current[k] = work.cost[k, v, u] + best
            else:
                for k in range(number):
                    current[k] = work.cost[k, v, u]
            lowest = current[0]
            for k in range(number):
                work.total[k, v, u] += current[k]
                previous[k] = current[k]
                lowest = min(lowest, current[k])
            linked = True
        else:
            linked = False
        v, u = v + down, u + across


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def aggregate(size, number, gap, work):
    """Semi-global matching along four directions inside a microimage."""
    work.total[:number] = 0
    last = size - 1
    for line in range(size):
        _aggregate_line(work, size, number, gap, line, 0, 0, 1)
        _aggregate_line(work, size, number, gap, line, last, 0, -1)
        _aggregate_line(work, size, number, gap, 0, line, 1, 0)
        _aggregate_line(work, size, number, gap, last, line, -1, 0)
