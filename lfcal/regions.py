"""Regions of a flat in a fit to scenes: the mean step of the lenses of each, and the lattice on which most agree.

Both are robust: lenses far from the others of their region have no say in it, regions far from what the best
agreeing ones say have none in the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["Regions", "agreed", "regular_ratio", "step_by_region"]

# A region's own scatter counts like that of all lenses together until it has so many lenses.
_PRIOR_LENSES = 6
_LENS_TURNS = 5
_OUTLIER = 4.685
# The best third of the regions says how well regions agree; those further off than this have no say. Where most of
# a flat is dragged the same way the half would follow it.
_AGREEING = 0.35
_REGION_OUTLIER = 3.0
_FEWEST_IN_PART = 8
_TURNS = 30
# Bases this near to a regular one, relative to their length, may be one; the test with that many independent places
# asks for one chance in a hundred.
_NEARLY_REGULAR = 0.003
_PLACES = 12
_SIGNIFICANT = 6.0
# The median of a squared distance in the plane, of unit variance each way.
_MEDIAN_SQUARE = 1.386


@dataclass(frozen=True)
class Regions:
    """What the regions say, and what is known of the lattice.

    Parameters
    ----------
    design : (t, 3) float64
        Mean lattice indices with a leading 1.
    step, variance : (t, 2), (t,) float64 [px, px^2]
        Mean steps and how sure they are.
    colour : (t,) int64
        On a checkerboard of regions.
    basis : (2, 2) float64 [px]
        The steps are from this one.
    regular : complex or None
        `a2 / a1` as complex numbers where the array is known to be regular.
    """

    design: NDArray[np.float64]
    step: NDArray[np.float64]
    variance: NDArray[np.float64]
    colour: NDArray[np.int64]
    basis: NDArray[np.float64]
    regular: complex | None = None


@njit(cache=True, nogil=True)
def _quantile(values, share):
    """Quantile by selection, straight lines between the values; their order changes."""
    place = share * (len(values) - 1)
    k = int(place)
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    here = values[k]
    if place == k:
        return here
    following = np.inf
    for m in range(k + 1, len(values)):
        following = min(following, values[m])
    return here + (place - k) * (following - here)


@njit(cache=True, nogil=True)
def _pool(normal, right, order, begin, ridge, prior, cutoff, turns, median_square, weight, miss, mean, variance):
    number = len(begin) - 1
    far, scratch, middle = np.empty(len(order)), np.empty(len(order)), np.empty(number)
    for _turn in range(turns):
        for k in range(number):
            xx, xy, yy, bx, by = ridge, 0.0, ridge, 0.0, 0.0
            for m in range(begin[k], begin[k + 1]):
                lens = order[m]
                w = weight[lens]
                xx += w * (normal[lens, 0, 0] + ridge)
                xy += w * normal[lens, 0, 1]
                yy += w * (normal[lens, 1, 1] + ridge)
                bx += w * right[lens, 0]
                by += w * right[lens, 1]
            determinant = xx * yy - xy * xy
            mean[k, 0], mean[k, 1] = (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant
            variance[k] = (xx + yy) / determinant / 2
            for m in range(begin[k], begin[k + 1]):
                lens = order[m]
                xx, xy, yy = normal[lens, 0, 0] + ridge, normal[lens, 0, 1], normal[lens, 1, 1] + ridge
                determinant = xx * yy - xy * xy
                dx = (yy * right[lens, 0] - xy * right[lens, 1]) / determinant - mean[k, 0]
                dy = (xx * right[lens, 1] - xy * right[lens, 0]) / determinant - mean[k, 1]
                miss[lens, 0], miss[lens, 1] = dx, dy
                far[m] = xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy
                scratch[m] = far[m]
        # Sorting some of them leaves them in their regions, sorting all does not: that comes last.
        for k in range(number):
            middle[k] = _quantile(scratch[begin[k] : begin[k + 1]], 0.5) / median_square
        common = _quantile(scratch, 0.5) / median_square
        for k in range(number):
            own = begin[k + 1] - begin[k]
            spread = (middle[k] * own + common * prior) / (own + prior) + 1e-30
            variance[k] *= spread
            for m in range(begin[k], begin[k + 1]):
                weight[order[m]] = max(1 - far[m] / (spread * cutoff * cutoff), 0.0) ** 2


def step_by_region(
    normal: NDArray[np.float64], right: NDArray[np.float64], label: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Robust mean step of the lenses of each region.

    Parameters
    ----------
    normal, right : (n, 2, 2), (n, 2) float64
        Least squares of each lens by itself, `normal @ step = right`.
    label : (n,) int64
        Its region, 0 to t - 1, each of which has lenses.

    Returns
    -------
    step, variance : (t, 2), (t,) float64 [px, px^2]
        Mean step of a region and how sure it is.
    miss, weight : (n, 2), (n,) float64 [px]
        How far the step of a lens is from that of its region, and its say there, 0..1.
    """
    count = len(label)
    order = np.argsort(label, kind="stable")
    begin = np.concatenate([[0], np.cumsum(np.bincount(label))])
    ridge = 1e-6 * float(np.trace(normal.sum(0))) / count
    weight, miss = np.ones(count), np.zeros((count, 2))
    step, variance = np.zeros((len(begin) - 1, 2)), np.zeros(len(begin) - 1)
    _pool(
        normal, right, order, begin, ridge, _PRIOR_LENSES, _OUTLIER, _LENS_TURNS, _MEDIAN_SQUARE,
        weight, miss, step, variance,
    )  # fmt: skip
    return step, variance, miss, weight


