"""Pictures between their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["at_places"]


def at_places(picture: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...,) the picture at `places` (..., 2) [px], linear between its pixels."""
    x, y = np.moveaxis(places, -1, 0)
    column = np.clip(x.astype(np.int64), 0, picture.shape[1] - 2)
    row = np.clip(y.astype(np.int64), 0, picture.shape[0] - 2)
    right, low = x - column, y - row
    above = picture[row, column] * (1 - right) + picture[row, column + 1] * right
    below = picture[row + 1, column] * (1 - right) + picture[row + 1, column + 1] * right
    return np.asarray(above * (1 - low) + below * low)
