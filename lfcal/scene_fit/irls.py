"""The lattice on which most microimages of a scene agree; those far from what the best of them say have no say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["SUREST", "LensShifts", "error_inflation", "find_regular_ratio", "solve_irls"]

# The best third of the lenses says how well lenses agree; those further off than this have no say. Where most of
# a flat is dragged the same way the half would follow it.
_AGREEING = 0.35
_OUTLIER = 3.0
_FEWEST_IN_PART = 8
# Lenses surer than this share of all are not told apart. What the scene does to the others grows faster than what it
# shows beside their rims: a codec moves a whole block along with its content where that outweighs the rims.
SUREST = 0.02
_DISTRUST = 3
# Where lenses do not agree at all, next to nothing of their weight holds the fit in place.
_LEAST_LEFT = 0.2
# So many lenses, evenly spread, tell which of several answers is the best; all of them refine it.
_SEARCHED = 1000
_GOLDEN = 0.6180339887498949
_TURNS = 30
# From turn to turn the common variance changes by less than this factor, nearly always.
_NEAR = 1.2
# Bases this near to a regular one, relative to their length, may be one; the test with that many independent places
# asks for one chance in a hundred.
_NEARLY_REGULAR = 0.003
_PLACES = 12
_SIGNIFICANT = 6.0


@dataclass(frozen=True)
class LensShifts:
    """Where single lenses ask the lattice to go, and what is known of it.

    Parameters
    ----------
    design : (n, 3) float64
        Lattice indices with a leading 1.
    step, variance : (n, 2), (n,) float64 [px, px^2]
        Steps and how sure they are, as the pixels of each lens by itself tell.
    basis : (2, 2) float64 [px]
        The steps are from this one.
    regular : complex or None
        `a2 / a1` as complex numbers where the array is known to be regular.
    """

    design: NDArray[np.float64]
    step: NDArray[np.float64]
    variance: NDArray[np.float64]
    basis: NDArray[np.float64]
    regular: complex | None = None

    @cached_property
    def spread(self) -> NDArray[np.float64]:
        """(n,) variance over that of the surest lenses."""
        return np.maximum(self.variance / np.quantile(self.variance, SUREST), 1.0)

    @cached_property
    def trust(self) -> NDArray[np.float64]:
        """(n,) weight of a lens by what is known of it alone."""
        return self.spread**-_DISTRUST


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted(design, step, weight, basis, ratio, change):
    """Weighted least squares: change (3, 2) of origin and basis."""
    total = 1e-300
    mi = mj = mx = my = 0.0
    for k in range(len(weight)):
        total += weight[k]
        mi += weight[k] * design[k, 1]
        mj += weight[k] * design[k, 2]
        mx += weight[k] * step[k, 0]
        my += weight[k] * step[k, 1]
    mi, mj, mx, my = mi / total, mj / total, mx / total, my / total
    ii = ij = jj = ix = iy = jx = jy = 0.0
    for k in range(len(weight)):
        w, i, j, x, y = weight[k], design[k, 1] - mi, design[k, 2] - mj, step[k, 0] - mx, step[k, 1] - my
        ii += w * i * i
        ij += w * i * j
        jj += w * j * j
        ix += w * i * x
        iy += w * i * y
        jx += w * j * x
        jy += w * j * y
    if ratio[1] == 0:
        # Lenses in one line say nothing across it.
        ii, jj = ii * (1 + 1e-12) + 1e-300, jj * (1 + 1e-12) + 1e-300
        determinant = ii * jj - ij * ij
        if determinant > 0:
            change[1, 0], change[1, 1] = (jj * ix - ij * jx) / determinant, (jj * iy - ij * jy) / determinant
            change[2, 0], change[2, 1] = (ii * jx - ij * ix) / determinant, (ii * jy - ij * iy) / determinant
        else:
            # A single lens, or several without weight, say nothing of the basis: such products underflow.
            change[1:] = 0.0
    else:
        # A regular lattice is one complex number a1 beside its origin: c = origin + (i + j * ratio) * a1.
        r, s = ratio
        # Places against the basis that the steps are from.
        ix, iy = ix + ii * basis[0, 0] + ij * basis[1, 0], iy + ii * basis[0, 1] + ij * basis[1, 1]
        jx, jy = jx + ij * basis[0, 0] + jj * basis[1, 0], jy + ij * basis[0, 1] + jj * basis[1, 1]
        size = ii + 2 * r * ij + (r * r + s * s) * jj + 1e-300
        ax, ay = (ix + r * jx + s * jy) / size, (iy + r * jy - s * jx) / size
        change[1, 0], change[1, 1] = ax - basis[0, 0], ay - basis[0, 1]
        change[2, 0], change[2, 1] = r * ax - s * ay - basis[1, 0], s * ax + r * ay - basis[1, 1]
    change[0, 0] = mx - mi * change[1, 0] - mj * change[2, 0]
    change[0, 1] = my - mi * change[1, 1] - mj * change[2, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted_quantile(values, weight, wanted, about, some, theirs):
    """Least value below which lies at least the `wanted` weight.

    By Hoare's selection (Communications of the ACM 4, 1961) among the values near the one it is expected `about`, or
    among all if it is not there; `some` and `theirs` (n,) is memory to work in.
    """
    least, most, under, low, high = about / _NEAR, about * _NEAR, 0.0, 0, 0
    for k in range(len(values)):
        value, heavy = values[k], weight[k]
        under += heavy if value < least else 0.0
        # Written in any case: a branch would be as often wrong.
        some[high], theirs[high] = value, heavy
        high += int((value >= least) & (value <= most))
    if under < wanted <= under + theirs[:high].sum():
        wanted -= under
    else:
        some[:], theirs[:], high = values, weight, len(values)
    while True:
        one, other, third = some[low], some[(low + high) // 2], some[high - 1]
        pivot = max(min(one, other), min(max(one, other), third))
        # What is less comes first, what is more last.
        less, more, at = low, high, low
        below = equal = 0.0
        while at < more:
            value, heavy = some[at], theirs[at]
            if value < pivot:
                some[at], theirs[at], some[less], theirs[less] = some[less], theirs[less], value, heavy
                below += heavy
                less += 1
                at += 1
            elif value > pivot:
                more -= 1
                some[at], theirs[at], some[more], theirs[more] = some[more], theirs[more], value, heavy
            else:
                equal += heavy
                at += 1
        if less > low and below >= wanted:
            high = less
        elif more == high or below + equal >= wanted:
            return pivot
        else:
            wanted -= below + equal
            low = more


@njit(cache=True, nogil=True, error_model="numpy")
def _settle(design, step, spread, trust, basis, ratio, agreeing, outlier, turns, weights, changes, commons):
    square, some, theirs = np.empty(len(step)), np.empty(len(step)), np.empty(len(step))
    expected, wanted = -2 * np.log(1 - agreeing), agreeing * trust.sum()
    before = np.empty(6)
    for start in range(len(weights)):
        weight, change = weights[start], changes[start]
        _weighted(design, step, weight, basis, ratio, change)
        common = 0.0
        for _turn in range(turns):
            for i in range(6):
                before[i] = change[i // 2, i % 2]
            for k in range(len(step)):
                x = step[k, 0] - change[0, 0] - design[k, 1] * change[1, 0] - design[k, 2] * change[2, 0]
                y = step[k, 1] - change[0, 1] - design[k, 1] * change[1, 1] - design[k, 2] * change[2, 1]
                square[k] = (x * x + y * y) / spread[k]
            # That variance at which just the agreeing share lies within what is expected of it.
            common = max(_weighted_quantile(square, trust, wanted, common * expected, some, theirs) / expected, 1e-12)
            for k in range(len(step)):
                weight[k] = max(1 - square[k] / (common * outlier * outlier), 0.0) ** 2 * trust[k] / common
            commons[start] = common
            _weighted(design, step, weight, basis, ratio, change)
            moved = 0.0
            for i in range(6):
                moved = max(moved, abs(change[i // 2, i % 2] - before[i]))
            if moved < 1e-5:
                break


def _settled(
    steps: LensShifts, starts: list[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Changes (s, 3, 2) after robust least squares from starting weights (n,), weights (s, n), common variances (s,).

    How far lenses lie off beside what `LensShifts.spread` says follows from the best share of them.
    """
    weights = np.array(starts)
    changes, commons = np.zeros((len(weights), 3, 2)), np.zeros(len(weights))
    tied = steps.regular or 0j
    ratio = np.array([tied.real, tied.imag])
    _settle(
        steps.design, steps.step, steps.spread, steps.trust, steps.basis, ratio, _AGREEING, _OUTLIER, _TURNS,
        weights, changes, commons,
    )  # fmt: skip
    return changes, weights, commons


