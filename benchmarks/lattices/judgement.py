"""Whether a lattice is right: its points are the true centres, no more and no fewer."""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

import lfcal

__all__ = ["RIGHT", "LatticeError", "compare_with_centres"]

#: [pitch] RMS distance from the true centres up to which a lattice is right.
RIGHT = 0.05


@dataclass(frozen=True)
class LatticeError:
    """How a lattice compares with true centres.

    Parameters
    ----------
    distance : float [pitch]
        RMS distance of the true centres from the lattice points next to them.
    cells : int
        Lattice cells for each true centre; 0 where two centres have the same point.
    """

    distance: float
    cells: int

    @property
    def is_right(self) -> bool:
        """Whether this is the true lattice."""
        return self.cells == 1 and self.distance < RIGHT


def compare_with_centres(lattice: lfcal.Lattice, centres: NDArray[np.float64]) -> LatticeError:
    """Compare a lattice with true centres (n, 2) [px]."""
    index = np.rint(lattice.to_index(centres))
    away = lattice.points(index) - centres
    distance = float(np.sqrt((away**2).sum(1).mean()) / lattice.pitch)
    whole = index.astype(np.int64)
    if len(np.unique(whole, axis=0)) < len(whole):
        return LatticeError(distance, 0)
    steps = whole[1:] - whole[:-1]
    turns = steps[1:, 0] * steps[:-1, 1] - steps[1:, 1] * steps[:-1, 0]
    cells = 0
    for turn in turns.tolist():
        cells = gcd(cells, turn)
    return LatticeError(distance, cells)
