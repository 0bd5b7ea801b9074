"""Lattice through the tiles of a flat, by the harmonics of their average microimages.

Scene content disturbs the low harmonics of a tile far more than the fine ones that gaps and edges make. The scatter of
each harmonic over the tiles gives its weight: a matched filter for noise that is not white. Each tile then has a shift
against the point-symmetric mean of all tiles, and the lattice is fitted to the shifts by robust least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.robust_fit import field_rms, fit_affine
from .folding import HIGHEST_HARMONIC, TileFolds
from .settings import DEFAULT, HarmonicSettings

__all__ = ["HarmonicFit", "fit_harmonics"]


@dataclass(frozen=True)
class HarmonicFit:
    """Lattice through all tiles."""

    origin: NDArray[np.float64]  # (2,) [px]
    basis: NDArray[np.float64]  # (2, 2) [px]
    # [px] RMS distance over the flat of lattices of two halves of the tiles; infinite if these are too few
    half_difference: float


def fit_harmonics(
    folds: list[TileFolds], origin: NDArray[np.float64], settings: HarmonicSettings = DEFAULT.harmonics
) -> HarmonicFit:
    """Refine origin and basis of a lattice from folded tiles.

    Parameters
    ----------
    folds : list of TileFolds
        One per feature, on the same tiles and basis, that basis being right to a fraction of the pitch.
    origin : (2,) float64 [px]
        A microimage centre.
    """
    first = folds[0]
    basis, centre = first.basis, first.centre
    inverse = np.linalg.inv(basis)
    field, index = _coefficients(folds, origin, settings.shortest_harmonic)
    reach = np.abs(centre - origin).max() + 1.0
    design = np.column_stack([np.ones(len(centre)), (centre - origin) / reach])
    area = first.count.sum((1, 2))
    whole = (area > settings.min_tile * area.max()).astype(np.float64)
    weight, total = whole, np.zeros((3, 2))
    for _ in range(settings.passes):
        turned = field * np.exp(2j * np.pi * ((design @ total) @ inverse @ index.T))
        cells = _tile_shifts(turned, index, weight, settings.significance)
        if cells is None:
            return HarmonicFit(origin, basis, float("inf"))
        shifts = cells @ basis
        change, weight = fit_affine(design, shifts, whole)
        total += change
        if np.abs(change).max() < settings.settled:
            break
    half_difference = float("inf")
    if len(centre) >= settings.fewest_tiles:
        parity = np.arange(len(centre)) % 2
        halves = [fit_affine(design, shifts, whole * (parity == side))[0] for side in (0, 1)]
        half_difference = field_rms(design, halves[0] - halves[1])
    # An affine field of shifts turns c(i, j) into a lattice again.
    return HarmonicFit(origin + total[0], basis + basis @ (total[1:] / reach), half_difference)


def _coefficients(
    folds: list[TileFolds], origin: NDArray[np.float64], shortest: float
) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
    """Coefficients (t, m) relative to `origin`, bounded in size, and their harmonics (m, 2)."""
    highest = max(1, min(HIGHEST_HARMONIC, int(np.hypot(*folds[0].basis.T).min() / shortest)))
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


def _tile_shifts(
    field: NDArray[np.complex128], index: NDArray[np.int64], weight: NDArray[np.float64], significance: float
) -> NDArray[np.float64] | None:
    """(t, 2) shift of each tile against the mean of all [cells]; None where no two directions are significant."""
    share = weight[:, None] / max(weight.sum(), 1e-12)
    mean = (share * field.real).sum(0)
    scatter = (share * np.abs(field - mean) ** 2).sum(0) + 1e-12
    filter_ = mean / scatter * (mean**2 / scatter * weight.sum() > significance)
    fisher = (2 * np.pi) ** 2 * (index.T * (filter_ * mean)) @ index
    if not np.isfinite(fisher).all() or np.linalg.matrix_rank(fisher, tol=1e-6 * (np.trace(fisher) + 1e-12)) < 2:
        return None
    pull = -2 * np.pi * (field.imag * filter_) @ index
    return np.asarray(np.linalg.solve(fisher, pull.T).T)
