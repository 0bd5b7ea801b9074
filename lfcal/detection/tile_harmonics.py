"""Lattice fit for scenes from the harmonics of the average microimage, tile by tile.

Scene content disturbs the low harmonics of a tile by far more than the fine ones that gaps and breaks make. The
scatter of each harmonic over the tiles tells how much, so the weights come from the flat itself: a matched filter
against noise that is not white. Each tile then has a shift against the point-symmetric mean of all tiles, and the
shifts are pooled, robustly, into the six parameters of the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.robust_fit import fit_affine
from .folding import HIGHEST_HARMONIC, TileFolds

__all__ = ["HarmonicFit", "fit_harmonics"]

_SHORTEST_HARMONIC = 2.2
# A harmonic takes part when its mean over the tiles is this many squared standard errors from zero.
_SIGNIFICANT = 9.0
# Tiles at the right and lower edge that are smaller than this share of a whole one are left out.
_WHOLE_TILE = 0.3


@dataclass(frozen=True)
class HarmonicFit:
    """Lattice through all tiles.

    Parameters
    ----------
    origin, basis : (2,), (2, 2) float64 [px]
    tile_rms : float [px]
        Robust RMS distance of single tiles from the lattice, per axis.
    half_difference : float [px]
        RMS distance over the flat between lattices through two independent halves of the tiles; infinite where
        there are too few tiles to tell.
    support : float
        Share of the tiles that agree with the lattice, 0..1.
    """

    origin: NDArray[np.float64]
    basis: NDArray[np.float64]
    tile_rms: float
    half_difference: float
    support: float


def _coefficients(
    folds: list[TileFolds], origin: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
    """Coefficients (t, m) relative to `origin`, bounded in size, and their harmonics (m, 2)."""
    # Finer harmonics than two pixels are aliases of coarser ones.
    highest = max(1, min(HIGHEST_HARMONIC, int(np.hypot(*folds[0].basis.T).min() / _SHORTEST_HARMONIC)))
    span = range(-highest, highest + 1)
    index = np.array([(h, k) for h in span for k in span if h > 0 or (h == 0 and k > 0)])
    bins = folds[0].bins
    phase = index @ (origin @ np.linalg.inv(folds[0].basis)) - index.sum(1) * 0.5 / bins
    turn = np.exp(2j * np.pi * phase)
    parts = []
    for fold in folds:
        value = fold.harmonics[:, index[:, 1], index[:, 0]] * turn
        value /= np.maximum(fold.count.sum((1, 2)), 1)[:, None]
        # One contrasty tile must not outvote all others.
        size = np.abs(value)
        filled = fold.count.sum((1, 2)) > 0
        parts.append(value / (size + np.median(size[filled], axis=0) + 1e-12))
    return np.concatenate(parts, axis=1).astype(np.complex128), np.concatenate([index] * len(folds))


def fit_harmonics(folds: list[TileFolds], origin: NDArray[np.float64], passes: int = 20) -> HarmonicFit:
    """Refine origin and basis of a lattice from folded tiles.

    Parameters
    ----------
    folds : list of TileFolds
        One per feature, on the same tiles and basis, that basis being right to a fraction of the pitch.
    origin : (2,) float64 [px]
        A microimage centre.
    passes : int
        Most iterations.
    """
    first = folds[0]
    basis, centre = first.basis, first.centre
    inverse = np.linalg.inv(basis)
    field, index = _coefficients(folds, origin)
    reach = np.abs(centre - origin).max() + 1.0
    design = np.column_stack([np.ones(len(centre)), (centre - origin) / reach])
    area = first.count.sum((1, 2))
    whole = (area > _WHOLE_TILE * area.max()).astype(np.float64)
    weight = whole.copy()
    total = np.zeros((3, 2))
    steps = np.zeros_like(centre)
    change, scale = np.zeros((3, 2)), 0.0
    for _ in range(passes):
        shift = (design @ total) @ inverse
        turned = field * np.exp(2j * np.pi * (shift @ index.T))
        share = weight[:, None] / max(weight.sum(), 1e-12)
        mean = (share * turned.real).sum(0)
        scatter = (share * np.abs(turned - mean) ** 2).sum(0) + 1e-12
        trust = mean / scatter * (mean**2 / scatter * weight.sum() > _SIGNIFICANT)
        fisher = (2 * np.pi) ** 2 * (index.T * (trust * mean)) @ index
        if not np.isfinite(fisher).all() or np.linalg.matrix_rank(fisher, tol=1e-6 * (np.trace(fisher) + 1e-12)) < 2:
            # Nothing that all tiles share moves in two directions.
            return HarmonicFit(origin, basis, float("inf"), float("inf"), 0.0)
        pull = -2 * np.pi * (turned.imag * trust) @ index
        steps = np.linalg.solve(fisher, pull.T).T @ basis
        change, weight, scale = fit_affine(design, steps, whole)
        total += change
        if np.abs(change).max() < 1e-4:
            break
    gap = np.full((1, 2), np.inf)
    parity = np.arange(len(centre)) % 2
    if len(centre) >= 12 and scale > 0:
        halves = [fit_affine(design, steps, whole * (parity == side))[0] for side in (0, 1)]
        gap = design @ (halves[0] - halves[1])
    # An affine field of shifts turns c(i, j) into a lattice again.
    strain = total[1:] / reach
    return HarmonicFit(
        origin + total[0],
        basis + basis @ strain,
        scale,
        float(np.sqrt((gap**2).sum(1).mean())),
        float((weight > 0.1).sum() / max(whole.sum(), 1)),
    )
