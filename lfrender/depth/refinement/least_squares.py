"""Robust least squares inside kernels: weights, normal equations of one unknown among nuisance
parameters, and planes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

__all__ = [
    "Plane",
    "PlaneSums",
    "add_point",
    "geman_mcclure",
    "no_points",
    "solve_plane",
    "solve_symmetric",
]


@njit(inline="always")
def geman_mcclure(squared, scale2):
    """Weight of a squared residual after Geman and McClure: 1/4 where it is `scale2`."""
    root = scale2 / (scale2 + squared)
    return root * root


@njit(error_model="numpy", fastmath=False)
def solve_symmetric(sums, priors, kept):
    """Solve symmetric normal equations for all but the `kept` first terms, and insert the solution
    in those, which fill the first rows of `sums` (m, m) then.

    Only the lower triangle is read and written. `priors` (m,) are inverse variances of the terms
    about zero.
    """
    for term in range(len(sums) - 1, kept - 1, -1):
        pivot = max(sums[term, term] + priors[term], np.float32(1e-12))
        inverse = np.float32(1) / pivot
        for i in range(term):
            share = sums[term, i] * inverse
            for j in range(i + 1):
                sums[i, j] -= share * sums[term, j]


class PlaneSums(NamedTuple):
    """Weighted sums over points with a place `x, y` and a value."""

    weight: Any
    x: Any
    y: Any
    xx: Any
    xy: Any
    yy: Any
    value: Any
    value_x: Any
    value_y: Any


class Plane(NamedTuple):
    """Weighted least-squares plane through points, and the variances of its parameters."""

    height: Any  # at x = y = 0
    slope_x: Any
    slope_y: Any
    height_variance: Any
    slope_x_variance: Any
    slope_y_variance: Any


@njit(inline="always")
def no_points(zero):
    """Sums over no points, in the type of `zero`."""
    return PlaneSums(zero, zero, zero, zero, zero, zero, zero, zero, zero)


@njit(inline="always")
def add_point(sums, weight, x, y, value):
    """The sums with one point more."""
    weight_x = weight * x
    weight_y = weight * y
    weight_value = weight * value
    return PlaneSums(
        sums.weight + weight,
        sums.x + weight_x,
        sums.y + weight_y,
        sums.xx + weight_x * x,
        sums.xy + weight_x * y,
        sums.yy + weight_y * y,
        sums.value + weight_value,
        sums.value_x + weight_value * x,
        sums.value_y + weight_value * y,
    )


@njit(inline="always")
def solve_plane(sums, slope_prior):
    """The plane through points by Cramer's rule; `slope_prior` is the inverse variance of both
    slopes about zero.
    """
    xx = sums.xx + slope_prior
    yy = sums.yy + slope_prior
    # Cofactors of the symmetric matrix of the normal equations.
    of_height = xx * yy - sums.xy * sums.xy
    of_x = sums.y * sums.xy - sums.x * yy
    of_y = sums.x * sums.xy - sums.y * xx
    of_xx = sums.weight * yy - sums.y * sums.y
    of_xy = sums.x * sums.y - sums.weight * sums.xy
    of_yy = sums.weight * xx - sums.x * sums.x
    # In the type of the sums, which a division of an integer would not keep.
    inverse = np.reciprocal(sums.weight * of_height + sums.x * of_x + sums.y * of_y)
    return Plane(
        (of_height * sums.value + of_x * sums.value_x + of_y * sums.value_y) * inverse,
        (of_x * sums.value + of_xx * sums.value_x + of_xy * sums.value_y) * inverse,
        (of_y * sums.value + of_xy * sums.value_x + of_yy * sums.value_y) * inverse,
        of_height * inverse,
        of_xx * inverse,
        of_yy * inverse,
    )
