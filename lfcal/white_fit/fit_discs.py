"""Fit of two discs whose overlap is lit to pixels of some microimages all over the field."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import SIGNIFICANT, TUKEY_CUTOFF, biweight, robust_sigma
from ..runtime.arrays import Floats
from .disc_light import (
    BEND,
    CORRELATION,
    COUNT,
    GAP,
    GROWTH,
    LOG_BLUR,
    RADIUS,
    SHADING,
    TAIL,
)
from .microimages import Microimages
from .two_discs import DiscPixels, TwoDiscs, choose_lens, choose_pixels, correct_slope

__all__ = ["fit_two_discs"]

# Where the fit starts: growth and radii of both discs over the radius of whole microimages. Of two
# equal discs the lattice follows the middle; a disc that cuts only the corners leaves it to the
# lenses.
_STARTS = np.array([(-0.15, 0.15, 1.02, 1.08), (0, 0.2, 1, 1.2), (0, -0.2, 1, 1.2)])
_START_SHADING = 0.02
_START_CORRELATION = 0.3
# Radii over that radius: standard deviation, and least one.
_RADIUS_RANGE = 0.3
# Standard deviations of the other parameters from the start.
_DEVIATIONS = ((LOG_BLUR, 0.5), (SHADING, 0.3), (GAP, 0.1), (TAIL, 0.03), (CORRELATION, 0.5))
# [px] Pixels of finite size blur every edge by this at least.
_LEAST_BLUR = 0.2
# Bounds. Uniform discs and squares have a tail of 0.05, normal blur 0, longer tails less.
_TAILS = (-0.03, 0.06)
_CORRELATIONS = (0, 0.98)
# Logarithms of the blurs of both edges are alike to this; beyond the other one, more counts no
# further.
_ALIKE = 0.01
_DIFFERENT = 0.1
# Squared length of the last step [standard errors].
_CONVERGED = 0.1
# Pixels of the first two fits, and of the last one.
_FIRST_PIXELS = 10_000
_MORE_PIXELS = 20_000
_LAST_PIXELS = 150_000
# [px] A distortion that is less in the corners moves centres by less than 0.01 px.
_LEAST_BEND = 0.15
# Information on a parameter, over that of its column, below which the pixels do not tell it.
_UNTOLD = 1e-12


def fit_two_discs(lenses: Microimages, lattice: Lattice) -> TwoDiscs | None:
    """The two discs that explain the microimages best, the lens first; None where there are none.

    `lenses` have been fitted without a cut, on `lattice`. First on few pixels without what only
    matters near the end, then on more, at last by Gauss-Newton steps on most of those near the
    edges.
    """
    starts, spread = _starts(lenses)
    low, high = _bounds(lenses.radius)
    simple = spread.copy()
    simple[[TAIL, CORRELATION]] = 0
    try:
        pixels = choose_pixels(lenses, lenses.slope, lattice, _FIRST_PIXELS)
        fits = [_minimise(pixels, start, start, simple, low, high) for start in starts]
        misses = [np.abs(pixels.compare(p, np.ones(len(pixels.light)))[0]).mean() for p, *_ in fits]
        nearest = int(np.argmin(misses))
        expected = starts[nearest]
        p, gain, _ = fits[nearest]
        slope = correct_slope(lenses, lenses.slope, pixels, gain)
        pixels = choose_pixels(lenses, slope, lattice, _MORE_PIXELS)
        p, gain, errors = _minimise(pixels, p, expected, spread, low, high)
        slope = correct_slope(lenses, slope, pixels, gain)
        if lattice.distortion is None and abs(p[BEND]) < max(
            _LEAST_BEND, SIGNIFICANT * errors[BEND]
        ):
            p[BEND] = spread[BEND] = 0
        pixels = choose_pixels(lenses, slope, lattice, _LAST_PIXELS, p)
        spread[(p <= low + 1e-6) | (p >= high - 1e-6)] = 0
        p, covariance, offsets, halves = _finish(pixels, p, expected, spread, low, high)
    except (np.linalg.LinAlgError, ValueError):
        return None
    found = TwoDiscs(
        lattice, p, covariance, lenses.radius, lenses.indices[pixels.rows], offsets, halves
    )
    return choose_lens(found)


def _starts(lenses: Microimages) -> tuple[Floats, Floats]:
    """Parameters (s, 19) to start from, and the standard deviations by which they may differ."""
    radius = lenses.radius
    starts = np.zeros((len(_STARTS), COUNT))
    spread = np.full(COUNT, np.inf)
    starts[:, GROWTH] = _STARTS[:, :2] * radius
    starts[:, RADIUS] = _STARTS[:, 2:] * radius
    slope = np.abs(lenses.rings.table[:, 1]).max()
    starts[:, LOG_BLUR] = math.log(
        max(lenses.core / max(slope * math.sqrt(2 * math.pi), 1e-9), 2 * _LEAST_BLUR)
    )
    starts[:, SHADING] = _START_SHADING
    gap = float(lenses.profile.min() / max(lenses.profile[0], 1e-9))
    starts[:, GAP] = min(max(gap, 0.0), 0.5)
    starts[:, CORRELATION] = _START_CORRELATION
    spread[RADIUS] = _RADIUS_RANGE * radius
    for place, deviation in _DEVIATIONS:
        spread[place] = deviation
    return starts, spread


def _bounds(scale: float) -> tuple[Floats, Floats]:
    """Least and largest parameters."""
    low = np.full(COUNT, -np.inf)
    high = np.full(COUNT, np.inf)
    low[RADIUS] = _RADIUS_RANGE * scale
    high[RADIUS] = 2 * scale
    low[LOG_BLUR] = math.log(_LEAST_BLUR)
    high[LOG_BLUR] = math.log(0.5 * scale)
    low[TAIL], high[TAIL] = _TAILS
    low[CORRELATION], high[CORRELATION] = _CORRELATIONS
    return low, high


def _prior(p: Floats, expected: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """Residuals of the prior knowledge, and their negative derivatives.

    Parameters have a `spread`. The blurs of both edges are alike (`_ALIKE`), or else they differ.
    """
    differ = float(p[LOG_BLUR][1] - p[LOG_BLUR][0])
    root = math.sqrt(1 + (differ / _DIFFERENT) ** 2)
    alike = np.zeros(COUNT)
    alike[LOG_BLUR] = np.array([-1, 1]) / (_ALIKE * root**3)
    stiff = np.diag(1 / np.where(spread > 0, spread, np.inf))
    miss = np.append(stiff @ (expected - p), -differ / (_ALIKE * root))
    return miss, np.vstack([stiff, alike])


def _minimise(
    pixels: DiscPixels, p: Floats, expected: Floats, spread: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats, Floats]:
    """Parameters, gains and standard errors by least squares with a robust loss.

    Parameters without `spread` are held.
    """
    from scipy.optimize import least_squares

    free = np.flatnonzero(spread > 0)
    even = np.ones(len(pixels.light))
    noise = robust_sigma(pixels.compare(p, even)[0]) + 1e-9

    @lru_cache(maxsize=1)
    def compare(values: bytes) -> tuple[Floats, Floats, Floats]:
        whole = p.copy()
        whole[free] = np.frombuffer(values)
        residual, table, gain = pixels.compare(whole, even)
        away, stiff = _prior(whole, expected, spread)
        jacobian = -np.vstack([table / noise, stiff])[:, free]
        return np.append(residual / noise, away), jacobian, gain

    start = np.clip(p, low + 1e-6, high - 1e-6)[free]
    solution: Any = least_squares(
        lambda v: compare(v.tobytes())[0],
        start,
        lambda v: compare(v.tobytes())[1],
        (low[free], high[free]),
        "trf",
        ftol=1e-4,
        x_scale="jac",
        loss="soft_l1",
        f_scale=3.0,
        tr_solver="exact",
        max_nfev=30,
    )
    best = p.copy()
    errors = np.zeros(COUNT)
    best[free] = solution.x
    errors[free] = _standard_errors(solution.jac)
    return best, compare(solution.x.tobytes())[2], errors


def _standard_errors(jacobian: Floats) -> Floats:
    """(p,) standard errors of parameters; infinite where the residuals (n, p) do not tell them."""
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1
    normal = normal / np.outer(scale, scale) + _UNTOLD * np.eye(len(scale))
    variance = np.diag(np.linalg.inv(normal))
    return np.where(variance < 0.01 / _UNTOLD, np.sqrt(np.abs(variance)) / scale, np.inf)


def _finish(
    pixels: DiscPixels, p: Floats, expected: Floats, spread: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Gauss-Newton steps with Tukey's weights from a first fit.

    Returns parameters, covariance, offsets of single lenses, and `halves`.
    """
    free = np.flatnonzero(spread > 0)
    weight = np.ones(len(pixels.light))
    p = p.copy()
    for _ in range(6):
        residual, table, _ = pixels.compare(p, weight)
        noise = robust_sigma(residual) + 1e-9
        weight = biweight((residual / (TUKEY_CUTOFF * noise)) ** 2)
        away, stiff = _prior(p, expected, spread)
        rows = table * (weight / noise**2)[:, None]
        prior = (stiff.T @ stiff)[np.ix_(free, free)]
        pull = (stiff.T @ away)[free]
        normal = (rows.T @ table)[np.ix_(free, free)] + prior
        step = np.linalg.solve(normal, (rows.T @ residual)[free] + pull)
        p[free] = np.clip(p[free] + step, low[free], high[free])
        if step @ normal @ step < _CONVERGED:
            break
    covariance = np.zeros((COUNT, COUNT))
    halves = np.zeros(COUNT)
    covariance[np.ix_(free, free)] = np.linalg.inv(normal)
    for side, sign in ((0, 1), (1, -1)):
        own = pixels.lens % 2 == side
        part = (rows[own].T @ table[own])[np.ix_(free, free)] + prior / 2
        halves[free] += sign * np.linalg.solve(part, (rows[own].T @ residual[own])[free] + pull / 2)
    shifts = table[:, :2] + table[:, 2:4]
    first = np.searchsorted(pixels.lens, np.arange(len(pixels.field)))
    weighted = shifts * (weight / noise**2)[:, None]
    single = np.add.reduceat(weighted[:, :, None] * shifts[:, None, :], first)
    force = np.add.reduceat(weighted * residual[:, None], first)
    ridge = 1e-6 * np.trace(single.mean(0)) * np.eye(2)
    return p, covariance, np.linalg.solve(single + ridge, force[..., None])[..., 0], halves
