"""Where in an average cell a microimage may have its centre: where the cell is a function of the
distance to it.
"""

from __future__ import annotations

import numpy as np

from ..lattice.cell import bin_offsets, cell_side
from ..runtime.arrays import Floats

__all__ = ["find_round_centres"]


def find_round_centres(cells: list[Floats], basis: Floats) -> list[Floats]:
    """Up to four points about which the average cells (bins, bins) are round, roundest first, 0.3
    pitch apart.

    Points (2,) are in fractional lattice coordinates, 0..1. Cells are round as far as the distance
    to the point explains their variance.
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
    pitch = cell_side(basis)
    guesses: list[Floats] = []
    while len(guesses) < 4 and roundness.max() > 0:
        row, column = np.unravel_index(int(roundness.argmax()), roundness.shape)
        guesses.append((np.array([column, row]) + 0.5) / bins)
        roundness[np.roll(distance, (row, column), axis=(0, 1)) < 0.3 * pitch] = 0
    return guesses


def _distance_to_corner(basis: Floats, bins: int) -> Floats:
    """(bins, bins) distance [px] from each bin to the lattice point nearest to it, if one is the
    middle of bin 0, 0.
    """
    return np.linalg.norm(bin_offsets(basis, bins, np.array([0.5, 0.5]) / bins), axis=2)
