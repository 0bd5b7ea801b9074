"""Order of lens types by what they are focused at, from their sharpness over depth and from the blur of their rims."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lens_sample import LensSample

__all__ = ["FocusOrder", "find_focus_order"]

# Neighbours in an order must differ by so many standard errors, so that a wrong order is a chance of 1 in 10,000; by
# fewer where three foci are seen too, which lie in that order in one of six cases by chance.
_CLEAR, _CLEAR_WITH_FOCI = 4.0, 3.5
# Range of s / D on both sides of where two types are equally sharp in which sharpness differences are straight lines.
_NEAR = 0.12
_TURNS = 5
# Standard error of that place [s / D] up to which it is worth telling.
_EXACT = 0.03
# Spread of s / D from which on sharpness is seen to change with depth.
_LEAST_SPREAD = 0.02
_FEWEST = 40
_OUTLIER = 3.0
# Light beyond the rim over that before it: where it does not fall, a camera has flattened its pictures, and rims
# tell of the white image it was done with.
_FLATTENED = 0.95


# Differences of light at the rims that are more than how pixels fall on them.
_LEAST_LIGHT = 0.015
# Light that is missing before a soft edge for light that is seen beyond it; 0.3 to 1 of discs and real rims.
_MISSING = 0.1


@dataclass(frozen=True)
class FocusOrder:
    """Lens types in the order of their focus.

    Parameters
    ----------
    sequence : (count,) int64
        Provisional types from the one focused at the largest `|s|` to the one at the smallest.
    known : bool
        The sequence is measured, not just the provisional one.
    focus : (count,) float64
        `s / D` at which each provisional type is sharpest, NaN where not known.
    """

    sequence: NDArray[np.int64]
    known: bool
    focus: NDArray[np.float64]


def find_focus_order(
    sample: LensSample,
    cell: NDArray[np.int64],
    sharpness: NDArray[np.float64],
    disparity: NDArray[np.float64],
    spill: NDArray[np.float64],
    droop: NDArray[np.float64],
    falls: float,
) -> FocusOrder:
    """Sort provisional lens types by their focus.

    Parameters
    ----------
    sample : LensSample
    cell : (m, m) int64
        Provisional types.
    sharpness, spill, droop : (n,) float64
        Fine contrast, light beyond the rim and loss of light before it, of the inner lenses against their neighbours;
        NaN where not known.
    disparity : (n,) float64
        `s / D` of the lenses, NaN where not known.
    falls : float
        Light beyond the rim over that before it, of all lenses.
    """
    count = int(cell.max()) + 1
    types = cell[tuple((sample.inner % len(cell)).T)]
    mixing = _mixing(sample, cell)
    trend = _over_depth(sharpness, disparity, types, mixing)
    rim = _softness(spill, droop, types, mixing) if falls < _FLATTENED else None
    if trend is not None:
        slope, focus, sign = trend
        if rim is not None:
            # Which end of the order has the larger |s| is seen better at the rims.
            sign = float(np.sign(slope @ rim))
        return FocusOrder(np.argsort(-sign * slope), True, focus)
    unknown = np.full(count, np.nan)
    if rim is not None:
        # The rim is the image of the main aperture, at s = 0: the further out a focus, the softer the rim.
        return FocusOrder(np.argsort(-rim), True, unknown)
    return FocusOrder(np.arange(count), False, unknown)


def _mixing(sample: LensSample, cell: NDArray[np.int64]) -> NDArray[np.float64]:
    """(count, count) what the difference from the neighbours makes of the values of the types."""
    count = int(cell.max()) + 1
    m = len(cell)
    matrix = np.eye(count)
    for kind in range(count):
        i, j = np.argwhere(cell == kind)[0]
        for a, b in sample.lattice.steps:
            matrix[kind, cell[(i + a) % m, (j + b) % m]] -= 1 / len(sample.lattice.steps)
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


def _softness(
    spill: NDArray[np.float64],
    droop: NDArray[np.float64],
    types: NDArray[np.int64],
    mixing: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """(count,) how soft the rims of each type are, mean 0; None where that is not clear."""
    beyond, before = _means(spill, types, mixing), _means(droop, types, mixing)
    if beyond is None or before is None or not _distinct(*beyond) or np.ptp(beyond[0]) < _LEAST_LIGHT:
        return None
    soft = beyond[0] - beyond[0].mean()
    # What a soft edge spills is missing before it; a brighter neighbour shines beyond the rim too, but takes nothing.
    missing = float(before[0] @ soft) / float(soft @ soft)
    doubt = 2 * before[1] / float(np.linalg.norm(soft))
    return soft if missing + doubt > _MISSING else None


def _means(
    values: NDArray[np.float64], types: NDArray[np.int64], mixing: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float] | None:
    """Robust mean of each type, and the standard error of their differences; None where a type has too few."""
    constant = np.where(np.isfinite(values), 0.0, np.nan)
    fit = _lines(values, constant, types, mixing)
    return fit and (fit[0][:, 0], fit[1][0])


def _distinct(values: NDArray[np.float64], error: float, clear: float = _CLEAR) -> bool:
    return bool(np.diff(np.sort(values)).min() > clear * error)


def _lines(
    values: NDArray[np.float64], places: NDArray[np.float64], types: NDArray[np.int64], mixing: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Line through the values of each type over places: (count, 2) height and slope, and (2,) errors of differences."""
    known = np.isfinite(values) & np.isfinite(places)
    if np.bincount(types[known], minlength=len(mixing)).min() < _FEWEST:
        return None
    reach = _OUTLIER * 1.4826 * float(np.median(np.abs(values[known]))) + 1e-9
    lines, errors = np.zeros((len(mixing), 2)), np.zeros((len(mixing), 2))
    for kind in range(len(mixing)):
        mine = known & (types == kind)
        x, y = places[mine], np.clip(values[mine], -reach, reach)
        across = float(x.var())
        slope = float(((x - x.mean()) * y).mean()) / across if across > 0 else 0.0
        lines[kind] = y.mean() - slope * x.mean(), slope
        scatter = float((y - lines[kind, 0] - slope * x).std()) / np.sqrt(len(x))
        errors[kind] = scatter, scatter / np.sqrt(across) if across > 0 else np.inf
    return mixing @ lines, np.sqrt(2) * float(np.linalg.norm(mixing, 2)) * errors.max(0)


