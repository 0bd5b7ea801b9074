"""The lattice through the tiles of a flat: its periods, then its place by the harmonics of average
microimages.

Periods: all tiles of a flat must have the average microimage at the same place of the cell. With a
period that is slightly off, the average microimage drifts from tile to tile, and the energy of the
mean over all tiles drops. This energy is maximised; it has many side maxima but one clear peak.

Scene content disturbs the low harmonics of a tile far more than the fine ones that gaps and edges
make. The scatter of each harmonic over the tiles gives its weight: a matched filter for noise that
is not white. Each tile then has a shift against the point-symmetric mean of all tiles, and the
lattice is fitted to the shifts by robust least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.robust_fit import field_rms, fit_affine
from ..runtime.arrays import Floats, Integers
from .folding import TileFolds

__all__ = ["HarmonicFit", "fit_harmonics", "has_run_away", "refine_basis"]


def has_run_away(refined: Floats, basis: Floats) -> bool:
    """Whether a refinement has changed a basis (2, 2) by more than a twentieth; right ones move by
    a thousandth.
    """
    return not np.abs(refined @ np.linalg.inv(basis) - np.eye(2)).max() < 0.05


def refine_basis(folds: list[TileFolds]) -> Floats:
    """Basis (2, 2) [px] that makes the tiles of all features, on the same tiles and basis,
    coherent.
    """
    first = folds[0]
    rows, columns = first.grid
    centre = first.centre
    beside = centre[min(1, columns - 1), 0]
    below = centre[min(columns, len(centre) - 1), 1]
    spacing = np.array([beside - centre[0, 0] or 1.0, below - centre[0, 1] or 1.0])
    spectra = [fold.harmonics for fold in folds]
    # The eight strongest low harmonics, one of each opposite pair.
    limit = min(4, first.bins // 4)
    energies = [(np.abs(spectrum) ** 2).sum(0) for spectrum in spectra]
    ranked = sorted(
        (
            (float(energy[k, h] / (energy.sum() + 1e-30)), feature, h, k)
            for feature, energy in enumerate(energies)
            for h in range(limit + 1)
            for k in range(-limit, limit + 1)
            if h > 0 or k > 0
        ),
        reverse=True,
    )
    chosen = [place for _, *place in ranked[:8]]
    index = np.array([(h, k) for _, h, k in chosen], dtype=np.float64)
    # Nearly unit amplitude: the scene decides how strong a tile is, the lattice only its phase.
    fields = []
    for feature, h, k in chosen:
        field = spectra[feature][:, k, h]
        fields.append(field / (np.abs(field) + 0.5 * np.abs(field).mean() + 1e-12))
    stack = np.array(fields)
    fringes = [_fringe(field.reshape(rows, columns), spacing) for field in stack]
    weight = np.array([share for _, share in fringes])[:, None]
    start = np.linalg.lstsq(index * weight, np.array([f for f, _ in fringes]) * weight, rcond=None)[
        0
    ]
    change = _maximise_coherence(stack, index, centre - centre.mean(0), start)
    return np.asarray(np.linalg.inv(np.linalg.inv(first.basis).T + change).T)


def _fringe(field: NDArray[np.complex64], spacing: Floats) -> tuple[Floats, float]:
    """Frequency (2,) [cycles per px] of the strongest fringe on the tile grid, and its share of the
    energy.
    """
    # A quarter of a fringe is enough for the local search.
    shape = tuple(max(8, 4 * n) for n in field.shape)
    power = np.abs(np.fft.fft2(field, shape)) ** 2
    y, x = np.unravel_index(int(power.argmax()), shape)
    frequency = np.array([np.fft.fftfreq(shape[1])[x], np.fft.fftfreq(shape[0])[y]]) / spacing
    return frequency, float(power[y, x] / max((np.abs(field) ** 2).sum() * field.size, 1e-30))


def _maximise_coherence(
    stack: NDArray[np.complex64], index: Floats, offset: Floats, start: Floats
) -> Floats:
    """Change (2, 2) of the reciprocal basis at which the fields (m, t) of tiles at `offset` (t, 2)
    agree best.
    """
    import nlopt

    reach = np.abs(offset).max() + 1.0
    norm = max(float((np.abs(stack) ** 2).sum() * stack.shape[1]), 1e-30)

    def energy(parameters: Floats, gradient: Floats) -> float:
        phase = (index @ (parameters.reshape(2, 2) / reach)) @ offset.T
        sums = (stack * np.exp(-2j * np.pi * phase)).sum(1)
        return float((np.abs(sums) ** 2).sum() / norm)

    guesses = [guess.ravel() * reach for guess in (start, np.zeros((2, 2)))]
    search = nlopt.opt(nlopt.LN_SBPLX, 4)
    search.set_max_objective(energy)
    search.set_initial_step(0.1)
    search.set_xtol_abs(2e-4)
    search.set_maxeval(600)
    best = search.optimize(max(guesses, key=lambda guess: energy(guess, np.empty(0))))
    return np.asarray(best).reshape(2, 2) / reach


@dataclass(frozen=True)
class HarmonicFit:
    """Lattice through all tiles."""

    origin: Floats  # (2,) [px]
    basis: Floats  # (2, 2) [px]
    # [px] RMS distance over the flat of lattices of two halves of the tiles; infinite if these are
    # too few
    half_difference: float


def fit_harmonics(folds: list[TileFolds], origin: Floats) -> HarmonicFit:
    """Refine a basis, right to a fraction of the pitch, and a microimage centre `origin` (2,) [px]
    by folded tiles.
    """
    first = folds[0]
    basis = first.basis
    centre = first.centre
    inverse = np.linalg.inv(basis)
    field, index = _coefficients(folds, origin)
    reach = np.abs(centre - origin).max() + 1.0
    design = np.column_stack([np.ones(len(centre)), (centre - origin) / reach])
    area = first.count.sum((1, 2))
    # Smaller tiles at the edges are left out.
    whole = (area > 0.3 * area.max()).astype(np.float64)
    weight = whole
    total = np.zeros((3, 2))
    for _ in range(20):
        turned = field * np.exp(2j * np.pi * ((design @ total) @ inverse @ index.T))
        cells = _tile_shifts(turned, index, weight)
        if cells is None:
            return HarmonicFit(origin, basis, float("inf"))
        shifts = cells @ basis
        change, weight = fit_affine(design, shifts, whole)
        total += change
        if np.abs(change).max() < 1e-4:
            break
    half_difference = float("inf")
    if len(centre) >= 12:
        parity = np.arange(len(centre)) % 2
        halves = [fit_affine(design, shifts, whole * (parity == side))[0] for side in (0, 1)]
        half_difference = field_rms(design, halves[0] - halves[1])
    # An affine field of shifts turns c(i, j) into a lattice again.
    return HarmonicFit(origin + total[0], basis + basis @ (total[1:] / reach), half_difference)


def _coefficients(
    folds: list[TileFolds], origin: Floats
) -> tuple[NDArray[np.complex128], Integers]:
    """Coefficients (t, m) relative to `origin`, bounded in size, and their harmonics (m, 2)."""
    # Finer harmonics are aliases of coarser ones, or the colour mosaic.
    highest = max(
        1, min(folds[0].harmonics.shape[2] - 1, int(np.hypot(*folds[0].basis.T).min() / 2.2))
    )
    span = range(-highest, highest + 1)
    index = np.array([(h, k) for h in span for k in span if h > 0 or (h == 0 and k > 0)])
    phase = index @ (origin @ np.linalg.inv(folds[0].basis)) - index.sum(1) * 0.5 / folds[0].bins
    turn = np.exp(2j * np.pi * phase)
    parts = []
    for fold in folds:
        area = fold.count.sum((1, 2))
        value = fold.harmonics[:, index[:, 1], index[:, 0]] * turn
        value /= np.maximum(area, 1)[:, None]
        # Bounded, so that one tile of high contrast does not outweigh all others.
        size = np.abs(value)
        parts.append(value / (size + np.median(size[area > 0], axis=0) + 1e-12))
    return np.concatenate(parts, axis=1).astype(np.complex128), np.concatenate([index] * len(folds))


def _tile_shifts(field: NDArray[np.complex128], index: Integers, weight: Floats) -> Floats | None:
    """(t, 2) shift of each tile against the mean of all [cells]; None where no two directions are
    significant.
    """
    share = weight[:, None] / max(weight.sum(), 1e-12)
    mean = (share * field.real).sum(0)
    scatter = (share * np.abs(field - mean) ** 2).sum(0) + 1e-12
    # Harmonics of three standard errors count.
    filter_ = mean / scatter * (mean**2 / scatter * weight.sum() > 9)
    fisher = (2 * np.pi) ** 2 * (index.T * (filter_ * mean)) @ index
    if (
        not np.isfinite(fisher).all()
        or np.linalg.matrix_rank(fisher, tol=1e-6 * (np.trace(fisher) + 1e-12)) < 2
    ):
        return None
    pull = -2 * np.pi * (field.imag * filter_) @ index
    return np.asarray(np.linalg.solve(fisher, pull.T).T)
