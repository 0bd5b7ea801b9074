"""Where in the cell of the lattice the microimages have their centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import reduce_basis

__all__ = [
    "CentreGuess",
    "choose_lens_centre",
    "distance_to_lattice",
    "find_primitive_cell",
    "find_round_centres",
    "is_checkerboard",
]

# Lens types of one outline put up to a fifth of the energy beside the harmonics of the single lens; lenses and gaps
# in turn, or lenses of different outline, put half of it there and more.
_OTHER_CELL = 0.3
# Less than this share of all energy is nothing to find a period in.
_NOTHING = 1e-3
# Shifted by half a cell, a board is its own negative to this correlation, and its edges are the same to this one. Soft
# discs of an oblong array with wide gaps come as far as 0.93, boards blurred by a fifth of a square are beyond 0.98;
# few squares, or noise, leave a third of the edges.
_NEGATIVE, _SAME_EDGES = 0.945, 0.3
_RINGS = 24
# Part of the pitch around a centre that is lens for any fill.
_CORE = 0.25
_NEARLY_AS_ROUND = 0.5
# A gap is darker than this share of a lens unless the picture has been flattened.
_DARKER = 0.85


@dataclass(frozen=True)
class CentreGuess:
    """A possible microimage centre.

    Parameters
    ----------
    position : (2,) float64
        Fractional lattice coordinates, 0..1.
    roundness : float
        Share of the variance of the average cell that the distance to this point explains, 0..1.
    """

    position: NDArray[np.float64]
    roundness: float


def find_primitive_cell(
    cells: list[NDArray[np.float64]], basis: NDArray[np.float64], again: list[NDArray[np.float64]] | None = None
) -> NDArray[np.float64]:
    """Smallest lattice on which the average cells already repeat, `basis` itself or a finer one.

    Arrays with several lens types repeat exactly only with a cell two, three or four times as large, and their
    blur differs from lens to lens; but microimages of all types have the same outline.

    Parameters
    ----------
    cells : list of (bins, bins) float64
        Average cell of each feature; `bins` a multiple of 6.
    basis : (2, 2) float64 [px]
    again : list of (bins, bins) float64 or None
        The same from another part of the flat, to tell what repeats from noise.
    """
    power = np.zeros(cells[0].shape)
    for cell, other in zip(cells, cells if again is None else again, strict=True):
        energy = (np.fft.fft2(cell - cell.mean()) * np.conj(np.fft.fft2(other - other.mean()))).real
        power += energy / max(float(energy.sum()), 1e-30)
    # Everything in sixths of a cell, the common measure of halves and thirds.
    generators = [(6, 0), (0, 6)]
    for index, shifts in ((2, [(1, 0), (0, 1), (1, 1)]), (3, [(1, 0), (0, 1), (1, 1), (1, 2)])):
        for shift in shifts:
            if _against(power, shift, index) < _OTHER_CELL:
                generators.append((shift[0] * 6 // index, shift[1] * 6 // index))
    return reduce_basis(_span(generators) / 6 @ basis) if len(generators) > 2 else basis


def _against(power: NDArray[np.float64], shift: tuple[int, int], index: int) -> float:
    """Share of what changes along `shift` that is not the same again after one `index`-th of it, 0..1.

    What does not change along the shift at all says nothing about a period in this direction: where rows are told
    apart far better than the lenses in a row, anything repeats along the rows.
    """
    order = np.rint(np.fft.fftfreq(len(power)) * len(power)).astype(int)
    phase = order[None, :] * shift[0] + order[:, None] * shift[1]
    changing = float(power[phase != 0].sum())
    return float(power[phase % index != 0].sum()) / changing if changing > _NOTHING else 1.0


def is_checkerboard(brightness: NDArray[np.float64], edges: NDArray[np.float64]) -> bool:
    """Whether dark places have the very shape of light ones, as on a checkerboard, in average cells (bins, bins).

    Gaps between round microimages are never round microimages themselves.
    """
    half = brightness.shape[0] // 2
    shifts = half * np.array([(1, 0), (0, 1), (1, 1)])
    return any(_repeats(brightness, v) < -_NEGATIVE and _repeats(edges, v) > _SAME_EDGES for v in shifts)


def _repeats(cell: NDArray[np.float64], shift: NDArray[np.int64]) -> float:
    """Correlation of a periodic picture with itself shifted by `shift` (columns, rows)."""
    g = cell - cell.mean()
    return float((g * np.roll(g, (-shift[1], -shift[0]), axis=(0, 1))).sum() / max((g * g).sum(), 1e-30))


def _span(generators: list[tuple[int, int]]) -> NDArray[np.float64]:
    """Basis (2, 2) of all integer combinations of `generators`, by Euclid's algorithm on the columns."""
    x, y, rest = 0, 0, 0
    for gx, gy in generators:
        while gx:
            x, y, gx, gy = gx, gy, x % gx, y - (x // gx) * gy
        rest = int(np.gcd(rest, gy))
    return np.array([(x, y % rest), (0, rest)], dtype=np.float64)


def distance_to_lattice(basis: NDArray[np.float64], bins: int) -> NDArray[np.float64]:
    """(bins, bins) distance [px] of each bin corner `[row / bins, column / bins]` to the nearest lattice point."""
    column, row = np.meshgrid(np.arange(bins) / bins, np.arange(bins) / bins)
    place = np.column_stack([column.ravel(), row.ravel()])
    corners = np.array([(i, j) for i in (-1, 0, 1, 2) for j in (-1, 0, 1, 2)])
    steps = (place[:, None] - corners[None]) @ basis
    return np.hypot(steps[..., 0], steps[..., 1]).min(1).reshape(bins, bins)


def choose_lens_centre(
    guesses: list[CentreGuess], light: NDArray[np.float64], basis: NDArray[np.float64]
) -> CentreGuess:
    """The guess that is a lens and no gap: the roundest, unless one nearly as round gets clearly more light.

    Gaps of a square array are as round as the lenses, and no lens is darker than the gaps around it; only cameras
    that flatten their pictures leave gaps slightly brighter.

    Parameters
    ----------
    guesses : list of CentreGuess
        Roundest first.
    light : (bins, bins) float64
        Average cell of the light itself.
    basis : (2, 2) float64 [px]
    """
    bins = light.shape[0]
    inside = distance_to_lattice(basis, bins) < _CORE * np.sqrt(abs(np.linalg.det(basis)))

    def brightness(guess: CentreGuess) -> float:
        column, row = np.floor(guess.position * bins).astype(int)
        return float(light[np.roll(inside, (row, column), axis=(0, 1))].mean())

    rivals = [g for g in guesses if g.roundness > _NEARLY_AS_ROUND * guesses[0].roundness]
    brightest = max(rivals, key=brightness)
    return brightest if brightness(guesses[0]) < _DARKER * brightness(brightest) else guesses[0]


def find_round_centres(
    cells: list[NDArray[np.float64]], weights: list[float], basis: NDArray[np.float64]
) -> list[CentreGuess]:
    """Points around which the average cells are round, roundest first; they are at least 0.2 pitch apart.

    Parameters
    ----------
    cells : list of (bins, bins) float64
        Average cell of each feature; bin `k` covers `[k, k + 1) / bins`.
    weights : list of float
        Weight of each feature.
    basis : (2, 2) float64 [px]
    """
    bins = cells[0].shape[0]
    distance = distance_to_lattice(basis, bins)
    ring = np.minimum((distance / (distance.max() + 1e-9) * _RINGS).astype(int), _RINGS - 1)
    roundness = np.zeros((bins, bins))
    for cell, weight in zip(cells, weights, strict=True):
        g = cell - cell.mean()
        spectrum = np.fft.fft2(g)
        explained = np.zeros((bins, bins))
        for k in range(_RINGS):
            mask = ring == k
            if mask.any():
                sums = np.fft.ifft2(spectrum * np.conj(np.fft.fft2(mask.astype(float)))).real
                explained += sums**2 / mask.sum()
        roundness += weight * explained / max((g * g).sum(), 1e-30)
    roundness /= max(sum(weights), 1e-30)
    pitch = np.sqrt(abs(np.linalg.det(basis)))
    guesses: list[CentreGuess] = []
    remaining = roundness.copy()
    while len(guesses) < 4 and remaining.max() > 0:
        row, column = np.unravel_index(int(remaining.argmax()), remaining.shape)
        position = (np.array([column, row]) + 0.5 + _summit(roundness, int(row), int(column))) / bins % 1
        guesses.append(CentreGuess(position, float(remaining[row, column])))
        remaining[np.roll(distance, (row, column), axis=(0, 1)) < 0.3 * pitch] = 0
    return guesses


def _summit(values: NDArray[np.float64], row: int, column: int) -> NDArray[np.float64]:
    """Offset (column, row) [bins] of the top of the parabola through a maximum of a periodic picture."""
    offset = np.zeros(2)
    for axis, line in enumerate((np.roll(values[row], 1 - column), np.roll(values[:, column], 1 - row))):
        below, top, above = line[:3]
        bend = below - 2 * top + above
        offset[axis] = np.clip(0.5 * (below - above) / bend, -0.5, 0.5) if bend < 0 else 0.0
    return offset
