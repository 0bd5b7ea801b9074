"""Robust least squares of a lattice: iteratively reweighted, with Tukey's biweight.

A lattice is linear in its six parameters, origin and basis. Every microimage (or tile of many)
contributes a measured shift; outliers get no weight. Beaton and Tukey, Technometrics 16 (1974);
Huber, Robust Statistics (1981), chapter 7. Scenes, where most lenses may be off, need the other
scale estimate of `scene_fit.irls`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Array, Floats
from .lattice import Lattice
from .standard_errors import LatticeErrors, Residuals

__all__ = [
    "MAD_TO_SIGMA",
    "SIGNIFICANT",
    "TUKEY_CUTOFF",
    "LatticeFit",
    "biweight",
    "field_rms",
    "fit_affine",
    "robust_sigma",
    "tukey_weights",
]

#: Residuals beyond this [standard deviations] have no weight; normal ones keep 95 % efficiency.
TUKEY_CUTOFF = 4.685
#: An effect of more standard errors is significant: chance reaches 5.5 in the pixels of a flat.
SIGNIFICANT = 6
#: Standard deviation of normal values over their median absolute deviation.
MAD_TO_SIGMA = 1.4826
# Median of the squared length of a standard normal vector in the plane: 2 ln 2.
_MEDIAN_SQUARE = 1.386


@dataclass(frozen=True)
class LatticeFit:
    """A fitted lattice and how its microimages agree with it."""

    lattice: Lattice
    residual_rms: float  # [px] robust RMS distance of single microimages from the lattice
    lenses_used: int  # microimages of positive weight
    # [px] RMS distance over the flat of the lattices of two halves of the microimages
    half_difference: float
    errors: LatticeErrors | None = None  # None where the lattice is the first one
    residuals: Residuals | None = None  # of single microimages, in white images
    # Disc that cuts microimages (mechanical vignetting), where there is one, as `GainMap.cut`.
    cut: Floats | None = None
    # [px] RMS distance from the first lattice, less that due to distortion and cut microimages
    displacement: float = 0.0
    # Reason why the centres may be others, as those of the disc that cuts the microimages.
    doubt: str | None = None


def robust_sigma(values: NDArray[np.floating]) -> float:
    """Standard deviation of normal values about 0, from the median of their absolute values."""
    return MAD_TO_SIGMA * float(np.median(np.abs(values)))


def biweight(share: Array) -> Array:
    """Tukey's weights (n,) of residuals; `share` (n,) is their square over that of the cut-off."""
    return np.clip(1 - share, 0, None) ** 2


def tukey_weights(squares: Floats) -> tuple[Floats, float]:
    """Tukey's weights (n,) of residuals in the plane with these squared lengths (n,), and the
    variance of one coordinate, estimated from the median.
    """
    variance = float(np.median(squares)) / _MEDIAN_SQUARE + 1e-30
    return biweight(squares / (variance * TUKEY_CUTOFF**2)), variance


def fit_affine(design: Floats, shifts: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """Robust affine function (3, 2) through shifts (n, 2) [px], and their weights (n,).

    `design` (n, 3) holds a 1 and two coordinates of each; `prior` (n,) weights known beforehand,
    one over the variance: 0 leaves a shift out.
    """
    change: Array = np.zeros((3, 2))
    weight = prior
    for _ in range(6):
        root = np.sqrt(weight)[:, None]
        change = np.linalg.lstsq(design * root, shifts * root, rcond=None)[0]
        squares = ((shifts - design @ change) ** 2).sum(1) * prior
        variance = tukey_weights(squares[prior > 0])[1]
        weight = biweight(squares / (variance * TUKEY_CUTOFF**2)) * prior
    return change, weight


def field_rms(design: Floats, change: Floats) -> float:
    """RMS over the lenses of the shift that a change (3, 2) of the lattice makes [px]."""
    return float(np.sqrt(((design @ change) ** 2).sum(1).mean()))
