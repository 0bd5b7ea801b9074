"""Corners in single microimages: a blurred edge cross, or disc, fitted to the pixels.

The camera predicts position, directions and scale of the pattern in each microimage; fitted are the position, two grey
values, the blur, and for the whole flat the curve of its transfer, as coded values shift blurred edges towards black.
Pixels within a fraction of a square of the corner count, as far as their microimage is lit. Gauss-Newton on all corners
side by side. A cross of blurred edges (Mallon and Whelan 2007) has no perspective bias: lines through the corner stay
lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from .board import Board

__all__ = ["CornerFits", "fit_corners"]

Array = NDArray[Any]
_WINDOW = 0.7  # [squares] to each side of the corner that is fitted; 1 is the next corner
_UNKNOWNS = 5  # shift x and y, mean grey, half contrast, blur


@dataclass(frozen=True)
class CornerFits:
    """Corners in microimages.

    Parameters
    ----------
    position : (n, 2) float64 [px]
    error : (n,) float64 [px]
        Standard error along each axis, from the residuals.
    contrast : (n,) float64
        Half the difference of the grey values; its sign tells which squares are dark.
    blur : (n,) float64 [px]
        Standard deviation of the blur.
    good : (n,) bool
        Whether the fit can be used.
    """

    position: Array
    error: Array
    contrast: Array
    blur: Array
    good: NDArray[np.bool_]


@dataclass(frozen=True)
class _Patches:
    """Pixels (n, w) about each corner: values, weights, and positions from the predicted corner (n, w, 2)."""

    value: Array
    weight: Array
    offset: Array
    inverse: Array  # (n, 2, 2) squares per px


def fit_corners(
    flat: NDArray[np.float32],
    centres: Array,
    radius: float,
    predicted: Array,
    shape: Array,
    board: Board,
) -> CornerFits:
    """Fit corners predicted at (n, 2) [px] in the microimages with centres (n, 2) [px].

    `shape` (n, 2, 2) [px] are the columns d(position) / d(board), one square long.
    """
    n = len(predicted)
    parameters = np.zeros((n, _UNKNOWNS))
    parameters[:, 4] = 1.0
    normal = np.zeros((n, _UNKNOWNS, _UNKNOWNS))
    noise, pixels = np.full(n, np.inf), np.zeros(n)
    if not n:
        return CornerFits(predicted, noise, pixels, pixels, np.zeros(0, bool))
    blocks = [slice(first, first + 1500) for first in range(0, n, 1500)]
    patches = [_cut(flat, centres[b], radius, predicted[b], shape[b], board) for b in blocks]
    transfer = np.zeros(2)
    for iteration in range(9):
        right, left = np.zeros(2), np.zeros((2, 2))
        for b, patch in zip(blocks, patches, strict=True):
            residual, design, bend = _model(patch, parameters[b], transfer, board)
            weighted = np.ascontiguousarray(np.swapaxes(design * patch.weight[:, :, None], 1, 2))
            normal[b] = weighted @ design
            gradient = (weighted @ residual[..., None])[..., 0]
            parameters[b] = _stepped(parameters[b], normal[b], gradient, iteration)
            pixels[b] = patch.weight.sum(1)
            noise[b] = np.sqrt((patch.weight * residual**2).sum(1) / np.maximum(pixels[b] - _UNKNOWNS, 1))
            clear = noise[b] < 0.2 * np.abs(parameters[b, 3])
            bends = bend[clear] * np.sqrt(patch.weight[clear])[..., None]
            bends = bends.reshape(-1, 2)
            left += bends.T @ bends
            right += bends.T @ residual[clear].ravel()
        if iteration >= 3 and np.trace(left) > 0:
            transfer = np.clip(transfer + np.linalg.lstsq(left, right, rcond=1e-6)[0], -0.45, 0.45)
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-30))
    unit = normal / (scale[:, :, None] * scale[:, None, :])
    condition = np.linalg.eigvalsh(unit)[:, 0]
    covariance = np.linalg.inv(unit + 1e-9 * np.eye(_UNKNOWNS)) / (scale[:, :, None] * scale[:, None, :])
    variances = np.stack([covariance[:, 0, 0], covariance[:, 1, 1]], axis=1) * (noise**2)[:, None]
    error = np.sqrt(np.maximum(variances.mean(1), 0))
    contrast = np.abs(parameters[:, 3])
    side = np.sqrt(np.abs(np.linalg.det(shape)))
    good = (
        (condition > 0.02)
        & (pixels > 25)
        & (contrast > 0.4 * np.median(contrast))
        & (noise < 0.2 * contrast)
        & (np.hypot(*parameters[:, :2].T) < 0.35 * side)
        & np.isfinite(error)
        & (np.sqrt(np.maximum(variances.max(1), 0)) < 0.5)
    )
    return CornerFits(predicted + parameters[:, :2], error, parameters[:, 3], parameters[:, 4], good)


def _cut(
    flat: NDArray[np.float32],
    centres: Array,
    radius: float,
    predicted: Array,
    shape: Array,
    board: Board,
) -> _Patches:
    reach = _WINDOW * np.abs(shape).sum(2).max()
    half = int(np.ceil(min(reach, 2 * radius)))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    grid = np.column_stack([x.ravel(), y.ravel()])
    base = np.rint(predicted).astype(int)
    place = base[:, None] + grid
    height, width = flat.shape
    inside = ((place >= 0) & (place < [width, height])).all(2)
    value = flat[np.clip(place[..., 1], 0, height - 1), np.clip(place[..., 0], 0, width - 1)].astype(np.float64)
    offset = place - predicted[:, None]
    inverse = np.linalg.inv(shape)
    where = np.abs(np.einsum("nij,npj->npi", inverse, offset))
    # The edge of a microimage is soft over a pixel.
    lit = ((place - centres[:, None]) ** 2).sum(2) < (radius - 1) ** 2
    weight = inside & lit & (where.max(2) < _WINDOW)
    if board.pattern == "charuco":
        # Markers fill the white squares up to a margin.
        weight &= where.min(2) < 0.8 * (1 - float(board.marker or 0) / board.square) / 2
    return _Patches(value, weight.astype(np.float64), offset, inverse)


def _model(patch: _Patches, parameters: Array, transfer: Array, board: Board) -> tuple[Array, Array, Array]:
    """Residuals (n, w), derivatives (n, w, 5), and derivatives by the transfer (n, w, 2).

    Grey values are `mean + contrast y + |contrast| (1 - y^2) (t_0 + t_1 y)` of the blurred pattern `y` with light
    positive: straight from black to white where the transfer is 0.
    """
    shift, mean, contrast, blur = parameters[:, :2], parameters[:, 2:3], parameters[:, 3:4], parameters[:, 4:5]
    x, y = (patch.offset[..., k] - shift[:, k : k + 1] for k in (0, 1))
    across, down = ([patch.inverse[:, k, 0:1], patch.inverse[:, k, 1:2]] for k in (0, 1))
    u, v = (row[0] * x + row[1] * y for row in (across, down))
    if board.pattern == "circles":
        size = np.sqrt(u * u + v * v) + 1e-9
        out = [(u * across[k] + v * down[k]) / size for k in (0, 1)]  # gradient of the distance
        steep = np.sqrt(out[0] ** 2 + out[1] ** 2) + 1e-9
        distances = [(size - float(board.marker or 0) / board.square / 2) / steep]
        directions = [[out[0] / steep, out[1] / steep]]
    else:
        lengths = [np.sqrt(row[0] ** 2 + row[1] ** 2) for row in (across, down)]
        distances = [u / lengths[0], v / lengths[1]]
        directions = [[row[k] / lengths[n] for k in (0, 1)] for n, row in enumerate((across, down))]
    edges = [erf(d / (np.sqrt(2) * blur)) for d in distances]
    slopes = [np.exp(-0.5 * (d / blur) ** 2) * (np.sqrt(2 / np.pi) / blur) for d in distances]
    if len(edges) == 2:
        shape = edges[0] * edges[1]
        slopes = [edges[1] * slopes[0], edges[0] * slopes[1]]
    else:
        shape = edges[0]
    light = np.sign(contrast)
    level = light * shape
    rest = 1 - level * level
    gain = contrast * (1 - 2 * level * (transfer[0] + transfer[1] * level) + transfer[1] * rest)
    coded = shape + light * rest * (transfer[0] + transfer[1] * level)
    design = np.empty((*shape.shape, _UNKNOWNS))
    for k in (0, 1):
        design[..., k] = -gain * sum(s * way[k] for s, way in zip(slopes, directions, strict=True))
    design[..., 2] = 1
    design[..., 3] = coded
    design[..., 4] = -gain / blur * sum(s * d for s, d in zip(slopes, distances, strict=True))
    height = np.abs(contrast) * rest
    bends = np.stack([height, height * level], axis=2)
    return patch.value - mean - contrast * coded, design, bends


def _stepped(parameters: Array, normal: Array, gradient: Array, iteration: int) -> Array:
    """One damped step; the first ones move grey values alone, which the others need."""
    free = np.ones(_UNKNOWNS)
    if iteration == 0:
        free[[0, 1, 4]] = 0
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
