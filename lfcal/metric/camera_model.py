"""Where a microimage shows a point in space, and the derivatives of that: main lens, tilted array, sensor.

A thin main lens images a point at depth `Z` and slope `g = (x, y) / Z` to the distance `v` and slope `t` behind it,

    1/v = (1 + curvature |t|^2) / F - 1 / (Z + pupil),      g = distort(t)   (radial and tangential, image to object)

in a frame that is turned by 180 degrees about the axis, so that pictures are upright. `distort` is linearised about the
chief ray of the microlens: over one microimage it is that straight to 0.05 px. A microlens with centre `m` on the
array projects the image point onto the sensor behind it: a pinhole. Without tilt that is the formula of
docs/geometry.md, `p = c - (X - c) s / D` with `D / s = slope_at_infinity + slope_per_depth / Z`. Model of the array
after Nousias, Chadebecq, Pichat, Keane, Ourselin, Bergeles 2017 (corners in microimages) and Labussiere, Teuliere,
Bernardin, Ait-Aider 2022 (tilted array).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.optics import object_slopes, turn_to_array

__all__ = ["INTERNAL", "Projection", "distort", "from_internal", "project", "to_internal"]

Array = NDArray[Any]

# Order of the parameters that are fitted. The first three take the place of F, L and b, which a fit hardly tells
# apart: f = (L + b) / pixel, and D / s = at_infinity + per_depth / Z.
INTERNAL = (
    "focal_px",
    "at_infinity",
    "per_depth",
    "principal_x",
    "principal_y",
    "k1",
    "k2",
    "k3",
    "p1",
    "p2",
    "tilt_x",
    "tilt_y",
    "curvature",
    "pupil",
)
_K1, _TILT, _CURVATURE, _PUPIL = 5, 10, 12, 13


@dataclass(frozen=True)
class Projection:
    """Positions in microimages with their derivatives.

    Parameters
    ----------
    position : (n, 2) float64 [px]
    by_camera : (n, 2, 14) float64
        Derivatives by the parameters `INTERNAL`.
    by_point : (n, 2, 3) float64 [px/mm]
        Derivatives by the point in the frame of the camera.
    """

    position: Array
    by_camera: Array
    by_point: Array


def to_internal(lengths: Array, pixel: float) -> tuple[Array, Array]:
    """`focal_px, at_infinity, per_depth` of `F, L, b` [mm], and their (3, 3) derivatives."""
    focal, mla, sensor = lengths
    ratio = (mla + sensor) / sensor
    values = np.array([(mla + sensor) / pixel, ratio * (mla / focal - 1), -ratio * mla])
    by_mla, by_sensor = 1 / sensor, -mla / sensor**2  # of the ratio
    rows = [
        [0.0, 1 / pixel, 1 / pixel],
        [-ratio * mla / focal**2, by_mla * (mla / focal - 1) + ratio / focal, by_sensor * (mla / focal - 1)],
        [0.0, -by_mla * mla - ratio, -by_sensor * mla],
    ]
    return values, np.array(rows)


def from_internal(values: Array, pixel: float) -> Array:
    """`F, L, b` [mm] of `focal_px, at_infinity, per_depth`."""
    whole = values[0] * pixel
    sensor = whole / (1 - values[2] / whole)
    mla = whole - sensor
    return np.array([mla / (1 + values[1] * sensor / whole), mla, sensor])


def distort(image: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """Object slopes (n, 2) of image slopes (n, 2), derivatives (n, 2, 2) by those, (n, 2, 5) by k1, k2, k3, p1, p2."""
    k1, k2, k3, p1, p2 = coefficients
    x, y = image.T
    square = x * x + y * y
    gain = 1 + square * (k1 + square * (k2 + square * k3))
    by_square = k1 + square * (2 * k2 + 3 * square * k3)
    cross = 2 * x * y * by_square + 2 * p1 * x + 2 * p2 * y
    slopes = np.stack(
        [
            gain + 2 * x * x * by_square + 2 * p1 * y + 6 * p2 * x,
            cross,
            cross,
            gain + 2 * y * y * by_square + 6 * p1 * y + 2 * p2 * x,
        ],
        axis=1,
    ).reshape(-1, 2, 2)
    powers = np.stack([square, square**2, square**3], axis=1)
    by_coefficients = np.concatenate(
        [
            image[:, :, None] * powers[:, None, :],
            np.stack([2 * x * y, square + 2 * y * y], axis=1)[:, :, None],
            np.stack([square + 2 * x * x, 2 * x * y], axis=1)[:, :, None],
        ],
        axis=2,
    )
    return object_slopes(image, coefficients), slopes, by_coefficients


def _second_derivatives(image: Array, step: Array, coefficients: Array) -> Array:
    """(n, 2, 5): derivatives by the coefficients of `slopes @ step`, the linear part of `distort`."""
    x, y = image.T
    u, v = step.T
    square, inner = x * x + y * y, x * u + y * v
    rows = []
    for axis, (a, da) in enumerate(((x, u), (y, v))):
        powers = [da * square**k + 2 * k * a * square ** (k - 1) * inner for k in (1, 2, 3)]
        mixed = 2 * (x * v + y * u)
        straight = 2 * inner + 4 * a * da
        rows.append(np.stack([*powers, straight, mixed] if axis else [*powers, mixed, straight], axis=1))
    return np.stack(rows, axis=1)


def _turn(tilt: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) from the frame of the main lens to that of the array, and its (2, 3, 3) derivatives."""
    (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in tilt)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    d_x = np.array([[0, 0, 0], [0, -sx, cx], [0, -cx, -sx]])
    d_y = np.array([[-sy, 0, -cy], [0, 0, 0], [cy, 0, -sy]])
    return turn_to_array(tilt), np.stack([about_y @ d_x, d_y @ about_x])


