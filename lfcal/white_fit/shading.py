"""Slope of the light across a microimage: from the light over the field, and from the angle of its rays.

A pixel sees the exit pupil of the main lens through its microlens. Light falls off with the angle of its rays, that is
about the point below the microlens, which lies the farther from the centre of the microimage the farther out in the
field it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice

__all__ = ["fit_gain_slope", "fit_shade"]

# Degree of the polynomial of the gain over the field.
_DEGREE = 4


def fit_gain_slope(centres: NDArray[np.float64], gain: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the gain over the field [1/px], from a polynomial through the gains (n,) of lenses."""
    scale = np.array(lattice.image_size) / 2
    x, y = ((centres - scale) / scale).T
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a)]
    xs, ys = (np.vander(v, _DEGREE + 1, increasing=True).T for v in (x, y))
    # Some thousand lenses tell all factors.
    few = slice(None, None, max(1, len(gain) // 4000))
    log = np.log(np.maximum(gain[few], 1e-12))
    table = np.column_stack([xs[a][few] * ys[b][few] for a, b in powers])
    keep = np.ones(len(log), dtype=bool)
    factors = np.zeros(len(powers))
    for _ in range(3):
        if keep.sum() < 3 * len(powers):
            return np.zeros_like(centres)
        factors = np.linalg.lstsq(table[keep], log[keep], rcond=None)[0]
        miss = np.abs(log - table @ factors)
        keep = miss < 5 * np.median(miss) + 1e-6
    slope = np.zeros((2, len(gain)))
    for (a, b), factor in zip(powers, factors.tolist(), strict=True):
        if a:
            slope[0] += a * factor * xs[a - 1] * ys[b]
        if b:
            slope[1] += b * factor * xs[a] * ys[b - 1]
    return np.ascontiguousarray(slope.T / scale)


def fit_shade(
    slopes: NDArray[np.float64], weight: NDArray[np.float64], centres: NDArray[np.float64], lattice: Lattice
) -> NDArray[np.float64]:
    """Slope of the own light of lenses over the field: (3, 2) of a constant and of the position in px, or zeros.

    `slopes` (n, 2) [1/px] are those of the light within single microimages beyond that of the gains. The slope grows
    linearly with the distance from an axis, which may lie beside the middle; zeros where that is not significant.
    """
    far = centres - (np.array(lattice.image_size) - 1) / 2
    root = np.sqrt(weight)[:, None]
    table = np.zeros((len(far), 2, 3))
    table[:, 0, 0] = table[:, 1, 1] = 1
    table[:, :, 2] = far
    keep = np.repeat(weight[:, None] > 0, 2, axis=1)
    for _ in range(3):
        if keep.sum() < 12:
            return np.zeros((3, 2))
        used = table * (root * keep)[..., None]
        normal = np.einsum("nap,naq->pq", used, used)
        found = np.linalg.pinv(normal) @ np.einsum("nap,na->p", used, slopes * root)
        miss = np.abs(slopes - table @ found) * root
        keep = (weight[:, None] > 0) & (miss < 4 * np.median(miss[weight > 0]) + 1e-12)
    variance = float((miss[keep] ** 2).mean())
    # Six standard errors.
    if found @ normal @ found < 36 * variance:
        return np.zeros((3, 2))
    middle = (np.array(lattice.image_size) - 1) / 2
    return np.vstack([found[:2] - found[2] * middle, found[2] * np.eye(2)])
