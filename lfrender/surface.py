"""The depth of every scene point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Surface"]


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
        rows, columns = self.patch_size.shape
        u, v = np.rint((points - np.array(self.first)) / self.spacing).astype(int).T
        return self.patch_size[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)]
