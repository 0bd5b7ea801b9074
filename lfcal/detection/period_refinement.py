"""Refine the periods: all tiles of a flat must see the average microimage at the same place of the cell.

A period that is slightly off makes the average microimage wander from tile to tile, and the energy of the mean over
all tiles drops. This energy is maximised directly; it has many side maxima but one clear peak.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .folding import TileFolds

__all__ = ["refine_basis"]

_STRONGEST = 8
# Zero padding of the tile grid when looking for the peak: a quarter of a fringe is enough for the local search.
_PADDING = 4


def _strongest(spectra: list[NDArray[np.complex64]]) -> list[tuple[int, int, int]]:
    """Channel and harmonic `(channel, h, k)` of the strongest coefficients, one of each opposite pair."""
    bins = spectra[0].shape[1]
    limit = min(4, bins // 4)
    found = []
    for channel, spectrum in enumerate(spectra):
        energy = (np.abs(spectrum) ** 2).sum(0)
        scale = energy.sum() + 1e-30
        for h in range(limit + 1):
            for k in range(-limit, limit + 1):
                if h > 0 or k > 0:
                    found.append((float(energy[k, h] / scale), channel, h, k))
    found.sort(reverse=True)
    return [(channel, h, k) for _, channel, h, k in found[:_STRONGEST]]


def _fringe(field: NDArray[np.complex64], spacing: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Frequency (2,) [cycles per px] of the strongest fringe on the tile grid, and how much of the field it holds."""
    shape = tuple(max(8, _PADDING * n) for n in field.shape)
    power = np.abs(np.fft.fft2(field, shape)) ** 2
    y, x = np.unravel_index(int(power.argmax()), shape)
    frequency = np.array([np.fft.fftfreq(shape[1])[x], np.fft.fftfreq(shape[0])[y]]) / spacing
    return frequency, float(power[y, x] / max((np.abs(field) ** 2).sum() * field.size, 1e-30))


def refine_basis(folds: list[TileFolds]) -> tuple[NDArray[np.float64], float]:
    """Lattice basis that makes the tiles of all channels coherent.

    Parameters
    ----------
    folds : list of TileFolds
        One per feature, all on the same tiles and basis.

    Returns
    -------
    basis : (2, 2) float64 [px]
    coherence : float
        Share of the harmonics' energy that all tiles have in common, 0..1.
    """
    import nlopt

    first = folds[0]
    rows, columns = first.grid
    spacing = np.array(
        [
            first.centre[min(1, columns - 1), 0] - first.centre[0, 0] or 1.0,
            first.centre[min(columns, len(first.centre) - 1), 1] - first.centre[0, 1] or 1.0,
        ]
    )
    spectra = [fold.harmonics for fold in folds]
    chosen = _strongest(spectra)
    index = np.array([(h, k) for _, h, k in chosen], dtype=np.float64)
    # Unit-energy fields: the scene decides how strong a tile is, the lattice only its phase.
    fields = []
    for channel, h, k in chosen:
        field = spectra[channel][:, k, h]
        field = field / (np.abs(field) + 0.5 * np.abs(field).mean() + 1e-12)
        fields.append(field)
    stack = np.array(fields)
    fringes = [_fringe(f.reshape(rows, columns), spacing) for f in stack]
    weight = np.array([share for _, share in fringes])
    start = np.linalg.lstsq(index * weight[:, None], np.array([f for f, _ in fringes]) * weight[:, None], rcond=None)[0]
    middle = first.centre.mean(0)
    offset = first.centre - middle
    reach = np.abs(offset).max() + 1.0
    norm = float((np.abs(stack) ** 2).sum() * stack.shape[1])

    def energy(parameters: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
        change = parameters.reshape(2, 2) / reach
        phase = (index @ change) @ offset.T
        sums = (stack * np.exp(-2j * np.pi * phase)).sum(1)
        return float((np.abs(sums) ** 2).sum() / norm)

    best_start, best_value = np.zeros(4), -1.0
    for guess in (start, np.zeros((2, 2))):
        value = energy(guess.ravel() * reach, np.empty(0))
        if value > best_value:
            best_start, best_value = guess.ravel() * reach, value
    search = nlopt.opt(nlopt.LN_SBPLX, 4)
    search.set_max_objective(energy)
    search.set_initial_step(0.1)
    search.set_xtol_abs(2e-4)
    search.set_maxeval(600)
    best = search.optimize(best_start)
    reciprocal = np.linalg.inv(first.basis).T + best.reshape(2, 2) / reach
    return np.linalg.inv(reciprocal).T, float(search.last_optimum_value())
