"""Boards that are not as flat and square as they should be: a bend and a stretch that all poses share.

Out of its plane a board is bent by a quadratic surface, in its plane stretched along one diagonal or axis against the
other; neither changes its size, by which everything is measured. A bend of a twohundredth of the width looks like a
focal length that is several per cent off (deformable calibration targets: Strobl and Hirzinger 2011).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SHAPE", "deform", "shape_derivatives"]

Array = NDArray[Any]

#: Displacements [mm] at the ends of the longer side, of points at `x, y` of -1..1: away from the camera by
#: `x^2, x y, y^2`; in the plane by `(x, -y)` and `(y, x)`.
SHAPE = ("bend_xx", "bend_xy", "bend_yy", "stretch", "shear")


def shape_derivatives(board: Array) -> Array:
    """(k, 3, 5) displacements of the points (k, 3) [mm] of a board, about its middle, by `SHAPE`."""
    x, y = board[:, :2].T / max(float(np.abs(board[:, :2]).max()), 1e-12)
    zero = np.zeros_like(x)
    columns = [[zero, zero, x * x], [zero, zero, x * y], [zero, zero, y * y], [x, -y, zero], [y, x, zero]]
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


def deform(board: Array, shape: Array) -> Array:
    """(k, 3) [mm] points of a flat board with the `shape` (5,) [mm]."""
    return board + shape_derivatives(board) @ shape
