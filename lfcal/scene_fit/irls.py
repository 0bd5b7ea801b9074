"""Lattice through the shifts of single lenses, most of which may be outliers, by iteratively
reweighted least squares.

The scale of the residuals comes from the best third of the lenses (a weighted quantile instead of
the median, which would follow a flat most of which is dragged the same way by video compression),
weights are Tukey's biweight. The search starts from several parts of the flat, as a part that is
dragged may agree within itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit

from ..lattice.lattice import irregularity, nearest_regular_ratio
from ..lattice.lens_subset import sample_mask
from ..runtime.arrays import Booleans, Floats
from ..runtime.kernels import kernel

__all__ = ["LensShifts", "error_inflation", "find_regular_ratio", "solve_irls"]

# Share of the lenses that gives the scale of the residuals.
_INLIERS = 0.35
# [standard deviations] lenses farther off have no weight.
_OUTLIER = 3.0
# Iterations at most, and the change [px] that ends them.
_ITERATIONS = 30
_SETTLED = 1e-5


@dataclass(frozen=True)
class LensShifts:
    """Measured shifts of single lenses from a lattice."""

    design: Floats  # (n, 3) lattice indices with a leading 1
    shift: Floats  # (n, 2) [px]
    variance: Floats  # (n,) [px^2] as the pixels of each lens by itself imply
    basis: Floats  # (2, 2) [px] of the lattice that shifts are measured from
    regular: complex | None = (
        None  # `a2 / a1` as complex numbers if the array is known to be regular
    )

    @cached_property
    def spread(self) -> Floats:
        """(n,) variance over that of the most certain lenses."""
        return np.maximum(self.variance / np.quantile(self.variance, 0.02), 1.0)

    @cached_property
    def prior(self) -> Floats:
        """(n,) weight of a lens by its variance.

        Errors made by the scene grow faster than the variance: a codec moves a whole block along
        with its content if that outweighs the rims.
        """
        return self.spread**-3.0

    def select(self, chosen: Booleans) -> LensShifts:
        """The chosen (n,) ones."""
        return replace(
            self,
            design=self.design[chosen],
            shift=self.shift[chosen],
            variance=self.variance[chosen],
        )

    def squares(self, change: Floats) -> Floats:
        """(n,) squared distances [px^2] from a change (3, 2) of origin and basis, over `spread`."""
        return ((self.shift - self.design @ change) ** 2).sum(1) / self.spread

    def iterate(self, weight: Floats) -> tuple[Floats, Floats, float]:
        """Change (3, 2) from starting weights (n,), weights (n,), and variance over `spread`."""
        weight = np.array(weight, dtype=np.float64)
        change = np.empty(3, np.complex128)
        variance = _iterate(
            self.design,
            self.shift @ [1, 1j],
            self.prior,
            self.spread,
            self.basis @ [1, 1j],
            0j if self.regular is None else self.regular,
            change,
            weight,
        )
        return change.view(np.float64).reshape(3, 2), weight, variance


@njit(error_model="numpy")
def _fit(design, shift, weight, basis, ratio):
    """Change of origin and basis by weighted least squares, as complex numbers `x + iy`; the `ratio`
    of a free lattice is zero.
    """
    total = 1e-300
    middle_i = middle_j = 0.0
    mean = 0j
    for k in range(len(weight)):
        total += weight[k]
        middle_i += weight[k] * design[k, 1]
        middle_j += weight[k] * design[k, 2]
        mean += weight[k] * shift[k]
    middle_i /= total
    middle_j /= total
    mean /= total
    ii = ij = jj = 0.0
    iz = jz = 0j
    for k in range(len(weight)):
        i = design[k, 1] - middle_i
        j = design[k, 2] - middle_j
        z = shift[k] - mean
        w = weight[k] / total
        ii += w * i * i
        ij += w * i * j
        jj += w * j * j
        iz += w * i * z
        jz += w * j * z
    determinant = ii * jj - ij * ij
    first = second = 0j
    if ratio != 0:
        # A regular lattice is one complex number a1 beside its origin: c = origin + (i + j * ratio)
        # * a1.
        along = ii + 2 * ratio.real * ij + abs(ratio) ** 2 * jj
        own = ii * basis[0] + ij * basis[1] + iz
        other = ij * basis[0] + jj * basis[1] + jz
        a1 = (own + ratio.conjugate() * other) / max(along, 1e-300)
        first = a1 - basis[0]
        second = a1 * ratio - basis[1]
    # Lenses in one line, or one of all the weight, determine nothing across it.
    elif determinant > 1e-12 * (ii + jj) * (ii + jj):
        first = (jj * iz - ij * jz) / determinant
        second = (ii * jz - ij * iz) / determinant
    return mean - middle_i * first - middle_j * second, first, second


@njit(error_model="numpy")
def _weighted_quantile(values, weight, share):
    """Least value up to which the weights sum to this share of their total, by selection."""
    value = values.copy()
    heavy = weight.copy()
    missing = share * weight.sum()
    count = len(value)
    while count > 1:
        pivot = value[count // 2]
        lighter = equal = 0.0
        for k in range(count):
            if value[k] < pivot:
                lighter += heavy[k]
            elif value[k] == pivot:
                equal += heavy[k]
        if lighter < missing <= lighter + equal:
            return pivot
        below = missing <= lighter
        if not below:
            missing -= lighter + equal
        kept = 0
        for k in range(count):
            if (value[k] < pivot) if below else (value[k] > pivot):
                value[kept] = value[k]
                heavy[kept] = heavy[k]
                kept += 1
        # Rounding may leave a rest beyond the largest value.
        if kept == 0:
            return pivot
        count = kept
    return value[0]


@kernel(error_model="numpy")
def _iterate(design, shift, prior, spread, basis, ratio, change, weight):
    """Set `change` (3,), and iterate `weight` (n,) in place; returns the variance over `spread`."""
    square = np.empty(len(weight))
    variance = 0.0
    origin, first, second = _fit(design, shift, weight, basis, ratio)
    for _ in range(_ITERATIONS):
        for k in range(len(weight)):
            miss = shift[k] - origin - design[k, 1] * first - design[k, 2] * second
            square[k] = (miss.real * miss.real + miss.imag * miss.imag) / spread[k]
        # The variance at which the share of inliers lies within their quantile of a normal
        # distribution.
        inner = _weighted_quantile(square, prior, _INLIERS)
        variance = max(inner / (-2 * np.log(1 - _INLIERS)), 1e-12)
        for k in range(len(weight)):
            near = max(1 - square[k] / (variance * _OUTLIER * _OUTLIER), 0.0)
            weight[k] = near * near * prior[k] / variance
        before = (origin, first, second)
        origin, first, second = _fit(design, shift, weight, basis, ratio)
        moved = 0.0
        for step in (origin - before[0], first - before[1], second - before[2]):
            moved = max(moved, abs(step.real), abs(step.imag))
        if moved < _SETTLED:
            break
    change[0] = origin
    change[1] = first
    change[2] = second
    return variance


def solve_irls(shifts: LensShifts, before: Floats | None = None) -> tuple[Floats, Floats]:
    """Change (3, 2) of origin and basis, and the weights (n,) of the lenses [1/px^2].

    From weights `before` (n,), or else the best of several starts.
    """
    return shifts.iterate(before)[:2] if before is not None else _solve_from_all(shifts)[:2]


def error_inflation(shifts: LensShifts, weight: Floats) -> float:
    """Factor by which the standard error exceeds that of least squares with these weights (n,),
    were they fixed.

    Weights depend on the change, and so yield to any error of it: Huber, Robust Statistics (1981),
    section 7.6.
    """
    near = np.sqrt(weight / shifts.prior)
    near /= max(float(near.max()), 1e-300)
    # What is left of the weight of a lens if the change moves, averaged over all directions: a
    # fifth at least.
    left = float((shifts.prior * near * (near - 2 * (1 - near))).sum())
    fixed = float((shifts.prior * near**2).sum())
    return fixed / max(left, 0.2 * fixed)


def _solve_from_all(shifts: LensShifts) -> tuple[Floats, Floats, float]:
    """Change (3, 2) of least cost from all starts, weights (n,) and variance; a thousand lenses
    select the start.

    Starts are all lenses, and those on either side of four lines.
    """
    count = len(shifts.shift)
    few = shifts.select(sample_mask(count, 1000 / max(count, 1)))
    place = few.design[:, 1:] - np.median(few.design[:, 1:], axis=0)
    sides = [place @ [np.cos(angle), np.sin(angle)] > 0 for angle in np.arange(8) * np.pi / 4]
    found = [
        few.iterate(weight)
        for weight in (few.prior, *(few.prior * side for side in sides if side.sum() >= 8))
    ]
    least = min(variance for _, _, variance in found)
    change, _, variance = min(found, key=lambda one: _cost(few, one[0], least))
    return shifts.iterate(
        np.maximum(1 - shifts.squares(change) / (variance * _OUTLIER**2), 0) ** 2 * shifts.prior
    )


def _cost(shifts: LensShifts, change: Floats, variance: float) -> float:
    """Sum of the squared residuals over their variances, bounded, with prior weights."""
    return float((np.minimum(shifts.squares(change) / variance, _OUTLIER**2) * shifts.prior).sum())


def find_regular_ratio(basis: Floats, shifts: LensShifts) -> complex | None:
    """`a2 / a1` of the square or hexagonal array that lenses cannot distinguish from `basis`, or
    None.

    An F-test of the fit that is bound to the regular array against the free one; a scene has a
    dozen parts with independent errors, whatever the number of lenses. Arrays are made to 1e-4.
    """
    if irregularity(basis) > 0.003:
        return None
    regular = nearest_regular_ratio(basis)
    found = [_solve_from_all(replace(shifts, regular=known)) for known in (None, regular)]
    least = min(variance for _, _, variance in found)
    free, bound = (_cost(shifts, change, least) for change, _, _ in found)
    freedom = 2 * 12 - 6
    # One chance in a hundred.
    return regular if (bound / max(free, 1e-30) - 1) * freedom / 2 < 6 else None