@njit(cache=True, nogil=True)
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
        # Regions in one line say nothing across it.
        ii, jj = ii * (1 + 1e-12) + 1e-300, jj * (1 + 1e-12) + 1e-300
        determinant = ii * jj - ij * ij
        change[1, 0], change[1, 1] = (jj * ix - ij * jx) / determinant, (jj * iy - ij * jy) / determinant
        change[2, 0], change[2, 1] = (ii * jx - ij * ix) / determinant, (ii * jy - ij * iy) / determinant
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


@njit(cache=True, nogil=True)
def _settle(design, step, variance, basis, ratio, agreeing, outlier, turns, weights, changes, commons):
    square, left = np.empty(len(step)), np.empty(len(step))
    expected = -2 * np.log(1 - agreeing)
    before = np.empty(6)
    for start in range(len(weights)):
        weight, change = weights[start], changes[start]
        _weighted(design, step, weight, basis, ratio, change)
        for _turn in range(turns):
            for i in range(6):
                before[i] = change[i // 2, i % 2]
            for k in range(len(step)):
                x = step[k, 0] - change[0, 0] - design[k, 1] * change[1, 0] - design[k, 2] * change[2, 0]
                y = step[k, 1] - change[0, 1] - design[k, 1] * change[1, 1] - design[k, 2] * change[2, 1]
                square[k] = x * x + y * y
                left[k] = square[k] / expected - variance[k]
            # That variance at which just the agreeing share lies within what is expected of it.
            common = max(_quantile(left, agreeing), 1e-12)
            for k in range(len(step)):
                total = variance[k] + common
                weight[k] = max(1 - square[k] / (total * outlier * outlier), 0.0) ** 2 / total
            commons[start] = common
            _weighted(design, step, weight, basis, ratio, change)
            moved = 0.0
            for i in range(6):
                moved = max(moved, abs(change[i // 2, i % 2] - before[i]))
            if moved < 1e-5:
                break


def _settled(regions: Regions) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Changes (s, 3, 2) after robust least squares from several starts, weights (s, t) and common variances (s,).

    Beside the error of each region all have one in common, that of their scenes; it follows from how far the best
    share of the regions lies off.
    """
    weights = np.array(_starts(regions))
    changes, commons = np.zeros((len(weights), 3, 2)), np.zeros(len(weights))
    tied = regions.regular or 0j
    ratio = np.array([tied.real, tied.imag])
    _settle(
        regions.design, regions.step, regions.variance, regions.basis, ratio, _AGREEING, _REGION_OUTLIER, _TURNS,
        weights, changes, commons,
    )  # fmt: skip
    return changes, weights, commons


def _starts(regions: Regions) -> list[NDArray[np.float64]]:
    """Weights of all regions, and of those on either side of four lines."""
    weight = 1 / (regions.variance + 0.1 * np.median(regions.variance) + 1e-12)
    place = regions.design[:, 1:] - np.median(regions.design[:, 1:], axis=0)
    starts = [weight]
    for angle in np.arange(8) * np.pi / 4:
        side = place @ [np.cos(angle), np.sin(angle)] > 0
        if side.sum() >= _FEWEST_IN_PART:
            starts.append(weight * side)
    return starts


def agreed(
    regions: Regions, chosen: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change (3, 2) of origin and basis on which most regions agree best, and the weights of the regions [1/px^2].

    A dragged part of the flat may agree as well within itself, so the search starts from several parts of it. With
    `chosen` (t,) only those regions take part.
    """
    some = regions
    if chosen is not None:
        some = replace(
            regions,
            design=regions.design[chosen],
            step=regions.step[chosen],
            variance=regions.variance[chosen],
            colour=regions.colour[chosen],
        )
    changes, weights, commons = _settled(some)
    spread = some.variance + commons.min()
    best = int(np.argmin([_misfit(some, change, spread) for change in changes]))
    return changes[best], weights[best]


def _misfit(regions: Regions, change: NDArray[np.float64], spread: NDArray[np.float64]) -> float:
    """Squared distances of the regions over their variances, bounded."""
    square = ((regions.step - regions.design @ change) ** 2).sum(1)
    return float(np.minimum(square / spread, _REGION_OUTLIER**2).sum())


def regular_ratio(basis: NDArray[np.float64], regions: Regions) -> complex | None:
    """`a2 / a1` of the regular array that the regions cannot tell from `basis`, None where there is none.

    Arrays are made regular to a part in ten thousand; scenes mislead by more. A scene has about a dozen places that
    are misled on their own, whatever the number of regions, so an F-test is made for as many.
    """
    a1, a2 = basis @ [1, 1j]
    ratio = complex(a2 / a1)
    regular = min((complex(np.exp(1j * np.pi / 3)), 1j), key=lambda value: abs(ratio - value))
    if abs(ratio - regular) > _NEARLY_REGULAR:
        return None
    found = []
    for known in (None, regular):
        changes, _, commons = _settled(replace(regions, regular=known))
        found.append((changes[commons.argmin()], float(commons.min())))
    spread = regions.variance + min(common for _, common in found)
    free, bound = (_misfit(regions, change, spread) for change, _ in found)
    freedom = 2 * _PLACES - 6
    return regular if (bound / max(free, 1e-30) - 1) * freedom / 2 < _SIGNIFICANT else None
