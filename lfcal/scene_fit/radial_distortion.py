"""Whether the lenses of a scene ask for a radial distortion of their lattice, and for how strong a one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice

__all__ = ["RadialEstimate", "estimate_radial", "zero_distortion"]

# Distortion must be known to so many standard errors, and move centres by this share of the pitch (RMS): scenes bend a
# straight lattice by three standard errors and a thousandth of the pitch.
_SURE, _MATTERS = 8.0, 0.003


@dataclass(frozen=True)
class RadialEstimate:
    """Change of `k1` that lenses ask for, its standard error, and by how many px (RMS) it moves centres.

    What a straight lattice can follow is left to the basis.
    """

    k1: float
    error: float
    moves: float

    def clear(self, pitch: float) -> bool:
        """Whether a distortion of this strength is beyond what scenes feign, at this pitch [px]."""
        return abs(self.k1) > _SURE * self.error and self.moves > _MATTERS * pitch


def zero_distortion(lattice: Lattice) -> Distortion:
    """A distortion of no strength about the middle of the flat."""
    middle, reach = (np.array(lattice.image_size) - 1) / 2, float(np.hypot(*lattice.image_size) / 2)
    return Distortion(middle, 0.0, 0.0, reach)


def estimate_radial(
    lattice: Lattice, design: NDArray[np.float64], step: NDArray[np.float64], share: NDArray[np.float64],
    tile: NDArray[np.int64],
) -> RadialEstimate:  # fmt: skip
    """The distortion that lenses ask for beside a straight change of the lattice.

    Parameters
    ----------
    lattice : Lattice [px]
        The one the steps are from.
    design : (n, 3) float64
        Lattice indices with a leading 1.
    step, share : (n, 2), (n,) float64 [px, 1/px^2]
        Where single lenses ask the lattice to go, and their weights.
    tile : (n,) int64
        Part of the flat each is in: lenses of one are misled alike, so the error follows from how parts differ.
    """
    bend = lattice.distortion or zero_distortion(lattice)
    straight = design @ np.vstack([lattice.origin, lattice.basis])
    column = dict(bend.derivatives(straight))["k1"]
    root = np.sqrt(share)[:, None]
    both = np.hstack([column, step])
    column, left = np.hsplit(both - design @ np.linalg.lstsq(design * root, both * root, rcond=None)[0], 2)
    information = float((share[:, None] * column**2).sum())
    k1 = float((share[:, None] * column * left).sum()) / max(information, 1e-300)
    pull = np.bincount(tile, (share[:, None] * column * (left - k1 * column)).sum(1))
    freedom = len(pull) / max(len(pull) - 4, 1)
    error = float(np.sqrt((pull**2).sum() * freedom)) / max(information, 1e-300)
    whole = bend.k1 + k1
    return RadialEstimate(k1, error, abs(whole) * float(np.sqrt((column**2).sum(1).mean())))
