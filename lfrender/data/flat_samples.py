"""A fingerprint of a flat: pixels on a grid, by which a depth map knows the flat that it was made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatSource

__all__ = ["is_same_flat", "sample_flat", "sample_source"]


def sample_flat(flat: NDArray) -> NDArray[np.float32]:
    """Gray values (n,) float32 of a flat (H, W) or (H, W, C) on a grid, over their mean."""
    return _sample_rows(np.asarray(flat[_places(flat.shape[0], 16)]))


def sample_source(source: FlatSource) -> NDArray[np.float32]:
    """`sample_flat` of a flat that is read in parts."""
    height, width = source.shape[:2]
    return _sample_rows(np.concatenate([source.read(0, row, width, row + 1) for row in _places(height, 16).tolist()]))


def is_same_flat(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Whether the samples of two flats are the same but for rounding; also of another type, bit depth or exposure."""
    if one.shape != other.shape:
        return False
    # Rounding to 8 bits differs by 0.01 of the standard deviation.
    return float(np.sqrt(np.mean((one - other) ** 2))) <= 0.02 * float(one.std()) + 1e-6


def _places(length: int, number: int) -> NDArray[np.int64]:
    return np.unique((np.arange(number) + 0.5) / number * length).astype(np.int64)


def _sample_rows(rows: NDArray) -> NDArray[np.float32]:
    few = rows[:, _places(rows.shape[1], 64)].astype(np.float64)
    gray = (few if few.ndim == 2 else few.mean(-1)).ravel()
    return (gray / max(float(gray.mean()), 1e-12)).astype(np.float32)