def _turn_of_slopes(image: Array, step: Array, coefficients: Array) -> Array:
    """(n, 2, 2) how the derivatives of `distort` change along `step` (n, 2)."""
    k1, k2, k3, p1, p2 = coefficients
    (x, y), (u, v) = image.T, step.T
    square, inner = x * x + y * y, 2 * (x * u + y * v)
    first, second = k1 + square * (2 * k2 + 3 * square * k3), 2 * k2 + 6 * square * k3
    along = first * inner
    cross = 2 * second * inner * x * y + 2 * first * (x * v + y * u) + 2 * (p1 * u + p2 * v)
    across_x = along + 2 * second * inner * x * x + 4 * first * x * u + 2 * p1 * v + 6 * p2 * u
    across_y = along + 2 * second * inner * y * y + 4 * first * y * v + 6 * p1 * v + 2 * p2 * u
    return np.stack([across_x, cross, cross, across_y], axis=1).reshape(-1, 2, 2)


def image_slopes(points: Array, start: Array, coefficients: Array) -> tuple[Array, Array, Array, Array]:
    """Image slopes (n, 2) of points (n, 3), by `distort` linearised at `start` (n, 2); and their derivatives.

    By the object slopes (n, 2, 2), by the coefficients (n, 2, 5), and by `start` (n, 2, 2).
    """
    seen = points[:, :2] / points[:, 2:]
    base, slopes, by_coefficients = distort(start, coefficients)
    inverse = np.linalg.inv(slopes)
    step = np.einsum("nij,nj->ni", inverse, seen - base)
    change = by_coefficients + _second_derivatives(start, step, coefficients)
    by_start = -inverse @ _turn_of_slopes(start, step, coefficients)
    return start + step, inverse, -inverse @ change, by_start


