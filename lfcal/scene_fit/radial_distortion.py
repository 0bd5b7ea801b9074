"""Radial distortion that the lenses of a scene show: its strength and centre, and whether they are significant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from .settings import SCENE

__all__ = ["DecentredEstimate", "RadialEstimate", "estimate_decentred", "estimate_radial"]


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


@dataclass(frozen=True)
class DecentredEstimate:
    """A radial distortion about another place than the middle of the flat, as where the array is tilted.

    `k1 * x |x|^2 + 2 x (x . tilt) + tilt |x|^2` for positions `x` from the middle, over half the diagonal: expanded
    about the middle, `k1 (x - c) |x - c|^2` is that with `tilt = -k1 c`, and parts that the basis follows.
    """

    k1: float
    tilt: NDArray[np.float64]  # (2,)
    significance: float  # squared size over its covariance, per parameter
    shift: float  # [px, RMS] movement of centres, without what a straight lattice can follow

    def is_significant(self, pitch: float) -> bool:
        """Whether a distortion of this strength exceeds what a scene without one can show, at this pitch [px]."""
        return self.significance > SCENE.decentred_significance and self.shift > SCENE.decentred_shift * pitch

    def __add__(self, other: DecentredEstimate) -> DecentredEstimate:
        """Both distortions, one after the other, with the significance of the second."""
        return DecentredEstimate(self.k1 + other.k1, self.tilt + other.tilt, other.significance, other.shift)

    def distortion(self, image_size: tuple[int, int]) -> Distortion:
        """As it is kept in a lattice."""
        bend = Distortion.zero(image_size)
        k1 = self.k1 if abs(self.k1) > 1e-9 else 1e-9
        return Distortion(bend.centre - self.tilt / k1 * bend.reach, k1, 0.0, bend.reach)


def estimate_decentred(
    lattice: Lattice, design: NDArray[np.float64], shift: NDArray[np.float64], weight: NDArray[np.float64],
    tile: NDArray[np.int64],
) -> DecentredEstimate:  # fmt: skip
    """The decentred distortion that explains shifts of lenses; arguments are those of `estimate_radial`."""
    zero = Distortion.zero(lattice.image_size)
    place = (design @ np.vstack([lattice.origin, lattice.basis]) - zero.centre) / zero.reach
    square = (place**2).sum(1, keepdims=True)
    tilts = [2 * place * place[:, [axis]] + square * np.eye(2)[axis] for axis in range(2)]
    both = np.hstack([zero.reach * place * square, *(zero.reach * tilt for tilt in tilts), shift])
    root = np.sqrt(weight)[:, None]
    both = both - design @ np.linalg.lstsq(design * root, both * root, rcond=None)[0]
    columns, left = both[:, :6].reshape(-1, 3, 2), both[:, 6:]
    information = np.einsum("n,nkd,nld->kl", weight, columns, columns)
    found = np.linalg.lstsq(information, np.einsum("n,nkd,nd->k", weight, columns, left), rcond=None)[0]
    moved = np.einsum("k,nkd->nd", found, columns)
    pull = np.zeros((int(tile.max()) + 1, 3))
    np.add.at(pull, tile, np.einsum("n,nkd,nd->nk", weight, columns, left - moved))
    bread = np.linalg.pinv(information)
    covariance = bread @ (pull.T @ pull) @ bread * len(pull) / max(len(pull) - 6, 1)
    significance = float(found @ np.linalg.pinv(covariance) @ found) / 3
    return DecentredEstimate(float(found[0]), found[1:], significance, float(np.sqrt((moved**2).sum(1).mean())))
