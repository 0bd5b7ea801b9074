"""The light of lenses over the field: a robust polynomial through its logarithms, and its slope.

Iteratively reweighted least squares with Tukey's biweight: dust and dead lenses get no weight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF, biweight, robust_sigma
from ..runtime.arrays import ENOUGH_LENSES, Floats, evenly
from .gain_map import count_terms, field_monomials

__all__ = ["fit_light", "fit_light_slope"]

# Degrees that are tried, and lenses for each of their factors.
_DEGREES = (4, 2)
_LENSES_PER_TERM = 12


def fit_light(lights: NDArray[np.floating], centres: Floats, lattice: Lattice) -> Floats:
    """Fit a polynomial of the field to the logarithms of the lights (n,) of lenses.

    Returns the factors (terms,) of `field_monomials`; the degree is four if there are enough
    lenses. The lenses are at `centres` (n, 2) [px].
    """
    some = evenly(len(lights), ENOUGH_LENSES)
    log = np.log(np.maximum(lights[some], 1e-12))
    count = len(log)
    degree = next((d for d in _DEGREES if count >= _LENSES_PER_TERM * count_terms(d)), 0)
    table = field_monomials(centres[some], lattice, count_terms(degree))
    ridge = 1e-9 * max(count, 1) * np.eye(table.shape[1])
    weight = np.ones(count)
    level: Floats = np.zeros(table.shape[1])
    for _ in range(5):
        weighted = weight[:, None] * table
        level[:] = np.linalg.solve(weighted.T @ table + ridge, weighted.T @ log)
        miss = np.abs(log - table @ level)
        spread = 1.0
        if count:
            spread = robust_sigma(miss) + 1e-9
        weight = biweight((miss / (TUKEY_CUTOFF * spread)) ** 2)
    return level


def fit_light_slope(lights: NDArray[np.floating], centres: Floats, lattice: Lattice) -> Floats:
    """(n, 2) relative slope of the light of lenses [1/px], from the polynomial through it."""
    level = fit_light(lights, centres, lattice)
    degree = next(d for d in (*_DEGREES, 0) if count_terms(d) == len(level))
    slopes = np.zeros((count_terms(max(degree - 1, 0)), 2))
    for d in range(1, degree + 1):
        own = level[count_terms(d - 1) : count_terms(d)]
        order = np.arange(d + 1)
        # X^(d - b) Y^b has the derivatives (d - b) X^(d - 1 - b) Y^b and b X^(d - b) Y^(b - 1).
        rows = slice(count_terms(d - 2), count_terms(d - 1))
        slopes[rows, 0] = ((d - order) * own)[:-1]
        slopes[rows, 1] = (order * own)[1:]
    reach = float(np.hypot(*lattice.image_size)) / 2
    return np.ascontiguousarray(field_monomials(centres, lattice, len(slopes)) @ slopes / reach)
