"""Primitive cell of the lattice, and where in it the microimages have their centres, from average cells of a flat.

The centre is where the average cell is most nearly a function of the distance to it (correlation with rings).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..lattice.cell import bin_offsets
from ..lattice.lattice import reduce_basis
from ..runtime.arrays import Floats

__all__ = ["CentreGuess", "choose_lens_centre", "find_primitive_cell", "find_round_centres", "is_checkerboard"]

_OTHER_ENERGY = 0.3  # energy not repeated in a smaller cell: lens types leave 0.2, lenses and gaps 0.5
_GAP_LIGHT = 0.85  # most of a gap over that of a lens, unless the picture has been flattened


class CentreGuess(NamedTuple):
    """A possible microimage centre."""

    position: Floats  # (2,) fractional lattice coordinates, 0..1
    roundness: float  # share of the variance of the average cell explained by the distance to this point, 0..1


def find_primitive_cell(cells: list[Floats], basis: Floats, again: list[Floats] | None = None) -> Floats:
    """Smallest lattice on which the average cells repeat, `basis` (2, 2) [px] itself or a finer one.

    Arrays with several lens types repeat exactly only with a cell two, three or four times as large, and their blur
    differs from lens to lens; but microimages of all types have the same outline, and are one lattice.

    `cells` are the average cells (bins, bins) of each feature, bins a multiple of 6; `again` the same from another part
    of the flat, so that noise cancels.
    """
    power = np.zeros(cells[0].shape)
    for cell, other in zip(cells, cells if again is None else again, strict=True):
        energy = (np.fft.fft2(cell - cell.mean()) * np.conj(np.fft.fft2(other - other.mean()))).real
        power += energy / max(float(energy.sum()), 1e-30)
    # In sixths of a cell, the common measure of halves and thirds.
    generators = [(6, 0), (0, 6)]
    for index, shifts in ((2, [(1, 0), (0, 1), (1, 1)]), (3, [(1, 0), (0, 1), (1, 1), (1, 2)])):
        for shift in shifts:
            if _unrepeated_share(power, shift, index, 0.001) < _OTHER_ENERGY:
                generators.append((shift[0] * 6 // index, shift[1] * 6 // index))
    return reduce_basis(_span(generators) / 6 @ basis) if len(generators) > 2 else basis


def _unrepeated_share(power: Floats, shift: tuple[int, int], index: int, min_energy: float) -> float:
    """Share of the energy that varies along `shift` without repeating after one `index`-th of it, 0..1.

    Energy that does not vary along the shift is left out: it repeats with any period in this direction.
    """
    order = np.rint(np.fft.fftfreq(len(power)) * len(power)).astype(int)
    phase = order[None, :] * shift[0] + order[:, None] * shift[1]
    varying = float(power[phase != 0].sum())
    return float(power[phase % index != 0].sum()) / varying if varying > min_energy else 1.0


def is_checkerboard(brightness: Floats, edges: Floats) -> bool:
    """Whether average cells (bins, bins) are their own negative half a cell further, with the same edges.

    Gaps between round microimages are never round microimages themselves.
    """
    # Boards reach 0.98, soft oblong discs 0.93.
    half = len(brightness) // 2
    return any(
        _likeness(brightness, shift) < -0.945 and _likeness(edges, shift) > 0.3
        for shift in ((half, 0), (0, half), (half, half))
    )


def _likeness(cell: Floats, shift: tuple[int, int]) -> float:
    """Correlation of a periodic picture with itself, shifted by (rows, columns)."""
    rest = cell - cell.mean()
    return float((rest * np.roll(rest, shift, (0, 1))).sum() / max(float((rest * rest).sum()), 1e-30))


def _span(generators: list[tuple[int, int]]) -> Floats:
    """Basis (2, 2) of all integer combinations of `generators`, by Euclid's algorithm on the columns."""
    x, y, rest = 0, 0, 0
    for gx, gy in generators:
        while gx:
            x, y, gx, gy = gx, gy, x % gx, y - (x // gx) * gy
        rest = int(np.gcd(rest, gy))
    return np.array([(x, y % rest), (0, rest)], dtype=np.float64)


def choose_lens_centre(guesses: list[CentreGuess], light: Floats, basis: Floats) -> CentreGuess:
    """The guess that is a lens and no gap: the roundest, unless one nearly as round is clearly brighter.

    Gaps of a square array are as round as the lenses, but no lens is darker than the gaps around it. `guesses` are
    sorted, roundest first; `light` (bins, bins) is the average cell of the luminance.
    """
    bins = light.shape[0]
    inside = _distance_to_corner(basis, bins) < 0.25 * np.sqrt(abs(np.linalg.det(basis)))

    def brightness(guess: CentreGuess) -> float:
        column, row = np.floor(guess.position * bins).astype(int)
        return float(light[np.roll(inside, (row, column), axis=(0, 1))].mean())

    round_ones = [g for g in guesses if g.roundness > 0.5 * guesses[0].roundness]
    brightest = max(round_ones, key=brightness)
    return brightest if brightness(guesses[0]) < _GAP_LIGHT * brightness(brightest) else guesses[0]


def find_round_centres(cells: list[Floats], basis: Floats) -> list[CentreGuess]:
    """Up to four points about which the average cells (bins, bins) are round, roundest first, 0.3 pitch apart."""
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
    """(bins, bins) distance [px] from each bin to the lattice point nearest to it, if one is the middle of bin 0, 0."""
    return np.linalg.norm(bin_offsets(basis, bins, np.array([0.5, 0.5]) / bins), axis=2)
