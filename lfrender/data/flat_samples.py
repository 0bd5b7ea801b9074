"""A fingerprint of a flat: pixels on a grid, by which a depth map knows the flat that it was made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatSource

__all__ = ["is_same_flat", "sample_flat"]


def sample_flat(flat: NDArray | FlatSource) -> NDArray[np.float32]:
    """Gray values (n,) float32 of a flat (H, W) or (H, W, C), in memory or not, on a grid, over their mean."""
    height, width = flat.shape[:2]
    at = [np.unique((np.arange(n) + 0.5) / n * length).astype(int) for n, length in ((16, height), (64, width))]
    if isinstance(flat, FlatSource):
        rows = np.concatenate([flat.read(0, row, width, row + 1) for row in at[0].tolist()])
    else:
        rows = np.asarray(flat[at[0]])
    few = rows[:, at[1]].astype(np.float64)
    gray = (few if few.ndim == 2 else few.mean(-1)).ravel()
    return (gray / max(float(gray.mean()), 1e-12)).astype(np.float32)


def is_same_flat(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Whether the samples of two flats are the same but for rounding; also of another type, bit depth or exposure."""
    # Rounding to 8 bits differs by 0.01 of the standard deviation.
    return one.shape == other.shape and bool(np.sqrt(np.mean((one - other) ** 2)) <= 0.02 * one.std() + 1e-6)
