"""Projection of a point in space into a microimage, and the shape of boards.

A thin main lens images a point at depth `Z` and slope `g = (x, y) / Z` to the distance `v` and
slope `t` behind it,

    1/v = (1 + curvature |t|^2) / F - 1 / (Z + pupil),      g = distort(t),

in a frame that is turned by 180 degrees about the axis, so that pictures are upright. `distort` is
radial and tangential, and leads from the image to the object. It is linearised about the chief ray
of the microlens, which is right to 0.05 px over a microimage. A microlens is a pinhole: it projects
the image point onto the sensor behind it. Without tilt this is the formula of docs/geometry.md,
`p = c - (X - c) s / D` with `D / s = at_infinity + per_depth / Z`. The model of the array follows
Nousias, Chadebecq, Pichat, Keane, Ourselin, Bergeles 2017 (corners in microimages) and Labussiere,
Teuliere, Bernardin, Ait-Aider 2022 (tilted array).

A board may be bent to a quadratic surface, and stretched along one axis or diagonal at constant
area. A bend of 1/200 of the width changes the focal length by several per cent (deformable
calibration targets: Strobl and Hirzinger 2011).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..camera.optics import OPTICS_PARAMETERS, object_slopes, turn_to_array
from ..runtime.arrays import Array

__all__ = [
    "INTERNAL",
    "SHAPE",
    "from_internal",
    "project",
    "project_derivatives",
    "shape_derivatives",
    "to_internal",
]


#: Order of the parameters that are fitted. The first three replace F, L and b, which a fit can
#: hardly separate: focal_px = (L + b) / pixel, and D / s = at_infinity + per_depth / Z.
INTERNAL = ("focal_px", "at_infinity", "per_depth", *OPTICS_PARAMETERS[3:])
#: Displacements [mm] of the points of a board at `x, y` of -1..1, from its middle to the ends of
#: its longer side: away from the camera by `x^2, x y, y^2`; in its plane by `(x, -y)` and `(y, x)`.
SHAPE = ("bend_xx", "bend_xy", "bend_yy", "stretch", "shear")


def to_internal(lengths: Array, pixel: float) -> tuple[Array, Array]:
    """`focal_px, at_infinity, per_depth` of `F, L, b` [mm], and their (3, 3) derivatives."""

    def values(lengths: Array) -> Array:
        focal, mla, sensor = lengths
        ratio = (mla + sensor) / sensor
        return np.array([(mla + sensor) / pixel, ratio * (mla / focal - 1), -ratio * mla])

    return values(lengths), _derivatives(values, lengths)


def _derivatives(function: Callable[[Array], Array], at: Array) -> Array:
    """(..., k) derivatives of a function by each of its arguments `at` (..., k).

    They are exact to rounding: the function is evaluated with a tiny imaginary step (complex-step
    derivatives, Squire and Trapp 1998).
    """
    step = 1e-20
    values = [function(at + 1j * step * unit).imag / step for unit in np.eye(at.shape[-1])]
    return np.stack(values, axis=-1)


def from_internal(values: Array, pixel: float) -> Array:
    """`F, L, b` [mm] of `focal_px, at_infinity, per_depth`."""
    whole = values[0] * pixel
    sensor = whole / (1 - values[2] / whole)
    mla = whole - sensor
    return np.array([mla / (1 + values[1] * sensor / whole), mla, sensor])


def project(camera: Array, pixel: float, points: Array, centres: Array) -> Array:
    """(n, 2) [px] positions at which microimages with centres (n, 2) [px] show points (n, 3) [mm].

    `camera` (14,) are the parameters `INTERNAL`. The function is analytic, so that arguments may be
    complex.
    """
    focal, mla, sensor = from_internal(camera[:3], pixel)
    principal = camera[3:5]
    coefficients = camera[5:10]
    tilt = camera[10:12]
    curvature = camera[12]
    pupil = camera[13]
    chief = (centres - principal) / camera[0]
    slope = _image_slopes(points[:, :2] / points[:, 2:], chief, coefficients)
    # Distance of the image point behind the main lens, then its place in the frame of the array,
    # `near` [mm] in front of it.
    behind = 1 / ((1 + curvature * (slope**2).sum(1)) / focal - 1 / (points[:, 2] + pupil))
    turn = turn_to_array(tilt)
    local = np.column_stack([slope * behind[:, None], behind - mla]) @ turn.T
    near = -local[:, 2:]
    far = mla * turn[2, 2]
    lens = (centres - principal) * (pixel / (1 + sensor / far))
    across = lens * (1 / near - 1 / far) - local[:, :2] / near - turn[:2, 2] / turn[2, 2]
    return np.asarray(centres + across * (sensor / pixel))


def project_derivatives(
    camera: Array, pixel: float, points: Array, centres: Array
) -> tuple[Array, Array]:
    """Derivatives of `project` by the camera (n, 2, 14) and by the point (n, 2, 3) [px/mm]."""
    return (
        _derivatives(lambda camera: project(camera, pixel, points, centres), camera),
        _derivatives(lambda points: project(camera, pixel, points, centres), points),
    )


def shape_derivatives(board: Array) -> Array:
    """(k, 3, 5) displacements of the points (k, 3) [mm] of a board by `SHAPE`."""
    x, y = board[:, :2].T / max(float(np.abs(board[:, :2]).max()), 1e-12)
    zero = np.zeros_like(x)
    across = [zero, zero, zero, x, y]
    down = [zero, zero, zero, -y, x]
    away = [x * x, x * y, y * y, zero, zero]
    return np.moveaxis(np.array([across, down, away]), 2, 0)


def _image_slopes(seen: Array, start: Array, coefficients: Array) -> Array:
    """Image slopes (n, 2) of object slopes (n, 2).

    The distortion is linearised at the image slopes `start` (n, 2).
    """
    k1, k2, k3, p1, p2 = coefficients
    x, y = start.T
    square = x * x + y * y
    gain = 1 + square * (k1 + square * (k2 + square * k3))
    by_square = k1 + square * (2 * k2 + 3 * square * k3)
    xx = gain + 2 * x * x * by_square + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * by_square + 2 * p1 * x + 2 * p2 * y
    yy = gain + 2 * y * y * by_square + 6 * p1 * y + 2 * p2 * x
    u, v = (seen - object_slopes(start, coefficients)).T
    step = np.column_stack([yy * u - xy * v, xx * v - xy * u]) / (xx * yy - xy * xy)[:, None]
    return np.asarray(start + step)
