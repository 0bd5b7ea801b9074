"""Where in an average cell a microimage may have its centre: where the cell is a function of the
distance to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..lattice.cell import bin_offsets
from ..runtime.arrays import Floats

__all__ = ["CentreGuess", "find_round_centres"]


class CentreGuess(NamedTuple):
    """A possible microimage centre."""

    position: Floats  # (2,) fractional lattice coordinates, 0..1
    roundness: float  # share of the variance of the cell that the distance to it explains, 0..1


def find_round_centres(cells: list[Floats], basis: Floats) -> list[CentreGuess]:
    """Up to four points about which the average cells (bins, bins) are round, roundest first, 0.3
    pitch apart.
    """
    bins = cells[0].shape[0]
    distance = _distance_to_corner(basis, bins)
    rings = 24
    ring = np.minimum((distance / (distance.max() + 1e-9) * rings).astype(int), rings - 1)
    roundness = np.zeros((bins, bins))
    for cell in cells:
        g = cell - cell.mean()
        spectrum = np.fft.fft2(g)
        explained = np.zeros((bins, bins))
        for k in range(rings):
            mask = ring == k
            if mask.any():
                sums = np.fft.ifft2(spectrum * np.conj(np.fft.fft2(mask.astype(float)))).real
                explained += sums**2 / mask.sum()
        roundness += explained / max((g * g).sum(), 1e-30)
    roundness /= len(cells)
    pitch = np.sqrt(abs(np.linalg.det(basis)))
    guesses: list[CentreGuess] = []
    remaining = roundness.copy()
    while len(guesses) < 4 and remaining.max() > 0:
        row, column = np.unravel_index(int(remaining.argmax()), remaining.shape)
        position = (np.array([column, row]) + 0.5) / bins
        guesses.append(CentreGuess(position, float(remaining[row, column])))
        remaining[np.roll(distance, (row, column), axis=(0, 1)) < 0.3 * pitch] = 0
    return guesses


def _distance_to_corner(basis: Floats, bins: int) -> Floats:
    """(bins, bins) distance [px] from each bin to the lattice point nearest to it, if one is the
    middle of bin 0, 0.
    """
    return np.linalg.norm(bin_offsets(basis, bins, np.array([0.5, 0.5]) / bins), axis=2)
