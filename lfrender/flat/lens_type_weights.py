"""Weights of the lens types of a multi-focus array over depth: the type in focus dominates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import LensTypes

__all__ = ["WEIGHT_RATIOS", "focus_weights", "type_shares"]

#: The `s / D` at which weights are tabulated.
WEIGHT_RATIOS = np.linspace(-1, 1, 401)
# Distance from its focus within which a lens type is practically sharp [s / D].
_SHARP = 0.1


def focus_weights(types: LensTypes | None) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Type (m, m) of lens `(i, j)` at `[i % m, j % m]`, and weights (count, r) of each at
    `WEIGHT_RATIOS`.

    (0, 0) types if all have equal weight. The blur of a microlens grows with the distance of `s /
    D` from its focus; the weight of a type falls with the square of that, relative to the type
    nearest to focus.
    """
    if (
        types is None
        or types.focus is None
        or types.count < 2
        or not np.isfinite(types.focus).all()
    ):
        return np.zeros((0, 0), np.int8), np.ones((1, len(WEIGHT_RATIOS)), np.float32)
    distance = np.abs(WEIGHT_RATIOS - types.focus[:, None]) + _SHARP
    # Writable as above: for read-only arrays, kernels are compiled anew.
    return types.cell.copy(), ((distance.min(0) / distance) ** 2).astype(np.float32)


def type_shares(
    types: LensTypes | None, ratios: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """(count, n) shares of the types in pictures at these `s / D`, whose sum is 1; alike if they
    have equal weight.
    """
    weights = focus_weights(types)[1]
    if len(weights) != count:
        return np.full((count, len(ratios)), 1 / count)
    shares = np.stack([np.interp(ratios, WEIGHT_RATIOS, one) for one in weights])
    return shares / shares.sum(0)
