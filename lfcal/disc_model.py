"""Model of a white image: discs of one radial profile, each with its own gain, cut by a second disc (cat-eye).

Away from the optical axis a stop in front of or behind the main lens' pupil cuts microimages to lens shapes. The cut
is a disc too, and its place relative to the microimage changes in proportion to the place in the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["LOCAL", "CatEye", "DiscSteps", "Discs", "disc_steps", "measure_level"]

# Parameters of a single lens: place (2), displacement of the cutting disc (2), its radius, its softness, the gain.
LOCAL = 7
_CHUNKS = 64
# Beyond so many standard deviations from its middle the cut is all or nothing.
_EDGE = 4.0
# Residuals beyond so many standard deviations have no say (Tukey's biweight).
_OUTLIER = 4.685
_ROOT_HALF = math.sqrt(0.5)
_ROOT_TAU = math.sqrt(2 * math.pi)


@dataclass(frozen=True)
class CatEye:
    """Disc that cuts the microimages, at `shift + growth * (c - middle) / reach` from the centre `c` of each.

    Parameters
    ----------
    shift : (2,) float64 [px]
        Displacement in the middle of the flat.
    growth : float [px]
        Displacement added from the middle to the corner, positive outwards.
    radius, soft : float [px]
        Radius of the cutting disc and standard deviation of its edge.
    """

    shift: NDArray[np.float64]
    growth: float
    radius: float
    soft: float


@dataclass(frozen=True)
class Discs:
    """Lenses to be compared with the model, and the model.

    Parameters
    ----------
    centres, cut : (n, 2) float64 [px]
        Microimage centres and displacements of the cutting discs from them.
    gain : (n,) float64
    tilt : (n, 2) float64 [1/px]
        Relative change of the gain within the microimage.
    cat_eye : CatEye or None
    faces : (k, 2) float64 [1/px]
        `delta @ face <= 0.5` inside the cell of a lens.
    inner, reach : float [px]
        Radii of the circles inside and around the cell.
    step : float [px]
        Between samples of the profile.
    level, weight : (r,) float64
        Profile and inverse variance of its pixels at radii `0, step, 2*step...`.
    dark : float
        Light where the cutting disc lets none through.
    """

    centres: NDArray[np.float64]
    cut: NDArray[np.float64]
    gain: NDArray[np.float64]
    tilt: NDArray[np.float64]
    cat_eye: CatEye | None
    faces: NDArray[np.float64]
    inner: float
    reach: float
    step: float
    level: NDArray[np.float64]
    weight: NDArray[np.float64]
    dark: float


@dataclass(frozen=True)
class DiscSteps:
    """Least squares of each lens by itself, and the residuals of all.

    Parameters
    ----------
    normal, right : (n, 7, 7), (n, 7) float64
        Normal matrix and right side of the local parameters, the gain last.
    variance : (r,) float64
        Mean squared residual over the radius, without outliers.
    cost : float
        Weighted mean of squared residuals, each at most the square of the outlier limit.
    pixels : int
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    variance: NDArray[np.float64]
    cost: float
    pixels: int


@njit(cache=True, nogil=True)
def _outside(dx, dy, faces):
    for face in range(faces.shape[0]):  # noqa: SIM110
        if dx * faces[face, 0] + dy * faces[face, 1] > 0.5:
            return True
    return False


@njit(cache=True, nogil=True)
def _transmission(dx, dy, radius, soft):
    """Light through the cutting disc, its slope [1/px], distance to the disc's centre, depth in units of soft."""
    far = math.sqrt(dx * dx + dy * dy)
    depth = (radius - far) / soft
    if depth > _EDGE:
        return 1.0, 0.0, far, depth
    if depth < -_EDGE:
        return 0.0, 0.0, far, depth
    return 0.5 * (1 + math.erf(depth * _ROOT_HALF)), math.exp(-0.5 * depth * depth) / (_ROOT_TAU * soft), far, depth


@njit(cache=True, nogil=True, parallel=True)
def _accumulate_level(
    picture, centres, cut, gain, tilt, radius, soft, faces, inner, reach, step, level, weight, dark, chunks,
    diagonal, beside, right,
):  # fmt: skip
    lenses = centres.shape[0]
    known = level.shape[0] > 0
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            for y in range(int(np.ceil(cy - reach)), int(np.floor(cy + reach)) + 1):
                dy = y - cy
                half = np.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(int(np.ceil(cx - half)), int(np.floor(cx + half)) + 1):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and _outside(dx, dy, faces):
                        continue
                    through = 1.0
                    if soft > 0:
                        through = _transmission(dx - cut[lens, 0], dy - cut[lens, 1], radius, soft)[0]
                        if through < 0.5:
                            continue
                    value = picture[y, x] / (gain[lens] * (1 + tilt[lens, 0] * dx + tilt[lens, 1] * dy))
                    value -= dark * (1 - through)
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    if known:
                        residual = value - through * (level[ring] * (1 - part) + level[ring + 1] * part)
                        if residual * residual * weight[ring] > _OUTLIER * _OUTLIER:
                            continue
                    square = through * through
                    diagonal[chunk, ring] += square * (1 - part) * (1 - part)
                    diagonal[chunk, ring + 1] += square * part * part
                    beside[chunk, ring] += square * part * (1 - part)
                    right[chunk, ring] += through * (1 - part) * value
                    right[chunk, ring + 1] += through * part * value


