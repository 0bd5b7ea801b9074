"""Slope of the light across a microimage: from the light over the field, and from the angle of its rays.

A pixel sees the exit pupil of the main lens through its microlens. Light falls off with the angle of its rays, that is
about the point below the microlens, which lies the farther from the centre of the microimage the farther out in the
field it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import clip_rows
from ..lattice.lattice import Lattice
from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import kernel
from .normal_equations import Microimages
from .settings import PIXELS

__all__ = ["field_slope", "fit_gain_slope", "fit_shade"]

# Degree of the polynomial of the gain over the field.
_DEGREE = 4


def fit_gain_slope(centres: NDArray[np.float64], gain: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the gain over the field [1/px], from a polynomial through all lenses."""
    scale = np.array(lattice.image_size) / 2
    x, y = ((centres - scale) / scale).T
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a)]
    xs, ys = _powers(x), _powers(y)
    few = slice(None, None, max(1, len(gain) // PIXELS.gain_lenses))
    log, table = np.log(gain[few]), np.column_stack([xs[a][few] * ys[b][few] for a, b in powers])
    keep = np.ones(len(log), dtype=bool)
    factors: NDArray[Any] = np.zeros(len(powers))
    for _ in range(3):
        if keep.sum() < 3 * len(powers):
            return np.zeros_like(centres)
        # Normal equations of so few columns take a fraction of the time of the long table.
        some = table[keep]
        factors = np.asarray(np.linalg.lstsq(some.T @ some, some.T @ log[keep], rcond=None)[0], np.float64)
        miss = np.abs(log - table @ factors)
        keep = miss < PIXELS.gain_outlier * np.median(miss) + 1e-6
    dx, dy = np.zeros(len(gain)), np.zeros(len(gain))
    for (a, b), factor in zip(powers, factors.tolist(), strict=True):
        if a:
            dx += a * factor * xs[a - 1] * ys[b]
        if b:
            dy += b * factor * xs[a] * ys[b - 1]
    return np.column_stack([dx, dy]) / scale


def _powers(values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Powers of values (n,); NumPy's own take far longer than products."""
    powers = [np.ones_like(values)]
    for _ in range(_DEGREE):
        powers.append(powers[-1] * values)
    return powers


@kernel(error_model="numpy", share=lambda windows, *_: len(windows[0]), fastmath=FAST)
def _measure_slopes(begin, end, windows, profile, step, reach, out):
    """(n, 3): slope of the light of each lens beyond `slope`, relative to its profile [1/px], and its weight [px^2]."""
    light, corners, centres, gain, _, slope, _ = windows
    side = light.shape[1]
    per_step = 1 / step
    for lens in range(begin, end):
        over, slope_x, slope_y = 1 / gain[lens], slope[lens, 0], slope[lens, 1]
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        across = down = square = 0.0
        top, bottom = clip_rows(cy, reach, 0, side)
        for y in range(top, bottom):
            dy = y - cy
            left, right = clip_rows(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
            for x in range(left, right):
                dx = x - cx
                place = math.sqrt(dx * dx + dy * dy) * per_step
                ring = int(place)
                model = profile[ring] + (profile[ring + 1] - profile[ring]) * (place - ring)
                miss = light[lens, y, x] * over - model * (1 + slope_x * dx + slope_y * dy)
                across += miss * model * dx
                down += miss * model * dy
                square += 0.5 * model * model * (dx * dx + dy * dy)
        out[lens, 2] = square
        out[lens, 0] = across / max(square, 1e-30)
        out[lens, 1] = down / max(square, 1e-30)


def field_slope(lenses: Microimages, lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) slope [1/px] of the light inside each microimage if it is even about its centre: that of the gains."""
    return fit_gain_slope(lenses.centres, np.maximum(lenses.gain, 1e-12), lattice)


def fit_shade(lenses: Microimages, lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the own light of each microimage [1/px], a linear function of its place in the field.

    `lenses.slope` is that of the gains.
    """
    gain, slope = np.maximum(lenses.gain, 1e-12), lenses.slope
    none = np.zeros_like(slope)
    if np.isfinite(lenses.saturation):
        return none
    found, windows = np.zeros((len(gain), 3)), lenses.windows._replace(gain=gain, slope=slope)
    _measure_slopes(windows, lenses.profile, lenses.step, PIXELS.slope_inside * lenses.inradius, found)
    # A slope that grows with the distance from an axis, which may lie beside the middle.
    far = np.ascontiguousarray((lenses.centres - (np.array(lattice.image_size) - 1) / 2).T)
    slopes, weight = np.ascontiguousarray(found[:, :2].T), np.ascontiguousarray(found[:, 2])
    root, some = np.sqrt(weight), weight > 0
    keep = np.stack([some, some])
    for _ in range(3):
        if keep.sum() < 12:
            return none
        normal, right = _linear_equations(far, slopes, weight * keep)
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        linear = solution[:2, None] + solution[2] * far
        miss = np.abs(slopes - linear) * root
        keep = some & (miss < PIXELS.slope_outlier * np.median(miss if some.all() else miss[:, some]) + 1e-12)
    variance = float((miss[keep] ** 2).mean())
    information = _linear_equations(far, slopes, weight * keep)[0] / max(variance, 1e-30)
    if solution @ information @ solution < PIXELS.slope_significance**2:
        return none
    return linear.T


def _linear_equations(
    far: NDArray[np.float64], slopes: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normal equations (3, 3), (3,) of two constants, for x and y, and one factor of `far` (2, n) for both.

    Summed column by column: most of the table of all lenses would be zero.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for axis in range(2):
        grown = weight[axis] * far[axis]
        normal[axis, axis] = weight[axis].sum()
        normal[axis, 2] = normal[2, axis] = grown.sum()
        normal[2, 2] += grown @ far[axis]
        right[axis] = weight[axis] @ slopes[axis]
        right[2] += grown @ slopes[axis]
    return normal, right
