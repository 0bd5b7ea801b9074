"""Corners of boards as single microimages show them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Frozen

__all__ = ["Observations"]


@dataclass(frozen=True, eq=False)
class Observations(Frozen):
    """Corners seen in microimages, sorted by pose.

    Parameters
    ----------
    pose : (n,) int64
        Which flat.
    corner : (n,) int64
        Which point of the board.
    centre : (n, 2) float64 [px]
        Of the microimage.
    position : (n, 2) float64 [px]
        Where on the flat the corner is seen.
    error : (n,) float64 [px]
        Standard error of `position` along each axis; 1 where only ratios are known.
    """

    pose: NDArray[np.int64]
    corner: NDArray[np.int64]
    centre: NDArray[np.float64]
    position: NDArray[np.float64]
    error: NDArray[np.float64]

    def __post_init__(self) -> None:
        order = np.argsort(self.pose, kind="stable")
        self._set(
            pose=np.asarray(self.pose, np.int64)[order],
            corner=np.asarray(self.corner, np.int64)[order],
            centre=np.asarray(self.centre, np.float64)[order],
            position=np.asarray(self.position, np.float64)[order],
            error=np.asarray(self.error, np.float64)[order],
        )

    def __len__(self) -> int:
        return len(self.pose)