def _over_depth(
    sharpness: NDArray[np.float64],
    disparity: NDArray[np.float64],
    types: NDArray[np.int64],
    mixing: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float] | None:
    """Slope of the sharpness of each type over `s / D`, focus of each, and the sign of `s` at which they are focused.

    None where the slopes are not clearly different.

    The logarithm of sharpness falls with the square of the defocus, `-k (x - f)^2` at `x = s / D`, so that differences
    between types are straight lines in `x`: slope `2 k f`, height `-k f^2`, less what all types have in common.
    """
    known = np.isfinite(sharpness) & np.isfinite(disparity)
    if known.sum() < _FEWEST or disparity[known].std() < _LEAST_SPREAD:
        return None
    fit = _lines(sharpness, disparity, types, mixing)
    if fit is None:
        return None
    (height, slope), error = fit[0].T, fit[1][1]
    focus = _foci(sharpness, disparity, types, mixing)
    if (np.diff(focus[np.argsort(slope)]) < 0).any():
        focus[:] = np.nan
    seen = bool(np.isfinite(focus).all())
    if not _distinct(slope, error, _CLEAR_WITH_FOCI if seen else _CLEAR):
        return None
    # Where foci are seen, their mean is where types change places; the lines are bent by what lies far from all foci.
    middle = float(focus.mean()) if seen else -float(height @ slope) / float(slope @ slope)
    sign = float(np.sign(middle))
    low, median, high = np.quantile(disparity[known], (0.1, 0.5, 0.9))
    # Far from all foci differences fade and their slopes turn round: types must change places within what is seen.
    if not low < middle < high or sign != np.sign(median):
        return None
    return slope, focus, sign


def _foci(
    sharpness: NDArray[np.float64],
    disparity: NDArray[np.float64],
    types: NDArray[np.int64],
    mixing: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(count,) `s / D` where each of three types is sharpest, NaN where that is not seen.

    Two types are equally sharp half-way between their foci, whatever the law by which sharpness falls with defocus.
    """
    unknown = np.full(len(mixing), np.nan)
    if len(mixing) != 3:
        return unknown
    low, high = np.nanquantile(disparity, (0.02, 0.98))
    sums = np.zeros(3)
    for pair, other in (((0, 1), 2), ((1, 2), 0), ((2, 0), 1)):
        meet, error = float(np.nanmedian(disparity)), np.inf
        for _ in range(_TURNS):
            near = np.where(np.abs(disparity - meet) < _NEAR, disparity - meet, np.nan)
            fit = _lines(sharpness, near, types, mixing)
            if fit is None:
                return unknown
            height, slope = fit[0][pair[0]] - fit[0][pair[1]]
            if slope == 0:
                return unknown
            meet += float(np.clip(-height / slope, -_NEAR / 2, _NEAR / 2))
            error = float(fit[1][0] / abs(slope))
        if not (low < meet < high and error < _EXACT):
            return unknown
        sums[[*pair, other]] += meet, meet, -meet
    return sums
