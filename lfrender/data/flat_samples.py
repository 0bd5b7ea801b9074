"""A fingerprint of a flat: pixels on a grid, by which a depth map knows the flat that it was made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatSource

from .settings import DEFAULT, DataSettings

__all__ = ["is_same_flat", "sample_flat", "sample_source"]


def sample_flat(flat: NDArray, settings: DataSettings = DEFAULT) -> NDArray[np.float32]:
    """Gray values (n,) float32 of a flat (H, W) or (H, W, C) on a grid, over their mean."""
    rows = _places(flat.shape[0], settings.sample_rows)
    return _sample_rows(np.asarray(flat[rows]), settings)


def sample_source(source: FlatSource, settings: DataSettings = DEFAULT) -> NDArray[np.float32]:
    """`sample_flat` of a flat that is read in parts."""
    height, width = source.shape[:2]
    rows = [source.read(0, row, width, row + 1) for row in _places(height, settings.sample_rows).tolist()]
    return _sample_rows(np.concatenate(rows), settings)


def is_same_flat(one: NDArray[np.float32], other: NDArray[np.float32], settings: DataSettings = DEFAULT) -> bool:
    """Whether the samples of two flats are the same but for rounding; also of another type, bit depth or exposure."""
    if one.shape != other.shape:
        return False
    difference = float(np.sqrt(np.mean((one - other) ** 2)))
    return difference <= settings.same_samples * float(one.std()) + 1e-6


def _places(length: int, number: int) -> NDArray[np.int64]:
    return np.unique((np.arange(number) + 0.5) / number * length).astype(np.int64)


def _sample_rows(rows: NDArray, settings: DataSettings) -> NDArray[np.float32]:
    few = rows[:, _places(rows.shape[1], settings.sample_columns)].astype(np.float64)
    gray = (few if few.ndim == 2 else few.mean(-1)).ravel()
    return (gray / max(float(gray.mean()), 1e-12)).astype(np.float32)
