"""Rotation of an array against the sensor, and the gradient of its pitch.

With the sensor tilted against the array by `g` (tangents to the right and down), the array seen
from a pupil at the distance `L`, a microimage at `x` from the axis is displaced by `x (g x) / L`.
Radial distortion about a place beside the middle of the flat displaces microimages by another
quadratic form, which is fitted too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import describe_orientation

__all__ = ["Alignment", "measure_alignment"]

Array = NDArray[np.float64]
# [px] systematic error of the centres of a white image over half the diagonal.
_WHITE_FAULT = 0.01
# [pitch] the same error of a scene, whose contents shift the measured centres.
_SCENE_FAULT = 0.02
# Tiles each way, whose means are fitted.
_TILES = 8
# Quadratic displacements x^2, xy, y^2 in x, then in y, of a tilt to the right and down, and of a
# radial distortion about a place to the right and below.
_TILT = np.array(
    [[1, 0, 0, 0, 1, 0], [0, 1, 0, 0, 0, 1], [3, 0, 1, 0, 2, 0], [0, 2, 0, 1, 0, 3]], float
).T


class Alignment(NamedTuple):
    """Rotation of the rows of lenses, clockwise on the screen, and gradient of the pitch."""

    shape: str
    rows: str
    rotation: float  # [degrees]
    rotation_error: float
    # (2,) [px] displacement by a tilt to the right and down, half a diagonal from the middle
    gradient: Array
    gradient_error: float  # inf where not measured


def measure_alignment(camera: Calibration) -> Alignment:
    """Rotation and pitch gradient of a calibrated camera."""
    lattice = camera.lattice
    errors = camera.errors
    white = camera.source == "white"
    shape, rows, _ = describe_orientation(lattice)
    variance = (
        np.full(2, np.inf)
        if errors is None
        else np.diag(errors.covariance)[2:6].reshape(2, 2).mean(1)
    )
    centres = lattice.basis, variance, np.full(2, np.nan), float("inf")
    if white and camera.residuals is not None and len(camera.residuals.indices) >= 60:
        centres = _fit_centres(camera) or centres
    basis, variance, gradient, gradient_error = centres
    vectors = basis @ [1, 1j]
    hexagonal = len(lattice.steps) == 6
    # Where the first vector would be, by each of both.
    own = vectors[1] * np.exp(-1j * np.pi / (3 if hexagonal else 2))
    both = np.array([vectors[0], own] if shape != "oblique" else [vectors[0]])
    period = 90.0
    if hexagonal:
        period = 60.0
    angle = (
        float(np.degrees(np.angle((both / np.abs(both)).sum()))) + period / 2
    ) % period - period / 2
    if rows == "vertical":
        angle -= float(np.copysign(period / 2, angle))
    fault = (_WHITE_FAULT if white else _SCENE_FAULT * lattice.pitch) / (
        float(np.hypot(*lattice.image_size)) / 2
    )
    scatter = float((variance[: len(both)] / np.abs(both) ** 2).sum()) / len(both) ** 2
    return Alignment(
        shape, rows, angle, float(np.degrees(np.sqrt(scatter + fault**2))), gradient, gradient_error
    )


def _fit_centres(camera: Calibration) -> tuple[Array, Array, Array, float] | None:
    """Fit the basis in the middle of the flat and the gradient of the pitch.

    Returns the basis, the variances (2,) of its vectors, the gradient (2,) [px] and its error.

    Means over tiles of the flat are fitted, so that errors which neighbours share count as such;
    None of too few.
    """
    assert camera.residuals is not None
    lattice = camera.lattice
    indices = camera.residuals.indices
    offset = camera.residuals.offset.astype(np.float64)
    length = np.hypot(*offset.T)
    keep = length <= 4 * np.median(length) + 1e-9
    indices, centres = indices[keep], lattice.points(indices[keep]) + offset[keep]
    x, y = lattice.field_place(centres).T
    table = np.column_stack(
        [np.ones(len(x)), indices, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3, centres]
    )
    column, row = np.clip((centres / lattice.image_size * _TILES).astype(int), 0, _TILES - 1).T
    _, tile, count = np.unique(_TILES * row + column, return_inverse=True, return_counts=True)
    means = np.array([np.bincount(tile, values) / count for values in table.T]).T
    # A few tiles do not determine the third order.
    terms = table.shape[1] - 2
    design = means[:, : terms if len(count) >= 2 * terms else 6]
    target = means[:, terms:]
    free = len(count) - design.shape[1]
    if free < 4:
        return None
    scale = np.abs(design).max(0)
    root = np.sqrt(count)[:, None]
    inverse = np.linalg.pinv(root * design / scale) / scale[:, None]
    factors = inverse @ (root * target)
    covariance = (
        inverse
        @ inverse.T
        * float((count[:, None] * (target - design @ factors) ** 2).sum() / (2 * free))
    )
    weight = np.kron(np.eye(2), np.linalg.pinv(covariance[3:6, 3:6]))
    normal = np.linalg.inv(_TILT.T @ weight @ _TILT)
    quadratic = factors[3:6].T.ravel()
    found = normal @ _TILT.T @ weight @ quadratic
    miss = quadratic - _TILT @ found
    # What neither form explains, two numbers, is an error of both.
    excess = max(1.0, float(miss @ weight @ miss) / 2)
    error = float(np.hypot(np.sqrt(np.diag(normal)[:2].mean() * excess), _WHITE_FAULT))
    return factors[1:3], np.diag(covariance)[1:3], found[:2], error