@njit(cache=True, nogil=True, parallel=True)
def _accumulate_steps(
    picture, centres, cut, gain, tilt, radius, soft, faces, inner, reach, step, level, slope, weight, dark, chunks,
    normal, right, squares, count, cost,
):  # fmt: skip
    lenses = centres.shape[0]
    for chunk in prange(chunks):
        g = np.zeros(7)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            for y in range(int(np.ceil(cy - reach)), int(np.floor(cy + reach)) + 1):
                dy = y - cy
                half = np.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(int(np.ceil(cx - half)), int(np.floor(cx + half)) + 1):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and _outside(dx, dy, faces):
                        continue
                    bright = 1 + tilt[lens, 0] * dx + tilt[lens, 1] * dy
                    light = gain[lens] * bright
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    disc = level[ring] * (1 - part) + level[ring + 1] * part - dark
                    through, change, far, depth = 1.0, 0.0, 1.0, 0.0
                    if soft > 0:
                        ex, ey = dx - cut[lens, 0], dy - cut[lens, 1]
                        through, change, far, depth = _transmission(ex, ey, radius, soft)
                    model = dark + disc * through
                    residual = picture[y, x] / light - model
                    w = weight[ring] * (1 - part) + weight[ring + 1] * part
                    away = residual * residual * w / (_OUTLIER * _OUTLIER)
                    cost[chunk, 1] += 1
                    cost[chunk, 0] += min(away, 1.0)
                    if away >= 1:
                        continue
                    squares[chunk, ring] += residual * residual
                    count[chunk, ring] += 1
                    w *= (1 - away) * (1 - away)
                    along = -(slope[ring] * (1 - part) + slope[ring + 1] * part) * through / max(rho, 1e-6)
                    g[0], g[1], g[6] = along * dx, along * dy, model
                    low = 6
                    if change > 0:
                        push = disc * change
                        g[2], g[3] = push * ex / max(far, 1e-6), push * ey / max(far, 1e-6)
                        g[0] += g[2]
                        g[1] += g[3]
                        g[4], g[5] = push, -push * depth
                        low = 2
                    for a in range(7):
                        if a >= 2 and a < low:
                            continue
                        right[lens, a] += w * g[a] * residual
                        for b in range(a, 7):
                            if b >= 2 and b < low:
                                continue
                            normal[lens, a, b] += w * g[a] * g[b]


def _cutting(discs: Discs) -> tuple[float, float]:
    """Radius and softness of the cutting disc; no softness where there is none."""
    return (discs.cat_eye.radius, discs.cat_eye.soft) if discs.cat_eye is not None else (0.0, 0.0)


def measure_level(picture: NDArray[np.float32], discs: Discs, known: bool) -> NDArray[np.float64]:
    """(r,) profile that fits best, piecewise linear; outliers of the present one left out where that is `known`."""
    rings = len(discs.level)
    diagonal, beside, right = (np.zeros((_CHUNKS, rings)) for _ in range(3))
    level = discs.level if known else np.zeros(0)
    _accumulate_level(
        picture, discs.centres, discs.cut, discs.gain, discs.tilt, *_cutting(discs), discs.faces, discs.inner,
        discs.reach, discs.step, level, discs.weight, discs.dark, _CHUNKS, diagonal, beside, right,
    )  # fmt: skip
    main, side = diagonal.sum(0), beside.sum(0)[:-1]
    # Rings no pixel fell into continue their neighbours smoothly.
    bend = np.diff(np.eye(rings), 2, axis=0)
    system = np.diag(main) + np.diag(side, 1) + np.diag(side, -1) + 1e-3 * bend.T @ bend
    solved: NDArray[np.float64] = np.linalg.solve(system, right.sum(0))
    return solved


def disc_steps(picture: NDArray[np.float32], discs: Discs) -> DiscSteps:
    """Gauss-Newton steps of all local parameters of all lenses, over every pixel of their cells."""
    lenses, rings = len(discs.centres), len(discs.level)
    normal, right = np.zeros((lenses, LOCAL, LOCAL)), np.zeros((lenses, LOCAL))
    squares, count = np.zeros((_CHUNKS, rings)), np.zeros((_CHUNKS, rings))
    cost = np.zeros((_CHUNKS, 2))
    slope = np.gradient(discs.level, discs.step)
    _accumulate_steps(
        picture, discs.centres, discs.cut, discs.gain, discs.tilt, *_cutting(discs), discs.faces, discs.inner,
        discs.reach, discs.step, discs.level, slope, discs.weight, discs.dark, _CHUNKS,
        normal, right, squares, count, cost,
    )  # fmt: skip
    normal += np.triu(normal.reshape(-1, LOCAL, LOCAL), 1).transpose(0, 2, 1)
    number = count.sum(0)
    # Few pixels say little about their spread: neighbouring rings are taken together.
    smooth = np.ones(5)
    total = np.convolve(squares.sum(0), smooth, "same")
    number_near = np.convolve(number, smooth, "same")
    overall = total.sum() / max(number_near.sum(), 1)
    variance = (total + 10 * overall) / (number_near + 10)
    away, pixels = cost.sum(0)
    return DiscSteps(normal, right, variance, float(away / max(pixels, 1)) * _OUTLIER**2, int(pixels))
