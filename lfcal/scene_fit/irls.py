"""Lattice through the shifts of single lenses, most of which may be outliers, by iteratively reweighted least squares.

The scale of the residuals comes from the best third of the lenses (a weighted quantile instead of the median), weights
are Tukey's biweight. The search starts from several parts of the flat, as a part that is dragged by video compression
may agree within itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..lattice.lens_subset import sample_mask
from ..runtime.kernels.jit import kernel
from .settings import SCENE

__all__ = ["LensShifts", "error_inflation", "find_regular_ratio", "solve_irls"]

_NEAR = SCENE.near


@dataclass(frozen=True)
class LensShifts:
    """Measured shifts of single lenses from a lattice."""

    design: NDArray[np.float64]  # (n, 3) lattice indices with a leading 1
    shift: NDArray[np.float64]  # (n, 2) [px]
    variance: NDArray[np.float64]  # (n,) [px^2] as the pixels of each lens by itself imply
    basis: NDArray[np.float64]  # (2, 2) [px] of the lattice that shifts are measured from
    regular: complex | None = None  # `a2 / a1` as complex numbers if the array is known to be regular

    @cached_property
    def spread(self) -> NDArray[np.float64]:
        """(n,) variance over that of the most certain lenses."""
        return np.maximum(self.variance / np.quantile(self.variance, SCENE.most_certain), 1.0)

    @cached_property
    def prior(self) -> NDArray[np.float64]:
        """(n,) weight of a lens by its variance."""
        return self.spread**-SCENE.distrust

    def select(self, chosen: NDArray[np.bool_]) -> LensShifts:
        """The chosen (n,) ones."""
        return replace(self, design=self.design[chosen], shift=self.shift[chosen], variance=self.variance[chosen])


@njit(error_model="numpy")
def _fit_weighted(design, shift, weight, basis, ratio, change):
    """Weighted least squares: change (3, 2) of origin and basis."""
    total = 1e-300
    mi = mj = mx = my = 0.0
    for k in range(len(weight)):
        total += weight[k]
        mi += weight[k] * design[k, 1]
        mj += weight[k] * design[k, 2]
        mx += weight[k] * shift[k, 0]
        my += weight[k] * shift[k, 1]
    mi, mj, mx, my = mi / total, mj / total, mx / total, my / total
    ii = ij = jj = ix = iy = jx = jy = 0.0
    for k in range(len(weight)):
        w, i, j, x, y = weight[k], design[k, 1] - mi, design[k, 2] - mj, shift[k, 0] - mx, shift[k, 1] - my
        ii += w * i * i
        ij += w * i * j
        jj += w * j * j
        ix += w * i * x
        iy += w * i * y
        jx += w * j * x
        jy += w * j * y
    if ratio[1] == 0:
        # Lenses in one line determine nothing across it.
        ii, jj = ii * (1 + 1e-12) + 1e-300, jj * (1 + 1e-12) + 1e-300
        determinant = ii * jj - ij * ij
        if determinant > 0:
            change[1, 0], change[1, 1] = (jj * ix - ij * jx) / determinant, (jj * iy - ij * jy) / determinant
            change[2, 0], change[2, 1] = (ii * jx - ij * ix) / determinant, (ii * jy - ij * iy) / determinant
        else:
            # A single lens, or several of next to no weight: such products underflow.
            change[1:] = 0.0
    else:
        # A regular lattice is one complex number a1 beside its origin: c = origin + (i + j * ratio) * a1.
        r, s = ratio
        # Positions against the basis that shifts are measured from.
        ix, iy = ix + ii * basis[0, 0] + ij * basis[1, 0], iy + ii * basis[0, 1] + ij * basis[1, 1]
        jx, jy = jx + ij * basis[0, 0] + jj * basis[1, 0], jy + ij * basis[0, 1] + jj * basis[1, 1]
        size = ii + 2 * r * ij + (r * r + s * s) * jj + 1e-300
        ax, ay = (ix + r * jx + s * jy) / size, (iy + r * jy - s * jx) / size
        change[1, 0], change[1, 1] = ax - basis[0, 0], ay - basis[0, 1]
        change[2, 0], change[2, 1] = r * ax - s * ay - basis[1, 0], s * ax + r * ay - basis[1, 1]
    change[0, 0] = mx - mi * change[1, 0] - mj * change[2, 0]
    change[0, 1] = my - mi * change[1, 1] - mj * change[2, 1]


@njit(error_model="numpy")
def _weighted_quantile(values, weight, wanted, about, near, near_weight):
    """Least value up to which the weights sum to `wanted`.

    Hoare's selection (Communications of the ACM 4, 1961) among the values near the expected one, `about`, or among all
    if it is not there; `near` and `near_weight` (n,) are work space.
    """
    least, most, under, low, high = about / _NEAR, about * _NEAR, 0.0, 0, 0
    for k in range(len(values)):
        value, w = values[k], weight[k]
        under += w if value < least else 0.0
        # Written in any case: a branch would be mispredicted as often as not.
        near[high], near_weight[high] = value, w
        high += int((value >= least) & (value <= most))
    among = under
    for k in range(high):
        among += near_weight[k]
    if under < wanted <= among:
        wanted -= under
    else:
        high = len(values)
        for k in range(high):
            near[k], near_weight[k] = values[k], weight[k]
    while True:
        one, other, third = near[low], near[(low + high) // 2], near[high - 1]
        pivot = max(min(one, other), min(max(one, other), third))
        # Smaller values are moved to the front, larger ones to the back.
        less, more, at = low, high, low
        below = equal = 0.0
        while at < more:
            value, w = near[at], near_weight[at]
            if value < pivot:
                near[at], near_weight[at], near[less], near_weight[less] = near[less], near_weight[less], value, w
                below += w
                less += 1
                at += 1
            elif value > pivot:
                more -= 1
                near[at], near_weight[at], near[more], near_weight[more] = near[more], near_weight[more], value, w
            else:
                equal += w
                at += 1
        if less > low and below >= wanted:
            high = less
        elif more == high or below + equal >= wanted:
            return pivot
        else:
            wanted -= below + equal
            low = more


@kernel(error_model="numpy")
def _iterate(
    design, shift, spread, prior, basis, ratio, inliers, outlier, passes, converged, weights, changes, variances
):
    square, near, near_weight = np.empty(len(shift)), np.empty(len(shift)), np.empty(len(shift))
    total = 0.0
    for k in range(len(prior)):
        total += prior[k]
    expected, wanted = -2 * np.log(1 - inliers), inliers * total
    before = np.empty(6)
    for start in range(len(weights)):
        weight, change = weights[start], changes[start]
        _fit_weighted(design, shift, weight, basis, ratio, change)
        for _turn in range(passes):
            for i in range(6):
                before[i] = change[i // 2, i % 2]
            for k in range(len(shift)):
                x = shift[k, 0] - change[0, 0] - design[k, 1] * change[1, 0] - design[k, 2] * change[2, 0]
                y = shift[k, 1] - change[0, 1] - design[k, 1] * change[1, 1] - design[k, 2] * change[2, 1]
                square[k] = (x * x + y * y) / spread[k]
            # The variance at which the share of inliers lies within their quantile of a normal distribution.
            about = variances[start] * expected
            variance = max(_weighted_quantile(square, prior, wanted, about, near, near_weight) / expected, 1e-12)
            for k in range(len(shift)):
                weight[k] = max(1 - square[k] / (variance * outlier * outlier), 0.0) ** 2 * prior[k] / variance
            variances[start] = variance
            _fit_weighted(design, shift, weight, basis, ratio, change)
            moved = 0.0
            for i in range(6):
                moved = max(moved, abs(change[i // 2, i % 2] - before[i]))
            if moved < converged:
                break


def _solve_from(
    shifts: LensShifts, starts: list[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Changes (s, 3, 2) from starting weights (n,), weights (s, n), and variances (s,) over `LensShifts.spread`."""
    weights = np.array(starts)
    changes, variances = np.zeros((len(weights), 3, 2)), np.zeros(len(weights))
    tied = shifts.regular or 0j
    ratio = np.array([tied.real, tied.imag])
    _iterate(
        shifts.design, shifts.shift, shifts.spread, shifts.prior, shifts.basis, ratio, SCENE.inliers, SCENE.outlier,
        SCENE.irls_passes, SCENE.converged, weights, changes, variances,
    )  # fmt: skip
    return changes, weights, variances


