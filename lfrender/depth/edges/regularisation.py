"""Semi-global matching (Hirschmueller 2008) of the pixels inside one microimage."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["aggregate"]


@njit(error_model="numpy")
def _aggregate_line(number, gap, c, p, step, steps, work):
    """Add one path of semi-global matching to the total: `steps` pixels `step` apart, from p on."""
    previous, current, value, cost, total, among, light = (
        work.path[0], work.path[1], work.value, work.cost, work.total, work.among, work.light
    )  # fmt: skip
    lowest = np.float32(0.0)
    for n in range(steps):
        if among[p] == 1 or n == 0:
            # Settled, or the first: nothing reaches it.
            for k in range(number):
                current[k] = cost[k, p]
        else:
            # The price of a depth edge is lower where the brightness differs.
            edge = light[p] - light[p - step]
            jump = c.jump / (1 + edge * edge / c.edge2)
            for k in range(number):
                best, s = jump, value[k, p]
                for q in range(max(0, k - 1), min(number, k + 2)):
                    # Depths ascend: others than those beside it are a jump away.
                    if abs(s - value[q, p - step]) < gap:
                        best = min(best, previous[q] - lowest)
                current[k] = cost[k, p] + best
        lowest = current[0]
        for k in range(number):
            total[k, p] += current[k]
            previous[k] = current[k]
            lowest = min(lowest, current[k])
        p += step


@njit(error_model="numpy")
def aggregate(size, stride, number, gap, c, work):
    """Semi-global matching along four directions inside a microimage, about the pixels that are not settled."""
    among, upper, lower = work.among, work.upper, work.lower
    work.total[:number] = 0
    upper[:], lower[:] = size, 0
    for row in range(size):
        begin, end = size, 0
        for column in range(work.left[row], work.right[row]):
            if among[row * stride + column] != 1:
                begin, end = min(begin, column), column + 1
                upper[column], lower[column] = min(upper[column], row), row + 1
        if end:
            # With the settled pixel at either end.
            begin, end = max(begin - 1, work.left[row]), min(end + 1, work.right[row])
            _aggregate_line(number, gap, c, row * stride + begin, 1, end - begin, work)
            _aggregate_line(number, gap, c, row * stride + end - 1, -1, end - begin, work)
    for column in range(size):
        begin, end = upper[column], lower[column]
        if end:
            if begin > 0 and work.left[begin - 1] <= column < work.right[begin - 1]:
                begin -= 1
            if end < size and work.left[end] <= column < work.right[end]:
                end += 1
            _aggregate_line(number, gap, c, begin * stride + column, stride, end - begin, work)
            _aggregate_line(number, gap, c, (end - 1) * stride + column, -stride, end - begin, work)
