"""Where a microimage shows a point in space: main lens, tilted array, sensor; and the shape of
boards.

A thin main lens images a point at depth `Z` and slope `g = (x, y) / Z` to the distance `v` and
slope `t` behind it,

    1/v = (1 + curvature |t|^2) / F - 1 / (Z + pupil),      g = distort(t)   (radial and tangential,
    image to object)

in a frame that is turned by 180 degrees about the axis, so that pictures are upright. `distort` is
linearised about the chief ray of the microlens: over one microimage it is that straight to 0.05 px.
A microlens with centre `m` on the array projects the image point onto the sensor behind it: a
pinhole. Without tilt that is the formula of docs/geometry.md, `p = c - (X - c) s / D` with `D / s =
slope_at_infinity + slope_per_depth / Z`. Model of the array after Nousias, Chadebecq, Pichat,
Keane, Ourselin, Bergeles 2017 (corners in microimages) and Labussiere, Teuliere, Bernardin,
Ait-Aider 2022 (tilted array).

Boards may be bent by a quadratic surface, and stretched along one diagonal or axis against the
other, which does not change their size. A bend of a twohundredth of the width looks like a focal
length that is several per cent off (deformable calibration targets: Strobl and Hirzinger 2011).
"""

from __future__ import annotations

import numpy as np

from ..camera.optics import object_slopes, turn_to_array
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


# Order of the parameters that are fitted. The first three take the place of F, L and b, which a fit
# hardly tells apart: f = (L + b) / pixel, and D / s = at_infinity + per_depth / Z.
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
#: Displacements [mm] at the ends of the longer side of a board, of points at `x, y` of -1..1: away
#: from the camera by `x^2, x y, y^2`; in the plane by `(x, -y)` and `(y, x)`.
SHAPE = ("bend_xx", "bend_xy", "bend_yy", "stretch", "shear")


def to_internal(lengths: Array, pixel: float) -> tuple[Array, Array]:
    """`focal_px, at_infinity, per_depth` of `F, L, b` [mm], and their (3, 3) derivatives."""
    focal, mla, sensor = lengths
    ratio = (mla + sensor) / sensor
    values = np.array([(mla + sensor) / pixel, ratio * (mla / focal - 1), -ratio * mla])
    by_mla = 1 / sensor  # of the ratio
    by_sensor = -mla / sensor**2
    rows = [
        [0.0, 1 / pixel, 1 / pixel],
        [
            -ratio * mla / focal**2,
            by_mla * (mla / focal - 1) + ratio / focal,
            by_sensor * (mla / focal - 1),
        ],
        [0.0, -by_mla * mla - ratio, -by_sensor * mla],
    ]
    return values, np.array(rows)


def from_internal(values: Array, pixel: float) -> Array:
    """`F, L, b` [mm] of `focal_px, at_infinity, per_depth`."""
    whole = values[0] * pixel
    sensor = whole / (1 - values[2] / whole)
    mla = whole - sensor
    return np.array([mla / (1 + values[1] * sensor / whole), mla, sensor])


def project(camera: Array, pixel: float, points: Array, centres: Array) -> Array:
    """Where the microimages with centres (n, 2) [px] show points (n, 3) [mm], one each: (n, 2)
    [px].

    `camera` (14,) are the parameters `INTERNAL`. Analytic, so that arguments may be complex.
    """
    focal, mla, sensor = from_internal(camera[:3], pixel)
    principal = camera[3:5]
    coefficients = camera[5:10]
    tilt = camera[10:12]
    curvature = camera[12]
    pupil = camera[13]
    slope = _image_slopes(
        points[:, :2] / points[:, 2:], (centres - principal) / camera[0], coefficients
    )
    # The image point behind the main lens, and in the frame of the array: `near` before it, beside
    # its axis.
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
    """Derivatives of `project` by the camera (n, 2, 14) and by the point (n, 2, 3) [px/mm].

    Exact to rounding: the model is evaluated with a tiny imaginary step (complex-step derivatives,
    Squire and Trapp 1998).
    """
    step = 1e-20j
    by_camera = [project(camera + step * k, pixel, points, centres) for k in np.eye(len(INTERNAL))]
    by_point = [project(camera, pixel, points + step * k, centres) for k in np.eye(3)]
    scale = 1 / step.imag
    return np.stack(by_camera, axis=2).imag * scale, np.stack(by_point, axis=2).imag * scale


def shape_derivatives(board: Array) -> Array:
    """(k, 3, 5) displacements of the points (k, 3) [mm] of a board, about its middle, by `SHAPE`."""
    x, y = board[:, :2].T / max(float(np.abs(board[:, :2]).max()), 1e-12)
    zero = np.zeros_like(x)
    columns = [
        [zero, zero, x * x],
        [zero, zero, x * y],
        [zero, zero, y * y],
        [x, -y, zero],
        [y, x, zero],
    ]
    return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


def _image_slopes(seen: Array, start: Array, coefficients: Array) -> Array:
    """Image slopes (n, 2) of object slopes (n, 2), by the distortion linearised at the image slopes
    `start` (n, 2).
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
