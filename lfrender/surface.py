"""The depth of every scene point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["Surface"]


@njit(cache=True, nogil=True, parallel=True)
def _nearest(values, first_x, first_y, spacing, points, out):
    rows, columns = values.shape
    for k in prange(len(out)):
        u, v = np.rint((points[k, 0] - first_x) / spacing), np.rint((points[k, 1] - first_y) / spacing)
        out[k] = values[min(max(int(v), 0), rows - 1), min(max(int(u), 0), columns - 1)]


@dataclass(frozen=True)
class Surface:
    """Signed patch size on a regular grid of scene points.

    Parameters
    ----------
    patch_size : (h, w) float32 [px]
        Finite everywhere.
    first : (float, float) [px]
        Scene coordinates of grid value `[0, 0]`, order `x, y`.
    spacing : float [px]
        Distance between grid values in scene coordinates.
    """

    patch_size: NDArray[np.float32]
    first: tuple[float, float]
    spacing: float

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n,) float32 [px]: patch size of the grid value nearest to scene points (n, 2)."""
        out = np.empty(len(points), np.float32)
        _nearest(self.patch_size, *self.first, self.spacing, points, out)
        return out
