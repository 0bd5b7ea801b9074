"""Normal equations of a few unknowns, solved inside kernels by Cholesky factors."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["solve_cholesky"]


@njit(error_model="numpy")
def solve_cholesky(left, right, out):
    """Solve `left @ out = right`; `left`, of which the lower half is read, becomes its Cholesky factor."""
    for i in range(len(right)):
        for j in range(i + 1):
            total = left[i, j]
            for k in range(j):
                total -= left[i, k] * left[j, k]
            left[i, j] = np.sqrt(total) if i == j else total / left[j, j]
    count = len(right)
    for i in range(count):
        total = right[i]
        for k in range(i):
            total -= left[i, k] * out[k]
        out[i] = total / left[i, i]
    for i in range(count - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, count):
            total -= left[k, i] * out[k]
        out[i] = total / left[i, i]
