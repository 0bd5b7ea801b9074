"""Corners in single microimages: a blurred edge cross, or disc, fitted to the pixels.

The camera predicts position, directions and scale of the pattern in each microimage; fitted are the
position, two grey values, the blur, and for the whole flat the curve of its transfer, as coded
values shift blurred edges towards black. Pixels within a fraction of a square of the corner count,
as far as their microimage is lit. Gauss-Newton on all corners side by side. A cross of blurred
edges (Mallon and Whelan 2007) has no perspective bias: lines through the corner stay lines.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Array, Booleans, Singles
from ..runtime.kernels import kernel
from .board import Board

__all__ = ["CornerFits", "fit_corners"]

_UNKNOWNS = 5  # shift x and y, mean grey, half contrast, blur


class CornerFits(NamedTuple):
    """Corners in microimages."""

    position: Array  # (n, 2) [px]
    error: Array  # (n,) [px] standard error along each axis, from the residuals
    contrast: (
        Array  # (n,) half the difference of the grey values; its sign tells which squares are dark
    )
    blur: Array  # (n,) [px] standard deviation of the blur
    good: Booleans  # (n,) whether the fit can be used


class _Sums(NamedTuple):
    """Of each corner: normal equations (n, 5, 6) with their right side, number of pixels and
    squared residuals (n, 2), and the normal equations of the transfer (n, 5): three of the matrix,
    two of the right side.
    """

    normal: Array
    pixels: Array
    bend: Array


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
    """Add the pixels of corners to their sums; `inverse` (n, 2, 2) squares per px, `reach` (n,) px
    to each side.

    Grey values are `mean + contrast y + |contrast| (1 - y^2) (t_0 + t_1 y)` of the blurred pattern
    `y` with light positive: straight from black to white where the transfer is 0. `disc` is the
    radius of circles, 0 of corners; of those, pixels within `margin` squares of an edge count.
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
        flank = math.sqrt(2 / math.pi) / blur
        for y in range(max(y0 - half, 0), min(y0 + half + 1, flat.shape[0])):
            for x in range(max(x0 - half, 0), min(x0 + half + 1, flat.shape[1])):
                # The edge of a microimage is soft over a pixel.
                if (x - centres[n, 0]) ** 2 + (y - centres[n, 1]) ** 2 >= (radius - 1) ** 2:
                    continue
                dx = x - predicted[n, 0]
                dy = y - predicted[n, 1]
                u = abs(a * dx + b * dy)
                v = abs(c * dx + d * dy)
                # [squares] to each side of the corner; 1 is the next corner.
                if max(u, v) >= 0.7 or min(u, v) >= margin:
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
                    level = math.erf(far / (math.sqrt(2.0) * blur))
                    slope = math.exp(-0.5 * (far / blur) ** 2) * flank
                    gx = slope * gx / steep
                    gy = slope * gy / steep
                    gb = slope * far
                else:
                    p = math.sqrt(a * a + b * b)
                    q = math.sqrt(c * c + d * d)
                    u = u / p
                    v = v / q
                    first = math.erf(u / (math.sqrt(2.0) * blur))
                    second = math.erf(v / (math.sqrt(2.0) * blur))
                    s = second * math.exp(-0.5 * (u / blur) ** 2) * flank
                    t = first * math.exp(-0.5 * (v / blur) ** 2) * flank
                    level = first * second
                    gx = s * a / p + t * c / q
                    gy = s * b / p + t * d / q
                    gb = s * u + t * v
                level *= light
                rest = 1 - level * level
                curve = transfer[0] + transfer[1] * level
                gain = contrast * (1 - 2 * level * curve + transfer[1] * rest)
                coded = light * (level + rest * curve)
                row[0], row[1], row[2], row[3], row[4] = (
                    -gain * gx,
                    -gain * gy,
                    1.0,
                    coded,
                    -gain / blur * gb,
                )
                residual = flat[y, x] - mean - contrast * coded
                for k in range(_UNKNOWNS):
                    for j in range(_UNKNOWNS):
                        sums.normal[n, k, j] += row[k] * row[j]
                    sums.normal[n, k, _UNKNOWNS] += row[k] * residual
                sums.pixels[n, 0] += 1
                sums.pixels[n, 1] += residual * residual
                bend = abs(contrast) * rest
                sums.bend[n, 0] += bend * bend
                sums.bend[n, 1] += bend * bend * level
                sums.bend[n, 2] += bend * bend * level * level
                sums.bend[n, 3] += bend * residual
                sums.bend[n, 4] += bend * level * residual


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
    noise = np.zeros(n)
    transfer = np.zeros(2)
    parameters[:, 4] = 1.0
    marker = float(board.marker or 0) / board.square
    # Markers fill the white squares up to a margin.
    margin = 0.8 * (1 - marker) / 2 if board.pattern == "charuco" else np.inf
    disc = marker / 2 if board.pattern == "circles" else 0.0
    reach = np.minimum(0.7 * np.abs(shape).sum(2).max(1), 2 * radius)
    inverse = np.linalg.inv(shape)
    fitted = (flat, centres, radius, predicted, inverse, reach, disc, margin)
    for iteration in range(9):
        sums = _Sums(np.zeros((n, _UNKNOWNS, _UNKNOWNS + 1)), np.zeros((n, 2)), np.zeros((n, 5)))
        _add_pixels(*fitted, transfer, parameters, sums)
        pixels, square = sums.pixels.T
        noise = np.sqrt(square / np.maximum(pixels - _UNKNOWNS, 1))
        clear = noise < 0.2 * np.abs(parameters[:, 3])
        parameters = _stepped(parameters, sums.normal, iteration)
        if not linear and iteration >= 3 and clear.any():
            one, mixed, two, *right = sums.bend[clear].sum(0)
            transfer += np.linalg.lstsq([[one, mixed], [mixed, two]], right, rcond=1e-6)[0]
            transfer = np.clip(transfer, -0.45, 0.45)
    normal = sums.normal[..., :_UNKNOWNS]
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-30))
    unit = normal / (scale[:, :, None] * scale[:, None, :])
    covariance = np.linalg.inv(unit + 1e-9 * np.eye(_UNKNOWNS)) / (
        scale[:, :, None] * scale[:, None, :]
    )
    variances = (
        np.maximum(np.diagonal(covariance, axis1=1, axis2=2)[:, :2], 0) * (noise**2)[:, None]
    )
    contrast = np.abs(parameters[:, 3])
    good = (
        (np.linalg.eigvalsh(unit)[:, 0] > 0.02)
        & (pixels > 25)
        & (contrast > 0.4 * np.median(contrast))
        & (noise < 0.2 * contrast)
        & (np.hypot(*parameters[:, :2].T) < 0.35 * np.sqrt(np.abs(np.linalg.det(shape))))
        & (np.sqrt(variances.max(1)) < 0.5)
    )
    error = np.sqrt(variances.mean(1))
    return CornerFits(
        predicted + parameters[:, :2], error, parameters[:, 3], parameters[:, 4], good
    )


def _stepped(parameters: Array, equations: Array, iteration: int) -> Array:
    """One damped step; the first ones move grey values alone, which the others need."""
    free = np.ones(_UNKNOWNS)
    if iteration == 0:
        free[[0, 1, 4]] = 0
    normal = equations[..., :_UNKNOWNS]
    gradient = equations[..., _UNKNOWNS]
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-12))
    unit = normal / (scale[:, :, None] * scale[:, None, :]) * np.outer(free, free)
    unit = unit + np.eye(_UNKNOWNS) * (1e-4 + (1 - free))
    step = np.linalg.solve(unit, (gradient / scale * free)[..., None])[..., 0] / scale
    length = np.hypot(step[:, 0], step[:, 1])
    step[:, :2] *= np.minimum(1, 1.0 / np.maximum(length, 1e-12))[:, None]
    new = parameters + step
    new[:, 4] = np.clip(new[:, 4], 0.6 * parameters[:, 4], 1.6 * parameters[:, 4])
    new[:, 4] = np.clip(new[:, 4], 0.25, 6.0)
    return new
