"""Order of lens types by focus, from sharpness over depth and from the blur of rims."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Floats, Integers
from .lens_sample import LensSample, outlier_limit

# Lenses of a type, at least.
_FEWEST_LENSES = 40
# If the light beyond rims over that before them is larger, the flat is a white image.
FLATTENED = 0.95
# Least spread of `s / D` of a scene that has depth.
MIN_SPREAD = 0.02
#: Relative differences of the light at rims may come from how pixels fall.
RIM_FAULT = 0.015
# Standard errors between types whose order is right (wrong once in 10,000 cases), and between those
# of which three foci confirm it, as happens by chance in one of six cases.
_APART = 4
_APART_CONFIRMED = 3.5
# Light missing before a soft edge over that beyond it: 0.3 to 1 for real rims.
_LEAST_LOSS = 0.1
# Shares of the lenses within whose depths types must change places, and within which foci lie.
_MIDDLE = (0.1, 0.5, 0.9)
_ALL = (0.02, 0.98)
# [s / D] Range of depths about the place where two types are alike, and its largest error.
_NEAR = 0.12
_MOST_ERROR = 0.03

__all__ = ["FLATTENED", "MIN_SPREAD", "RIM_FAULT", "FocusOrder", "TypeMeans", "find_focus_order"]


class FocusOrder(NamedTuple):
    """Lens types in the order of their focus."""

    # (count,) provisional types, from focus at the largest `|s|` to the smallest
    sequence: Integers
    known: bool  # the sequence is measured, not just the provisional one
    # (count,) `s / D` at which each provisional type is sharpest, NaN where not known
    focus: Floats


def find_focus_order(
    sample: LensSample,
    cell: Integers,
    sharpness: Floats,
    disparity: Floats,
    outer_light: Floats,
    inner_loss: Floats,
    rim_ratio: float,
) -> FocusOrder:
    """Sort provisional lens types by their focus.

    `cell` (m, m) holds them, `sharpness`, `outer_light` and `inner_loss` (n,) are `LensFeatures` of
    the inner lenses less those of their neighbours, `disparity` (n,) is their `s / D`; all NaN
    where not known.
    """
    count = int(cell.max()) + 1
    types = TypeMeans.from_sample(sample, cell)
    trend = _order_over_depth(sharpness, disparity, types)
    rim = _rim_softness(outer_light, inner_loss, types) if rim_ratio < FLATTENED else None
    if trend is not None:
        slope, focus, sign = trend
        # Rims show more reliably which end of the order has the larger |s|.
        return FocusOrder(
            np.argsort(-slope * (sign if rim is None else np.sign(slope @ rim))), True, focus
        )
    unknown = np.full(count, np.nan)
    if rim is not None:
        # The rim is the image of the main aperture, at s = 0: the farther a focus from that, the
        # softer the rim.
        return FocusOrder(np.argsort(-rim), True, unknown)
    return FocusOrder(np.arange(count), False, unknown)


class TypeMeans(NamedTuple):
    """Types (n,) of the inner lenses, and the matrix that computes values of types.

    It turns differences from neighbours into values of types with mean zero.
    """

    of: Integers
    unmixing: Floats

    @classmethod
    def from_sample(cls, sample: LensSample, cell: Integers) -> TypeMeans:
        """For the lenses of a sample whose types repeat after a `cell` (m, m)."""
        m = len(cell)
        steps = sample.lattice.steps
        matrix = np.eye(int(cell.max()) + 1)
        for kind in range(len(matrix)):
            i, j = np.argwhere(cell == kind)[0]
            for a, b in steps:
                matrix[kind, cell[(i + a) % m, (j + b) % m]] -= 1 / len(steps)
        return cls(
            cell[tuple((sample.inner % m).T)], np.asarray(np.linalg.pinv(matrix), np.float64)
        )

    def fit_lines(self, values: Floats, places: Floats) -> tuple[Floats, Floats] | None:
        """Fit a line through the values of each type.

        Returns height and slope (count, 2), and the errors (2,) of differences.

        None where a type has too few known values.
        """
        known = np.isfinite(values) & np.isfinite(places)
        count = len(self.unmixing)
        if np.bincount(self.of[known], minlength=count).min() < _FEWEST_LENSES:
            return None
        limit = outlier_limit(values[known]) + 1e-9
        of = self.of[known]
        x = places[known]
        y = np.clip(values[known], -limit, limit)
        number = np.bincount(of)

        def mean(one: Floats) -> Floats:
            return np.asarray(np.bincount(of, one) / number)

        middle = mean(x)
        level = mean(y)
        away = x - middle[of]
        variance = mean(away**2)
        varied = variance > 0
        slope = np.where(varied, mean(away * y) / np.where(varied, variance, 1), 0)
        scatter = np.sqrt(mean((y - level[of] - slope[of] * away) ** 2) / number)
        slope_error = np.where(varied, scatter / np.sqrt(np.where(varied, variance, 1)), np.inf)
        lines = np.column_stack([level - slope * middle, slope])
        error = np.array([scatter.max(), slope_error.max()])
        inflation = np.sqrt(2) * float(np.linalg.norm(self.unmixing, 2))
        return self.unmixing @ lines, inflation * error

    def fit_means(self, values: Floats) -> tuple[Floats, float] | None:
        """Robust mean of each type, and the standard error of differences between types.

        None if a type has too few values.
        """
        fit = self.fit_lines(values, np.where(np.isfinite(values), 0.0, np.nan))
        return fit and (fit[0][:, 0], fit[1][0])


def _rim_softness(outer_light: Floats, inner_loss: Floats, types: TypeMeans) -> Floats | None:
    """(count,) softness of the rims of each type, mean 0; None where that is not clear."""
    beyond = types.fit_means(outer_light)
    before = types.fit_means(inner_loss)
    if beyond is None or before is None:
        return None
    apart = np.diff(np.sort(beyond[0])).min()
    if apart <= _APART * beyond[1] or np.ptp(beyond[0]) < RIM_FAULT:
        return None
    soft = beyond[0] - beyond[0].mean()
    # Light beyond a soft edge is missing before it; a brighter neighbour adds light beyond the rim
    # too, but takes none.
    loss = float(before[0] @ soft) / float(soft @ soft)
    if loss + 2 * before[1] / float(np.linalg.norm(soft)) > _LEAST_LOSS:
        return soft
    return None


def _order_over_depth(
    sharpness: Floats, disparity: Floats, types: TypeMeans
) -> tuple[Floats, Floats, float] | None:
    """Slope of the sharpness of each type over `s / D`, and the focus of each type.

    Also returns the sign of `s` at which the types are focused.

    None where the slopes are not clearly different.

    The logarithm of sharpness falls with the square of the defocus, `-k (x - f)^2` at `x = s / D`,
    so that differences between types are straight lines in `x`: slope `2 k f`, height `-k f^2`,
    less the mean of all types.
    """
    known = np.isfinite(sharpness) & np.isfinite(disparity)
    if known.sum() < _FEWEST_LENSES or disparity[known].std() < MIN_SPREAD:
        return None
    fit = types.fit_lines(sharpness, disparity)
    if fit is None:
        return None
    (height, slope), error = fit[0].T, fit[1][1]
    gap = np.diff(np.sort(slope)).min()
    if gap <= _APART_CONFIRMED * error:
        return None
    # Types change places near here, or at the mean of the foci; lines are bent by lenses far from
    # all foci.
    middle = -float(height @ slope) / float(slope @ slope)
    focus = _find_foci(sharpness, disparity, types, middle)
    if (np.diff(focus[np.argsort(slope)]) < 0).any():
        focus[:] = np.nan
    seen = bool(np.isfinite(focus).all())
    if not seen and gap <= _APART * error:
        return None
    if seen:
        middle = float(focus.mean())
    low, median, high = np.quantile(disparity[known], _MIDDLE)
    # Far from all foci differences fade and slopes reverse: types must change places within the
    # range of the scene.
    if not low < middle < high or np.sign(middle) != np.sign(median):
        return None
    return slope, focus, float(np.sign(middle))


def _find_foci(sharpness: Floats, disparity: Floats, types: TypeMeans, start: float) -> Floats:
    """(count,) `s / D` where each of three types is sharpest, NaN where that is not seen.

    All of them change places near `start`.

    Two types are equally sharp half-way between their foci, whatever the law by which sharpness
    falls with defocus.
    """
    sums = np.zeros(3)
    unknown = np.full(len(types.unmixing), np.nan)
    if len(unknown) != 3:
        return unknown
    low, high = np.nanquantile(disparity, _ALL)
    for pair, other in (((0, 1), 2), ((1, 2), 0), ((2, 0), 1)):
        meet = start
        error = np.inf
        for _ in range(5):
            fit = types.fit_lines(
                sharpness, np.where(np.abs(disparity - meet) < _NEAR, disparity - meet, np.nan)
            )
            if fit is None:
                return unknown
            height, slope = fit[0][pair[0]] - fit[0][pair[1]]
            if slope == 0:
                return unknown
            meet += float(np.clip(-height / slope, -_NEAR / 2, _NEAR / 2))
            error = float(fit[1][0] / abs(slope))
        if not (low < meet < high and error < _MOST_ERROR):
            return unknown
        sums[[*pair, other]] += meet, meet, -meet
    return sums