def _starts(steps: LensShifts) -> list[NDArray[np.float64]]:
    """Weights of all steps, and of those on either side of four lines."""
    weight = steps.trust
    place = steps.design[:, 1:] - np.median(steps.design[:, 1:], axis=0)
    starts = [weight]
    for angle in np.arange(8) * np.pi / 4:
        side = place @ [np.cos(angle), np.sin(angle)] > 0
        if side.sum() >= _FEWEST_IN_PART:
            starts.append(weight * side)
    return starts


def solve_irls(
    steps: LensShifts, chosen: NDArray[np.bool_] | None = None, before: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change (3, 2) of origin and basis on which most lenses agree best, and the weights of the lenses [1/px^2].

    With `chosen` (n,) only those lenses take part; with weights `before` (n,) it is what these lead to.
    """
    if before is not None:
        changes, weights, _ = _settled(steps, [before])
        return changes[0], weights[0]
    return _best(steps if chosen is None else _only(steps, chosen))[:2]


def error_inflation(steps: LensShifts, weight: NDArray[np.float64]) -> float:
    """By what factor a change is less sure than least squares of these weights (n,), were they fixed, would have it.

    They follow from the change, and so yield to any error of it: Huber, Robust Statistics (1981), section 7.6.
    """
    near = np.sqrt(weight / steps.trust)
    near /= max(float(near.max()), 1e-300)
    far = 1 - near
    # Of the weight of a lens, this much is left where the change moves, all directions alike.
    left = float((steps.trust * near * (near - 2 * far)).sum())
    fixed = float((steps.trust * near**2).sum())
    return fixed / max(left, _LEAST_LEFT * fixed)


def _best(steps: LensShifts) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Change (3, 2) on which most lenses agree best, weights (n,) and the common variance.

    A dragged part of the flat may agree as well within itself, so the search starts from several parts of it.
    """
    count = len(steps.step)
    few = steps if count <= _SEARCHED else _only(steps, np.arange(count) * _GOLDEN % 1 < _SEARCHED / count)
    changes, weights, commons = _settled(few, _starts(few))
    best = int(np.argmin([_misfit(few, change, commons.min()) for change in changes]))
    if few is not steps:
        far = ((steps.step - steps.design @ changes[best]) ** 2).sum(1) / (steps.spread * commons[best])
        changes, weights, commons = _settled(steps, [np.maximum(1 - far / _OUTLIER**2, 0) ** 2 * steps.trust])
        best = 0
    return changes[best], weights[best], float(commons[best])


def _only(steps: LensShifts, chosen: NDArray[np.bool_]) -> LensShifts:
    return replace(steps, design=steps.design[chosen], step=steps.step[chosen], variance=steps.variance[chosen])


def _misfit(steps: LensShifts, change: NDArray[np.float64], common: float) -> float:
    """Squared distances of the lenses over their variances, bounded, each as far as it is trusted."""
    square = ((steps.step - steps.design @ change) ** 2).sum(1)
    return float((np.minimum(square / (steps.spread * common), _OUTLIER**2) * steps.trust).sum())


def find_regular_ratio(basis: NDArray[np.float64], steps: LensShifts) -> complex | None:
    """`a2 / a1` of the regular array that the lenses cannot tell from `basis`, None where there is none.

    Arrays are made regular to a part in ten thousand; scenes mislead by more. A scene has about a dozen places that
    are misled on their own, whatever the number of lenses, so an F-test is made for as many.
    """
    a1, a2 = basis @ [1, 1j]
    ratio = complex(a2 / a1)
    regular = min((complex(np.exp(1j * np.pi / 3)), 1j), key=lambda value: abs(ratio - value))
    if abs(ratio - regular) > _NEARLY_REGULAR:
        return None
    found = []
    for known in (None, regular):
        change, _, common = _best(replace(steps, regular=known))
        found.append((change, common))
    least = min(common for _, common in found)
    free, bound = (_misfit(steps, change, least) for change, _ in found)
    freedom = 2 * _PLACES - 6
    return regular if (bound / max(free, 1e-30) - 1) * freedom / 2 < _SIGNIFICANT else None
