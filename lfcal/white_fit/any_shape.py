"""Microimages of any shape that half a turn does not change, such as hexagons.

They are compared with their mean microimage, a picture of one cell, which follows straight edges
and corners. It is blurred over half a pixel: centres of round microimages and of square cells are
better known by their own models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..lattice.lattice import Lattice
from ..microimage.fit import Step, Sums
from ..microimage.lens_equations import build_lens_equations
from ..microimage.mean_cell import average_cells
from ..runtime.arrays import Floats, Singles
from .lenses import Lenses

__all__ = ["AnyMicroimages"]

# Pixels that are used.
_PIXELS = 6e5
# [1/px] Bins of the mean microimage. With 3 of them, pixels of a lattice of nearly whole numbers
# fall on the same side of their bins, and centres of hexagons are up to 0.008 px off.
_BINS = 8
# Most bins each way.
_MOST_BINS = 400


@dataclass(frozen=True)
class AnyMicroimages(Lenses):
    """Microimages that are compared with their mean."""

    lattice: Lattice
    mean: Singles  # (b * b, 4) of `average_cells`

    @classmethod
    def of(cls, lenses: Lenses, lattice: Lattice) -> AnyMicroimages:
        """Some of the microimages, with their mean about the centres of the lattice."""
        few = lenses.thin(_PIXELS)
        return cls(**few.given, lattice=lattice, mean=np.zeros((0, 4), np.float32)).at(lattice)

    def at(self, lattice: Lattice) -> AnyMicroimages:
        """The same with the centres of a lattice, and the mean about them."""
        moved = super().at(lattice)
        picture, centres = moved._stacked()
        bins = int(min(_BINS * lattice.pitch, _MOST_BINS))
        mean = average_cells(picture, lattice, centres, self.cell, bins)
        return replace(moved, lattice=lattice, mean=mean)

    def sums(self) -> Sums:
        """Normal equations about the mean microimage; gains are not fitted."""
        picture, centres = self._stacked()
        normal = np.zeros((len(centres), 3, 3))
        right = np.zeros((len(centres), 3))
        normal[:, :2, :2], right[:, :2], _ = build_lens_equations(
            picture, self.lattice, centres, self.cell, self.mean
        )
        normal[:, 2, 2] = 1
        return Sums(normal, right, np.zeros((0, 0, 6)))

    def learn(self, sums: Sums, step: Step, lattice: Lattice) -> AnyMicroimages:
        """The microimages with the mean about the centres of `lattice`."""
        return self.at(lattice)

    def _stacked(self) -> tuple[Singles, Floats]:
        """Windows below each other (n * k, k), made even, and the centres (n, 2) [px] there."""
        even = self.even(shaded=True)
        side = even.shape[1]
        centres = self.centres - self.corners
        centres[:, 1] += side * np.arange(len(centres))
        return even.astype(np.float32).reshape(-1, side), centres
