"""A few pixels of a flat, by which a depth map recognises the flat that it was made from."""

from __future__ import annotations

import numpy as np

from lfcal import FlatSource
from lfcal.runtime.arrays import Array, Integers, Singles

__all__ = ["is_same_flat", "sample_flat"]

# Rows and columns of a flat whose pixels distinguish it from other flats.
_SAMPLED_ROWS = 16
_SAMPLED_COLUMNS = 64
# Largest RMS difference between samples of one flat, as a share of their standard deviation:
# rounding to 8 bits makes 0.01.
_ROUNDING = 0.02


def sample_flat(flat: Array | FlatSource) -> Singles:
    """Gray values (n,) of a flat (H, W) or (H, W, C) on a grid, divided by their mean."""
    height, width = flat.shape[:2]
    chosen = _spread(_SAMPLED_ROWS, height)
    if isinstance(flat, FlatSource):
        rows = np.concatenate([flat.read(0, row, width, row + 1) for row in chosen.tolist()])
    else:
        rows = np.asarray(flat[chosen])
    gray = rows[:, _spread(_SAMPLED_COLUMNS, width)].astype(np.float64)
    if gray.ndim > 2:
        gray = gray.mean(-1)
    gray = gray.ravel()
    return (gray / max(float(gray.mean()), 1e-12)).astype(np.float32)


def _spread(count: int, length: int) -> Integers:
    """At most `count` numbers, evenly spread over those below a length."""
    return np.unique((np.arange(count) + 0.5) / count * length).astype(int)


def is_same_flat(one: Singles, other: Singles) -> bool:
    """Whether samples of two flats differ by rounding only.

    Type, bit depth and exposure of the flats may differ.
    """
    if one.shape != other.shape:
        return False
    difference = np.sqrt(np.mean((one - other) ** 2))
    return bool(difference <= _ROUNDING * one.std() + 1e-6)
