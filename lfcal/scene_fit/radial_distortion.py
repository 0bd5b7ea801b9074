"""Radial distortion that the lenses of a scene show: its strength and centre, and whether they are significant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice

__all__ = ["RadialEstimate", "estimate_radial"]


@dataclass(frozen=True)
class RadialEstimate:
    """A radial distortion about the middle of the flat, or, where the array is tilted, about another place.

    `k1 * x |x|^2 + 2 x (x . tilt) + tilt |x|^2` for positions `x` from the middle, over half the diagonal: expanded
    about the middle, `k1 (x - c) |x - c|^2` is that with `tilt = -k1 c`, and parts that the basis follows.
    """

    k1: float
    tilt: NDArray[np.float64]  # (2,) zero about the middle
    significance: float  # squared size over its covariance, per parameter
    shift: float  # [px, RMS] movement of centres, without what a straight lattice can follow

    def is_significant(self, pitch: float) -> bool:
        """Whether a distortion of this strength exceeds what a scene without one can show, at this pitch [px].

        Scenes without one reach 9 and 0.001 pitches, with a tilt 12 and 0.003 pitches.
        """
        tilted = self.tilt.any()
        return self.significance > (20 if tilted else 64) and self.shift > (0.005 if tilted else 0.003) * pitch

    def __add__(self, other: RadialEstimate) -> RadialEstimate:
        """Both distortions, one after the other, with the significance of the second."""
        return RadialEstimate(self.k1 + other.k1, self.tilt + other.tilt, other.significance, other.shift)

    def distortion(self, image_size: tuple[int, int]) -> Distortion:
        """As it is kept in a lattice."""
        bend = Distortion.zero(image_size)
        k1 = self.k1 if abs(self.k1) > 1e-9 else 1e-9
        return Distortion(bend.centre - self.tilt / k1 * bend.reach, k1, 0.0, bend.reach)


def estimate_radial(
    lattice: Lattice, design: NDArray[np.float64], shift: NDArray[np.float64], weight: NDArray[np.float64],
    tile: NDArray[np.int64], tilted: bool,
) -> RadialEstimate:  # fmt: skip
    """The distortion that explains shifts of lenses beside a straight change of the lattice, with a tilt if `tilted`.

    `shift` (n, 2) [px] are measured from the lattice, `weight` (n,) [1/px^2] their weights, `design` (n, 3) the lattice
    indices with a leading 1. Errors within one `tile` (n,) are alike, so the standard error comes from differences
    between tiles.
    """
    zero = Distortion.zero(lattice.image_size)
    place = (design @ np.vstack([lattice.origin, lattice.basis]) - zero.centre) / zero.reach
    square = (place**2).sum(1, keepdims=True)
    tilts = [2 * place * place[:, [axis]] + square * np.eye(2)[axis] for axis in range(2)] if tilted else []
    both = np.hstack([*(zero.reach * column for column in (place * square, *tilts)), shift])
    root = np.sqrt(weight)[:, None]
    both = both - design @ np.linalg.lstsq(design * root, both * root, rcond=None)[0]
    count = 1 + len(tilts)
    columns, left = both[:, :-2].reshape(-1, count, 2), both[:, -2:]
    information = np.einsum("n,nkd,nld->kl", weight, columns, columns)
    found = np.linalg.lstsq(information, np.einsum("n,nkd,nd->k", weight, columns, left), rcond=None)[0]
    moved = np.einsum("k,nkd->nd", found, columns)
    pull = np.zeros((int(tile.max()) + 1, count))
    np.add.at(pull, tile, np.einsum("n,nkd,nd->nk", weight, columns, left - moved))
    bread = np.linalg.pinv(information)
    covariance = bread @ (pull.T @ pull) @ bread * len(pull) / max(len(pull) - 3 - count, 1)
    significance = float(found @ np.linalg.pinv(covariance) @ found) / count
    tilt = found[1:] if tilted else np.zeros(2)
    return RadialEstimate(float(found[0]), tilt, significance, float(np.sqrt((moved**2).sum(1).mean())))
