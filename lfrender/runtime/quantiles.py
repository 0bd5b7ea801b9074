"""Quantiles of a few hundred numbers, for which NumPy's own take several times as long as to find them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["median", "quantile"]


def quantile(values: NDArray[Any], share: float) -> float:
    """As `np.quantile` of `values` (n,), n at least 1 and none of them NaN: linear between those beside it."""
    place = share * (len(values) - 1)
    low, high = int(place), min(int(place) + 1, len(values) - 1)
    parted = np.partition(values, (low, high))
    if place == low:
        return float(parted[low])
    return float(parted[low] + (place - low) * (parted[high] - parted[low]))


def median(values: NDArray[Any]) -> float:
    """As `np.median` of `values` (n,)."""
    return quantile(values, 0.5)
