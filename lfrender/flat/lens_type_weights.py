"""Multi-focus arrays: how much the lenses of each type count at each depth, so that the type in focus leads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import LensTypes

__all__ = ["WEIGHT_STEPS", "focus_weights"]

# Steps of the table over s / D from -1 to 1.
WEIGHT_STEPS = 401
# Within this distance of s / D from its focus a type is as good as sharp, and beyond it its weight falls with this
# power: on ray-traced slopes a steeper fall gains more, but at depth edges and against noise every lens is needed.
_SHARP, _STEEPNESS = 0.1, 2.0


def focus_weights(types: LensTypes | None) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Weights of the lens types over depth.

    The blur of a microlens grows with the distance of `s / D` from its focus (docs/geometry.md: `s / D` is nearly
    `b / a`, an inverse distance). A type counts by how near to its focus a depth lies, relative to the type that is
    nearest.

    Parameters
    ----------
    types : LensTypes or None

    Returns
    -------
    cell : (m, m) int8
        Type of lens `(i, j)` at `[i % m, j % m]`; (0, 0) where all lenses count alike.
    shares : (count, RATIOS) float32
        Weight of each type, 0..1, at `s / D` from -1 to 1.
    """
    if types is None or types.focus is None or types.count < 2 or not np.isfinite(types.focus).all():
        return np.zeros((0, 0), np.int8), np.ones((1, WEIGHT_STEPS), np.float32)
    distance = np.abs(np.linspace(-1, 1, WEIGHT_STEPS) - types.focus[:, None]) + _SHARP
    return types.cell, ((distance.min(0) / distance) ** _STEEPNESS).astype(np.float32)
