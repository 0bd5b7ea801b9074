"""Corners in single microimages: a blurred edge cross, or disc, fitted to the pixels.

The camera predicts position, directions and scale of the pattern in each microimage. Gauss-Newton
steps, on all corners side by side, fit its position, two grey values and the blur. The transfer
curve of the flat is fitted to all corners together, because encoded values shift blurred edges
towards black. A corner is fitted to the lit pixels within a fraction of a square. A cross of
blurred edges (Mallon and Whelan 2007) has no perspective bias: lines through the corner stay lines.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ..runtime.arrays import Array, Booleans, Singles
from ..runtime.kernels import kernel
from .board import Board

__all__ = ["CornerFits", "fit_corners"]

_UNKNOWNS = 5  # shift x and y, mean grey, half contrast, blur
_BLUR = 4
# Pixels up to this distance from a corner along both edges are fitted [squares]; 1 is the next one.
_REACH = 0.7
# Share of the margin between a marker and its square that is fitted: the rest is for wrong guesses.
_MARGIN = 0.8
_ITERATIONS = 9
# First iteration that changes the transfer curve, when most corners have converged.
_FIRST_TRANSFER = 3
# Coefficients of the transfer curve stay below this, so that it rises everywhere.
_MOST_TRANSFER = 0.45
# Blurs that microlenses can have [px], and the factors by which a step may change a blur.
_BLURS = (0.25, 6.0)
_BLUR_STEP = (0.6, 1.6)
# Damping of a step, in units of the diagonal of the normal equations (Levenberg and Marquardt).
_DAMPING = 1e-4
# Limits of a usable fit: noise over contrast, least eigenvalue of the normalised equations, pixels
# for each unknown, contrast over the median of all corners, shift from the prediction [squares],
# standard error [px].
_MOST_NOISE = 0.2
_LEAST_EIGENVALUE = 0.02
_LEAST_PIXELS = 5
_LEAST_CONTRAST = 0.4
_MOST_SHIFT = 0.35
_MOST_ERROR = 0.5


class CornerFits(NamedTuple):
    """Corners in microimages."""

    position: Array  # (n, 2) [px]
    error: Array  # (n,) [px] standard error along each axis, from the residuals
    # (n,) half the difference of the grey values; the sign shows which squares are dark
    contrast: Array
    blur: Array  # (n,) [px] standard deviation of the blur
    good: Booleans  # (n,) whether the fit can be used


class _Sums(NamedTuple):
    """Sums over the pixels of each corner."""

    normal: Array  # (n, 5, 6) normal equations with their right side
    pixels: Array  # (n, 2) number of pixels, squared residuals
    transfer: Array  # (n, 5) normal equations of the transfer: three of the matrix, the right side


@njit(error_model="numpy", inline="always")
def _edge(distance, blur):
    """Value of a blurred edge from -1 to 1 at a signed distance [px], and its slope [1/px]."""
    place = distance / blur
    slope = math.sqrt(2 / math.pi) / blur * math.exp(-0.5 * place * place)
    return math.erf(place / math.sqrt(2.0)), slope


@kernel(error_model="numpy", share=lambda flat, centres, *_: len(centres))
def _add_pixels(
    begin,
    end,
    flat,
    centres,
    radius,
    predicted,
    inverse,
    reach,
    disc,
    margin,
    transfer,
    parameters,
    sums,
):
    """Add the pixels of corners to their sums.

    `inverse` (n, 2, 2) are squares per px, `reach` (n,) [px] is the distance to each side. The grey
    value is `mean + contrast y + |contrast| (1 - y^2) (t_0 + t_1 y)`, where `y` is the blurred
    pattern, positive where it is light, and `t` the transfer. `disc` is the radius of circles
    [squares], 0 for corners. Of corners, pixels within `margin` squares of an edge are fitted.
    """
    row = np.empty(_UNKNOWNS)
    for n in range(begin, end):
        a = inverse[n, 0, 0]
        b = inverse[n, 0, 1]
        c = inverse[n, 1, 0]
        d = inverse[n, 1, 1]
        mean = parameters[n, 2]
        contrast = parameters[n, 3]
        blur = parameters[n, 4]
        light = 1.0 if contrast >= 0 else -1.0
        x0 = round(predicted[n, 0])
        y0 = round(predicted[n, 1])
        half = math.ceil(reach[n])
        for y in range(max(y0 - half, 0), min(y0 + half + 1, flat.shape[0])):
            for x in range(max(x0 - half, 0), min(x0 + half + 1, flat.shape[1])):
                # The edge of a microimage is soft over a pixel.
                if (x - centres[n, 0]) ** 2 + (y - centres[n, 1]) ** 2 >= (radius - 1) ** 2:
                    continue
                dx = x - predicted[n, 0]
                dy = y - predicted[n, 1]
                u = abs(a * dx + b * dy)
                v = abs(c * dx + d * dy)
                if max(u, v) >= _REACH or min(u, v) >= margin:
                    continue
                dx -= parameters[n, 0]
                dy -= parameters[n, 1]
                u = a * dx + b * dy
                v = c * dx + d * dy
                if disc > 0:
                    size = math.sqrt(u * u + v * v) + 1e-9
                    gx = (u * a + v * c) / size
                    gy = (u * b + v * d) / size
                    steep = math.sqrt(gx * gx + gy * gy) + 1e-9
                    far = (size - disc) / steep
                    level, slope = _edge(far, blur)
                    gx = slope * gx / steep
                    gy = slope * gy / steep
                    gb = slope * far
                else:
                    p = math.sqrt(a * a + b * b)
                    q = math.sqrt(c * c + d * d)
                    u /= p
                    v /= q
                    first, s = _edge(u, blur)
                    second, t = _edge(v, blur)
                    level = first * second
                    s *= second
                    t *= first
                    gx = s * a / p + t * c / q
                    gy = s * b / p + t * d / q
                    gb = s * u + t * v
                level *= light
                rest = 1 - level * level
                curve = transfer[0] + transfer[1] * level
                gain = contrast * (1 - 2 * level * curve + transfer[1] * rest)
                coded = light * (level + rest * curve)
                row[0] = -gain * gx
                row[1] = -gain * gy
                row[2] = 1.0
                row[3] = coded
                row[_BLUR] = -gain / blur * gb
                residual = flat[y, x] - mean - contrast * coded
                for k in range(_UNKNOWNS):
                    for j in range(_UNKNOWNS):
                        sums.normal[n, k, j] += row[k] * row[j]
                    sums.normal[n, k, _UNKNOWNS] += row[k] * residual
                sums.pixels[n, 0] += 1
                sums.pixels[n, 1] += residual * residual
                bend = abs(contrast) * rest
                own = sums.transfer[n]
                own[0] += bend * bend
                own[1] += bend * bend * level
                own[2] += bend * bend * level * level
                own[3] += bend * residual
                own[4] += bend * level * residual


def fit_corners(
    flat: Singles,
    centres: Array,
    radius: float,
    predicted: Array,
    shape: Array,
    board: Board,
    linear: bool = False,
) -> CornerFits:
    """Fit corners predicted at (n, 2) [px] in the microimages with centres (n, 2) [px].

    `shape` (n, 2, 2) [px] are the columns d(position) / d(board), one square long. If values are
    `linear`, in proportion to light, no curve of the transfer is fitted.
    """
    n = len(predicted)
    parameters = np.zeros((n, _UNKNOWNS))
    parameters[:, _BLUR] = 1.0
    transfer = np.zeros(2)
    marker = float(board.marker or 0) / board.square
    margin = np.inf
    if board.pattern == "charuco":
        # Markers fill the white squares up to a margin.
        margin = _MARGIN * (1 - marker) / 2
    disc = 0.0
    if board.pattern == "circles":
        disc = marker / 2
    reach = np.minimum(_REACH * np.abs(shape).sum(2).max(1), 2 * radius)
    fitted = (flat, centres, radius, predicted, np.linalg.inv(shape), reach, disc, margin)
    for iteration in range(_ITERATIONS):
        sums = _Sums(np.zeros((n, _UNKNOWNS, _UNKNOWNS + 1)), np.zeros((n, 2)), np.zeros((n, 5)))
        _add_pixels(*fitted, transfer, parameters, sums)
        pixels, square = sums.pixels.T
        noise = np.sqrt(square / np.maximum(pixels - _UNKNOWNS, 1))
        clear = noise < _MOST_NOISE * np.abs(parameters[:, 3])
        parameters = _stepped(parameters, sums.normal, iteration)
        if not linear and iteration >= _FIRST_TRANSFER and clear.any():
            one, mixed, two, *right = sums.transfer[clear].sum(0)
            transfer += np.linalg.lstsq([[one, mixed], [mixed, two]], right, rcond=1e-6)[0]
            transfer = np.clip(transfer, -_MOST_TRANSFER, _MOST_TRANSFER)
    unit, scale = _normalised(sums.normal)
    inverse = np.diagonal(np.linalg.inv(unit + 1e-9 * np.eye(_UNKNOWNS)), axis1=1, axis2=2)
    variances = np.maximum((inverse / (scale * scale))[:, :2], 0) * (noise**2)[:, None]
    shift = parameters[:, :2]
    contrast = np.abs(parameters[:, 3])
    good = (
        (np.linalg.eigvalsh(unit)[:, 0] > _LEAST_EIGENVALUE)
        & (pixels > _LEAST_PIXELS * _UNKNOWNS)
        & (contrast > _LEAST_CONTRAST * np.median(contrast))
        & (noise < _MOST_NOISE * contrast)
        & (np.hypot(*shift.T) < _MOST_SHIFT * np.sqrt(np.abs(np.linalg.det(shape))))
        & (np.sqrt(variances.max(1)) < _MOST_ERROR)
    )
    error = np.sqrt(variances.mean(1))
    return CornerFits(predicted + shift, error, parameters[:, 3], parameters[:, _BLUR], good)


def _normalised(equations: Array) -> tuple[Array, Array]:
    """Matrices (n, 5, 5) of equations (n, 5, 6) with unit diagonals, and their units (n, 5)."""
    normal = equations[..., :_UNKNOWNS]
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-12))
    return normal / (scale[:, :, None] * scale[:, None, :]), scale


def _stepped(parameters: Array, equations: Array, iteration: int) -> Array:
    """Parameters (n, 5) after one damped step; the first step fits the grey values alone."""
    free = np.ones(_UNKNOWNS)
    if iteration == 0:
        free[[0, 1, _BLUR]] = 0
    unit, scale = _normalised(equations)
    damped = unit * np.outer(free, free) + np.eye(_UNKNOWNS) * (_DAMPING + (1 - free))
    gradient = equations[..., _UNKNOWNS] / scale * free
    step = np.linalg.solve(damped, gradient[..., None])[..., 0] / scale
    # A corner moves by one pixel at most.
    step[:, :2] /= np.maximum(np.hypot(*step[:, :2].T), 1)[:, None]
    new = parameters + step
    low, high = np.outer(_BLUR_STEP, parameters[:, _BLUR])
    new[:, _BLUR] = np.clip(np.clip(new[:, _BLUR], low, high), *_BLURS)
    return new
