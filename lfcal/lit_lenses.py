"""Lenses that get light: an array need not fill the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["lit_lenses"]


def lit_lenses(
    picture: NDArray[np.float32],
    lattice: Lattice,
    indices: NDArray[np.int64],
    centres: NDArray[np.float64],
    dark: float,
) -> NDArray[np.bool_]:
    """(n,) whether lenses are lit and not beside a dark one: the border of an array cuts some.

    Parameters
    ----------
    picture : (h, w) float32
        Light, or a tone of it.
    lattice : Lattice [px]
    indices, centres : (n, 2)
        Lenses, their centres in the picture at least 1.5 px inside.
    dark : float
        Share of the value of a bright lens below which one is dark.
    """
    at = np.rint(centres).astype(int)
    core = np.zeros(len(at))
    for y in (-1, 0, 1):
        for x in (-1, 0, 1):
            core += picture[at[:, 1] + y, at[:, 0] + x]
    shut = core < dark * np.quantile(core, 0.95) if len(core) else np.zeros(0, dtype=bool)
    if not shut.any():
        return ~shut
    low = indices.min(0) - 1
    grid = np.zeros(indices.max(0) - low + 2, dtype=bool)
    grid[tuple((indices[shut] - low).T)] = True
    beside = shut.copy()
    for step in lattice.steps:
        beside |= grid[tuple((indices - low + step).T)]
    return ~beside
