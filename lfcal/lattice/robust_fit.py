"""Robust least squares of a lattice: iteratively reweighted, with Tukey's biweight.

A lattice is linear in its six parameters, origin and basis. Every microimage (or tile of many) contributes a measured
shift; outliers get no weight. Beaton and Tukey, Technometrics 16 (1974); Huber, Robust Statistics (1981), chapter 7.
Scenes, where most lenses may be off, need the other scale estimate of `scene_fit.irls`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .distortion import Distortion

__all__ = [
    "TUKEY_CUTOFF",
    "LatticeFit",
    "field_rms",
    "fit_affine",
    "tukey_weights",
]

#: Residual [standard deviations] from which on the weight is zero: 95 % efficiency for normal residuals.
TUKEY_CUTOFF = 4.685


@dataclass(frozen=True)
class LatticeFit:
    """A fitted lattice and how its microimages agree with it."""

    origin: NDArray[np.float64]  # (2,) [px]
    basis: NDArray[np.float64]  # (2, 2) [px]
    residual_rms: float  # [px] robust RMS distance of single microimages from the lattice
    uncertainty: float  # [px] standard error of a centre, RMS over the flat, from the scatter of the microimages
    lenses_used: int  # microimages of positive weight
    half_difference: float  # [px] RMS distance over the flat of the lattices of two halves of the microimages
    distortion: Distortion | None = None


def tukey_weights(squares: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Weights (n,) of two-dimensional residuals, and the variance that their median implies.

    Parameters
    ----------
    squares : (n,) float64
        Squared lengths of the residuals, over the variance expected of each.
    """
    # 2 ln 2 is the median of the squared length of a standard normal vector in the plane.
    variance = float(np.median(squares)) / 1.386 + 1e-30
    return np.clip(1 - squares / (variance * TUKEY_CUTOFF**2), 0, None) ** 2, variance


def fit_affine(
    design: NDArray[np.float64],
    shifts: NDArray[np.float64],
    prior: NDArray[np.float64],
    passes: int = 6,
    cutoff: float = TUKEY_CUTOFF,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Robust affine function through shifts.

    Parameters
    ----------
    design : (n, 3) float64
        A 1 and two coordinates of each.
    shifts : (n, 2) float64 [px]
    prior : (n,) float64
        Weights known beforehand, one over the variance; 0 leaves a shift out.
    passes : int
        Times that the weights are estimated.
    cutoff : float [standard deviations]

    Returns
    -------
    change : (3, 2) float64 [px]
    weight : (n,) float64
    """
    change: NDArray[Any] = np.zeros((3, 2))
    weight, root_prior = prior, np.sqrt(prior)
    for _ in range(passes):
        root = np.sqrt(weight)[:, None]
        change = np.linalg.lstsq(design * root, shifts * root, rcond=None)[0]
        length = np.hypot(*(shifts - design @ change).T) * root_prior
        # sqrt(2 ln 2) is the median length of a standard normal vector in the plane.
        scale = float(np.median(length[prior > 0])) / 1.1774 + 1e-12
        weight = np.clip(1 - (length / (cutoff * scale)) ** 2, 0, None) ** 2 * prior
    return change, weight


def field_rms(design: NDArray[np.float64], change: NDArray[np.float64]) -> float:
    """RMS over the lenses of the shift that a change (3, 2) of the lattice makes [px]."""
    return float(np.sqrt(((design @ change) ** 2).sum(1).mean()))