def project(camera: Array, pixel: float, points: Array, centres: Array) -> Projection:
    """Where the microimages with centres (n, 2) [px] show points (n, 3) [mm], one point each.

    `camera` (14,) are the parameters `INTERNAL`.
    """
    n = len(points)
    lengths = from_internal(camera[:3], pixel)
    focal = lengths[0]
    principal = camera[3:5]
    start = (centres - principal) / camera[0]
    slope, by_seen, by_coefficients, by_start = image_slopes(points, start, camera[_K1:_TILT])
    # The image point behind the main lens.
    depth = points[:, 2] + camera[_PUPIL]
    square = (slope**2).sum(1)
    v = 1 / ((1 + camera[_CURVATURE] * square) / focal - 1 / depth)
    image = np.column_stack([slope * v[:, None], v])

    d_slope = np.zeros((n, 2, 17))  # by F, L, b, the other parameters, and the point
    d_slope[:, :, _K1:_TILT] = by_coefficients
    # The chief ray moves with the principal point, and with f = (L + b) / pixel.
    d_slope[:, :, 3:5] = -by_start / camera[0]
    d_slope[:, :, 1] = d_slope[:, :, 2] = np.einsum("nij,nj->ni", by_start, start) / (-camera[0] * pixel)
    d_seen = np.zeros((n, 2, 3))
    d_seen[:, 0, 0] = d_seen[:, 1, 1] = 1 / points[:, 2]
    d_seen[:, :, 2] = -points[:, :2] / points[:, 2:] ** 2
    d_slope[:, :, 14:] = by_seen @ d_seen
    d_power = camera[_CURVATURE] * 2 / focal * np.einsum("ni,nik->nk", slope, d_slope)
    d_power[:, 0] -= (1 + camera[_CURVATURE] * square) / focal**2
    d_power[:, _CURVATURE] += square / focal
    d_power[:, [_PUPIL, 16]] += 1 / depth[:, None] ** 2
    d_v = -(v**2)[:, None] * d_power
    d_image = np.concatenate([d_slope * v[:, None, None] + slope[:, :, None] * d_v[:, None], d_v[:, None]], axis=1)

    position, derivative = _through_array(camera, pixel, lengths, image, d_image, centres)
    by_lengths = np.linalg.inv(to_internal(lengths, pixel)[1])
    derivative[:, :, :3] = derivative[:, :, :3] @ by_lengths
    return Projection(position, derivative[:, :, :14], derivative[:, :, 14:])


def _through_array(
    camera: Array, pixel: float, lengths: Array, image: Array, d_image: Array, centres: Array
) -> tuple[Array, Array]:
    """Positions (n, 2) on the flat of image points (n, 3), and their derivatives by `F, L, b, ...` (n, 2, 17).

    `p = c + b / pixel * (m (1/a - 1/l) - S / a - tau)`: in the frame of the array the image point lies at `S`, `a` in
    front of it, the main lens `l` in front of it, and the optical axis has the slope `tau`.
    """
    _, mla, sensor = lengths
    turn, d_turn = _turn(camera[_TILT:_CURVATURE])
    axis, d_axis = turn[:, 2], d_turn[:, :, 2]
    tau = axis[:2] / axis[2]
    far = mla * axis[2]
    offset = image - [0, 0, mla]
    local = offset @ turn.T
    near = -local[:, 2]
    spread = 1 + sensor / far
    lens = (centres - camera[3:5]) * (pixel / spread)
    across = lens * (1 / near - 1 / far)[:, None] - local[:, :2] / near[:, None] - tau
    position = centres + across * (sensor / pixel)

    d_local = np.einsum("ij,njk->nik", turn, d_image)
    d_local[:, :, 1] -= axis
    d_local[:, :, _TILT:_CURVATURE] += np.einsum("kij,nj->nik", d_turn, offset)
    d_far, d_tau = np.zeros(17), np.zeros((2, 17))
    d_far[1] = axis[2]
    d_far[_TILT:_CURVATURE] = mla * d_axis[:, 2]
    d_tau[:, _TILT:_CURVATURE] = ((d_axis[:, :2] - tau * d_axis[:, 2:]) / axis[2]).T
    d_spread = -sensor / far**2 * d_far
    d_spread[2] += 1 / far
    d_lens = -lens[:, :, None] * d_spread / spread
    d_lens[:, 0, 3] -= pixel / spread
    d_lens[:, 1, 4] -= pixel / spread
    d_near = -d_local[:, 2]
    derivative = d_lens * (1 / near - 1 / far)[:, None, None] + lens[:, :, None] * (d_far / far**2)
    derivative -= (lens - local[:, :2])[:, :, None] * (d_near / near[:, None] ** 2)[:, None]
    derivative -= d_local[:, :2] / near[:, None, None] + d_tau
    derivative *= sensor / pixel
    derivative[:, :, 2] += across / pixel
    return position, derivative