def _starting_weights(shifts: LensShifts) -> list[NDArray[np.float64]]:
    """Weights of all lenses, and of those on either side of four lines."""
    place = shifts.design[:, 1:] - np.median(shifts.design[:, 1:], axis=0)
    starts = [shifts.prior]
    for angle in np.arange(8) * np.pi / 4:
        side = place @ [np.cos(angle), np.sin(angle)] > 0
        if side.sum() >= SCENE.fewest_in_part:
            starts.append(shifts.prior * side)
    return starts


def solve_irls(
    shifts: LensShifts, before: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change (3, 2) of origin and basis, and the weights (n,) of the lenses [1/px^2].

    From weights `before` (n,), or else the best of several starts.
    """
    if before is not None:
        changes, weights, _ = _solve_from(shifts, [before])
        return changes[0], weights[0]
    return _solve_from_all(shifts)[:2]


def error_inflation(shifts: LensShifts, weight: NDArray[np.float64]) -> float:
    """Factor by which the standard error exceeds that of least squares with these weights (n,), were they fixed.

    Weights depend on the change, and so yield to any error of it: Huber, Robust Statistics (1981), section 7.6.
    """
    near = np.sqrt(weight / shifts.prior)
    near /= max(float(near.max()), 1e-300)
    far = 1 - near
    # What is left of the weight of a lens if the change moves, averaged over all directions.
    left = float((shifts.prior * near * (near - 2 * far)).sum())
    fixed = float((shifts.prior * near**2).sum())
    return fixed / max(left, SCENE.least_left * fixed)


def _solve_from_all(shifts: LensShifts) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Change (3, 2) of least cost from all starts, weights (n,) and the variance."""
    count = len(shifts.shift)
    few = shifts if count <= SCENE.searched else shifts.select(sample_mask(count, SCENE.searched / count))
    changes, weights, variances = _solve_from(few, _starting_weights(few))
    best = int(np.argmin([_cost(few, change, variances.min()) for change in changes]))
    if few is not shifts:
        residuals = ((shifts.shift - shifts.design @ changes[best]) ** 2).sum(1)
        far = residuals / (shifts.spread * variances[best])
        start = np.maximum(1 - far / SCENE.outlier**2, 0) ** 2 * shifts.prior
        changes, weights, variances = _solve_from(shifts, [start])
        best = 0
    return changes[best], weights[best], float(variances[best])


def _cost(shifts: LensShifts, change: NDArray[np.float64], variance: float) -> float:
    """Sum of the squared residuals over their variances, bounded, with prior weights."""
    square = ((shifts.shift - shifts.design @ change) ** 2).sum(1)
    return float((np.minimum(square / (shifts.spread * variance), SCENE.outlier**2) * shifts.prior).sum())


def find_regular_ratio(basis: NDArray[np.float64], shifts: LensShifts) -> complex | None:
    """`a2 / a1` of the square or hexagonal array that lenses cannot distinguish from `basis`, or None.

    An F-test of the fit that is bound to the regular array against the free one.
    """
    a1, a2 = basis @ [1, 1j]
    ratio = complex(a2 / a1)
    regular = min((complex(np.exp(1j * np.pi / 3)), 1j), key=lambda value: abs(ratio - value))
    if abs(ratio - regular) > SCENE.nearly_regular:
        return None
    found = [_solve_from_all(replace(shifts, regular=known)) for known in (None, regular)]
    least = min(variance for _, _, variance in found)
    free, bound = (_cost(shifts, change, least) for change, _, _ in found)
    freedom = 2 * SCENE.places - 6
    return regular if (bound / max(free, 1e-30) - 1) * freedom / 2 < SCENE.irregular else None
