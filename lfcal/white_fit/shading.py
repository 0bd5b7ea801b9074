"""How light falls across a microimage: with the light of the whole field, and with the angle of its rays.

A pixel sees the exit pupil of the main lens through its microlens. Light falls with the angle of its rays, so about the
place below the microlens; that lies the farther from the centre of the microimage the farther out it is in the field.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.cell import clip_rows
from ..lattice.lattice import Lattice
from ..runtime.fastmath import FAST
from .normal_equations import Microimages

__all__ = ["field_shading", "fit_field_slope", "fit_shading_slope"]

# So many lenses show how the gain changes over the field.
_TILTED = 4000
# Slopes are looked at in this share of the radius inside a cell, where cuts are rare and edges far.
_INSIDE = 0.6
# They are believed beyond so many standard errors.
_SURE = 6.0
# Residuals beyond so many times the median have no say.
_OUTLIER = 4.0


def fit_field_slope(centres: NDArray[np.float64], gain: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the gain over the field [1/px], from a polynomial through all lenses."""
    scale = np.array(lattice.image_size) / 2
    x, y = ((centres - scale) / scale).T
    powers = [(a, b) for a in range(5) for b in range(5 - a)]
    xs, ys = _powers(x, 4), _powers(y, 4)
    few = slice(None, None, max(1, len(gain) // _TILTED))
    log, table = np.log(gain[few]), np.column_stack([xs[a][few] * ys[b][few] for a, b in powers])
    keep = np.ones(len(log), dtype=bool)
    slope: NDArray[Any] = np.zeros(len(powers))
    for _ in range(3):
        if keep.sum() < 3 * len(powers):
            return np.zeros_like(centres)
        slope = _least_squares(table[keep], log[keep])
        miss = np.abs(log - table @ slope)
        keep = miss < 5 * np.median(miss) + 1e-6
    dx, dy = np.zeros(len(gain)), np.zeros(len(gain))
    for (a, b), factor in zip(powers, slope.tolist(), strict=True):
        if a:
            dx += a * factor * xs[a - 1] * ys[b]
        if b:
            dy += b * factor * xs[a] * ys[b - 1]
    return np.column_stack([dx, dy]) / scale


def _least_squares(table: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(p,) answer of a long table (n, p) of few columns, which its normal equations give in a fraction of the time."""
    return np.asarray(np.linalg.lstsq(table.T @ table, table.T @ values, rcond=None)[0], np.float64)


def _powers(values: NDArray[np.float64], highest: int) -> list[NDArray[np.float64]]:
    """Powers 0, 1, ... of values (n,); NumPy's own take far longer than products of them."""
    powers = [np.ones_like(values)]
    for _ in range(highest):
        powers.append(powers[-1] * values)
    return powers


@njit(cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=FAST)
def _slopes(light, corners, centres, gain, tilt, level, step, reach, out):
    """(n, 3): slope of the light of each lens beyond `tilt`, relative to its profile [1/px], and its weight [px^2]."""
    lenses, side = light.shape[0], light.shape[1]
    per_step = 1 / step
    for lens in prange(lenses):
        over, tilt_x, tilt_y = 1 / gain[lens], tilt[lens, 0], tilt[lens, 1]
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
                model = level[ring] + (level[ring + 1] - level[ring]) * (place - ring)
                miss = light[lens, y, x] * over - model * (1 + tilt_x * dx + tilt_y * dy)
                across += miss * model * dx
                down += miss * model * dy
                square += 0.5 * model * model * (dx * dx + dy * dy)
        out[lens, 2] = square
        out[lens, 0] = across / max(square, 1e-30)
        out[lens, 1] = down / max(square, 1e-30)


def field_shading(discs: Microimages, lattice: Lattice) -> NDArray[np.float64]:
    """As `fit_shading_slope`, where microimages shade light evenly about their centres."""
    # Clipped cores, which the gains began with, say nothing about how light falls over the field.
    return fit_field_slope(discs.centres, np.maximum(discs.gain, 1e-12), lattice)


def fit_shading_slope(discs: Microimages, lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the light inside each microimage [1/px], beside what its profile says.

    Parameters
    ----------
    discs : Discs
        With gains and profile that fit.
    lattice : Lattice
    """
    gain, tilt = np.maximum(discs.gain, 1e-12), field_shading(discs, lattice)
    if np.isfinite(discs.full):
        return tilt
    found = np.zeros((len(gain), 3))
    _slopes(
        discs.light, discs.corners, discs.centres, gain, tilt, discs.level, discs.step, _INSIDE * discs.inner, found
    )
    # A slope that grows with the distance from an axis that may lie beside the middle.
    far = np.ascontiguousarray((discs.centres - (np.array(lattice.image_size) - 1) / 2).T)
    slopes, weight = np.ascontiguousarray(found[:, :2].T), np.ascontiguousarray(found[:, 2])
    root, some = np.sqrt(weight), weight > 0
    keep = np.stack([some, some])
    for _ in range(3):
        if keep.sum() < 12:
            return tilt
        normal, right = _growing_slope(far, slopes, weight * keep)
        answer = np.linalg.lstsq(normal, right, rcond=None)[0]
        growing = answer[:2, None] + answer[2] * far
        miss = np.abs(slopes - growing) * root
        keep = some & (miss < _OUTLIER * np.median(miss if some.all() else miss[:, some]) + 1e-12)
    variance = float((miss[keep] ** 2).mean())
    information = _growing_slope(far, slopes, weight * keep)[0] / max(variance, 1e-30)
    if answer @ information @ answer < _SURE**2:
        return tilt
    return tilt + growing.T


def _growing_slope(
    far: NDArray[np.float64], slopes: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normal equations (3, 3), (3,) of slopes (2, n), one in x and one in y, and their common growth with `far` (2, n).

    They are summed up column by column: the table of all lenses would be mostly noughts.
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
