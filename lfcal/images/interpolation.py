"""Linear interpolation of pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..runtime.kernels import kernel

__all__ = ["interpolate_linear"]


@kernel(error_model="numpy")
def _interpolate(picture, positions, out):
    height, width = picture.shape
    for k in range(len(positions)):
        x, y = positions[k, 0], positions[k, 1]
        column, row = min(max(int(x), 0), width - 2), min(max(int(y), 0), height - 2)
        right, low = x - column, y - row
        above = picture[row, column] * (1 - right) + picture[row, column + 1] * right
        below = picture[row + 1, column] * (1 - right) + picture[row + 1, column + 1] * right
        out[k] = above * (1 - low) + below * low


def interpolate_linear(picture: NDArray[np.float32], positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...,) bilinear interpolation of a picture at positions `positions` (..., 2) [px]."""
    values = np.empty(positions.shape[:-1])
    _interpolate(picture, positions.reshape(-1, 2), values.reshape(-1))
    return values
