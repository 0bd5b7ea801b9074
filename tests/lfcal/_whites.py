"""White images of known lattices: antialiased discs, drawn by a formula that shares nothing with
the calibration.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice

__all__ = ["HEXAGON", "SQUARE", "centre_errors", "rms", "turned", "white_image"]

SQUARE = np.eye(2)
HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


def turned(shape: NDArray[np.float64], pitch: float, degrees: float) -> NDArray[np.float64]:
    """Basis rows of a lattice `shape` at `pitch` px, turned clockwise on the screen."""
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    return pitch * shape @ np.array([[cos, sin], [-sin, cos]])


def white_image(
    basis: NDArray[np.float64],
    size: tuple[int, int],
    *,
    fill: float = 0.92,
    soft: float = 1.0,
    gap: float = 0.03,
    noise: float = 0.01,
    origin: tuple[float, float] | None = None,
    seed: int = 0,
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """16-bit white image (h, w) and its origin (2,) [px].

    Parameters
    ----------
    basis : (2, 2) [px]
    size : (int, int) [px]
        Width and height.
    fill : float
        Disc diameter over the distance to the nearest neighbour.
    soft : float [px]
        Width of the linear ramp at the edge of a disc; 1 is an antialiased sharp edge.
    gap : float
        Light between the discs over the light in them.
    noise : float
        Standard deviation over full light.
    """
    width, height = size
    start = np.array(origin if origin is not None else (0.37 * width, 0.61 * height))
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    inverse = np.linalg.inv(basis)
    u = (x - start[0]) * inverse[0, 0] + (y - start[1]) * inverse[1, 0]
    v = (x - start[0]) * inverse[0, 1] + (y - start[1]) * inverse[1, 1]
    nearest = np.full((height, width), np.inf)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            du = u - (np.rint(u) + i)
            dv = v - (np.rint(v) + j)
            dx = du * basis[0, 0] + dv * basis[1, 0]
            dy = du * basis[0, 1] + dv * basis[1, 1]
            nearest = np.minimum(nearest, np.hypot(dx, dy))
    combos = np.array([(1, 0), (0, 1), (1, 1), (1, -1)]) @ basis
    radius = fill * np.hypot(*combos.T).min() / 2
    light = gap + (1 - gap) * np.clip((radius - nearest) / soft + 0.5, 0, 1)
    # Light falls off towards the corners as it does behind any main lens.
    light *= 1 - 0.3 * ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2)
    light += noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.rint(np.clip(light * 0.8, 0, 1) * 65535).astype(np.uint16), start


def centre_errors(lattice: Lattice, origin: ArrayLike, basis: ArrayLike) -> NDArray[np.float64]:
    """(n, 2) offset of each found centre from the nearest true one [px]; the cells must be of one
    size.
    """
    origin = np.asarray(origin)
    basis = np.asarray(basis)
    centres = lattice.centres()
    index = np.rint((centres - origin) @ np.linalg.inv(basis))
    assert len(np.unique(index, axis=0)) == len(centres), "two found centres share a true one"
    assert abs(abs(np.linalg.det(lattice.basis)) / abs(np.linalg.det(basis)) - 1) < 0.05, (
        "cells differ in size"
    )
    return centres - (origin + index @ basis)


def rms(errors: NDArray[np.float64]) -> float:
    """Root of the mean squared length of the rows [px]."""
    return float(np.sqrt((errors**2).sum(1).mean()))
