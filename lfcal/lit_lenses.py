"""Lenses that get light: an array need not fill the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice, reduce_basis

__all__ = ["lit_lenses"]

# Gaps are seen where they are darker than lenses by this share of the light; else dark lenses are told by their middle.
_GAPS = 0.3
# Quantile of the lenses that is a bright one, without being dust or a hot pixel.
_BRIGHT = 0.95


def lit_lenses(
    picture: NDArray[np.float32],
    lattice: Lattice,
    indices: NDArray[np.int64],
    centres: NDArray[np.float64],
    dark: float,
) -> NDArray[np.bool_]:
    """(n,) whether lenses are lit and not beside a dark one: the border of an array cuts some.

    Stray light reaches places without a lens too, so it is the step from a lens to the gaps around it that counts.

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
    if len(centres) == 0:
        return np.zeros(0, dtype=bool)
    at = np.rint(centres).astype(int)
    core = np.zeros(len(at))
    for y in (-1, 0, 1):
        for x in (-1, 0, 1):
            core += picture[at[:, 1] + y, at[:, 0] + x]
    core /= 9
    step = core - _gaps(picture, lattice, centres)
    seen = np.quantile(step, _BRIGHT) > _GAPS * np.quantile(core, _BRIGHT)
    value = step if seen else core
    shut = value < dark * np.quantile(value, _BRIGHT)
    if not shut.any():
        return ~shut
    low = indices.min(0) - 1
    grid = np.zeros(indices.max(0) - low + 2, dtype=bool)
    grid[tuple((indices[shut] - low).T)] = True
    beside = shut.copy()
    for neighbour in lattice.steps:
        beside |= grid[tuple((indices - low + neighbour).T)]
    return ~beside


def _gaps(picture: NDArray[np.float32], lattice: Lattice, centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) mean of a picture at the six corners of the cells of lenses, where three or four lenses meet."""
    a, b = reduce_basis(lattice.basis)
    corner = np.linalg.solve(np.array([a, b]), [a @ a / 2, b @ b / 2])
    total = np.zeros(len(centres))
    limit = np.array(picture.shape[::-1]) - 1
    for place in (corner, corner - a, corner - b):
        for offset in (place, -place):
            x, y = np.clip(np.rint(centres + offset).astype(int), 0, limit).T
            total += picture[y, x]
    return total / 6
