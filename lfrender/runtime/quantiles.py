"""Quantiles of a few hundred numbers, several times as fast as `np.quantile`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["quantile"]


def quantile(values: NDArray[Any], share: float) -> float:
    """As `np.quantile` of `values` (n,), n at least 1 and none NaN, with linear interpolation."""
    place = share * (len(values) - 1)
    low, high = int(place), min(int(place) + 1, len(values) - 1)
    parted = np.partition(values, (low, high))
    if place == low:
        return float(parted[low])
    return float(parted[low] + (place - low) * (parted[high] - parted[low]))
