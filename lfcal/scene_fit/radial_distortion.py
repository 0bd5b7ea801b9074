"""Radial distortion that the lenses of a scene show: its strength, and whether it is significant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from .settings import SCENE

__all__ = ["RadialEstimate", "estimate_radial"]


@dataclass(frozen=True)
class RadialEstimate:
    """Change of `k1`, its standard error, and the movement of centres by the whole distortion [px, RMS].

    What a straight lattice can follow is left to the basis.
    """

    k1: float
    error: float
    shift: float

    def is_significant(self, pitch: float) -> bool:
        """Whether a distortion of this strength exceeds what a scene without one can show, at this pitch [px]."""
        return abs(self.k1) > SCENE.distortion_significance * self.error and self.shift > SCENE.distortion_shift * pitch


def estimate_radial(
    lattice: Lattice, design: NDArray[np.float64], shift: NDArray[np.float64], weight: NDArray[np.float64],
    tile: NDArray[np.int64],
) -> RadialEstimate:  # fmt: skip
    """The distortion that explains shifts of lenses beside a straight change of the lattice.

    `shift` (n, 2) [px] are measured from the lattice, `weight` (n,) [1/px^2] their weights, `design` (n, 3) the lattice
    indices with a leading 1. Errors within one `tile` (n,) are alike, so the standard error comes from differences
    between tiles.
    """
    bend = lattice.distortion or Distortion.zero(lattice.image_size)
    straight = design @ np.vstack([lattice.origin, lattice.basis])
    column = dict(bend.derivatives(straight))["k1"]
    root = np.sqrt(weight)[:, None]
    both = np.hstack([column, shift])
    column, left = np.hsplit(both - design @ np.linalg.lstsq(design * root, both * root, rcond=None)[0], 2)
    information = float((weight[:, None] * column**2).sum())
    k1 = float((weight[:, None] * column * left).sum()) / max(information, 1e-300)
    pull = np.bincount(tile, (weight[:, None] * column * (left - k1 * column)).sum(1))
    freedom = len(pull) / max(len(pull) - 4, 1)
    error = float(np.sqrt((pull**2).sum() * freedom)) / max(information, 1e-300)
    whole = bend.k1 + k1
    return RadialEstimate(k1, error, abs(whole) * float(np.sqrt((column**2).sum(1).mean())))
