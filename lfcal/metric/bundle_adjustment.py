"""Robust bundle adjustment of the camera, the poses of the boards and their shape, with the covariance of both.

Levenberg-Marquardt on the normal equations, built pose by pose. With a dozen poses they are a dense matrix of a hundred
unknowns, solved exactly: iterative sparse solvers (`scipy.optimize.least_squares` with LSMR) stop short along the weak
directions that focal length and distances have. Weights are Tukey's biweight of the residual over the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .board_shape import SHAPE, deform, shape_derivatives
from .camera_model import INTERNAL, project
from .observations import Observations
from .settings import ADJUSTMENT, AdjustmentSettings

__all__ = ["Adjusted", "Normals", "Poses", "adjust", "normal_equations", "residuals", "unknowns"]

Array = NDArray[Any]


@dataclass(frozen=True)
class Poses:
    """Rotations (m, 3, 3) and translations (m, 3) [mm] from the board, about its middle, to the camera."""

    rotation: Array
    translation: Array

    def of_board(self, points: Array, pose: NDArray[np.int64]) -> Array:
        """(n, 3) points of the board, in poses (n,), in the frame of the camera."""
        return np.einsum("nij,nj->ni", self.rotation[pose], points) + self.translation[pose]

    def moved(self, steps: Array) -> Poses:
        """Turned by small vectors [rad] and shifted by [mm], (m, 6)."""
        turned = [cv2.Rodrigues(step[:3])[0] @ rotation for step, rotation in zip(steps, self.rotation, strict=True)]
        return Poses(np.array(turned), self.translation + steps[:, 3:])


@dataclass(frozen=True)
class Normals:
    """Normal equations and the residuals (n, 2) [px].

    The unknowns are 14 parameters of the camera, 6 of each pose, and 5 of the shape of the board.
    """

    matrix: Array
    gradient: Array
    residual: Array


@dataclass(frozen=True)
class Adjusted:
    """A fitted camera with poses.

    Parameters
    ----------
    camera : (14,) float64
        The parameters `INTERNAL`.
    free : tuple of str
        Those that were fitted.
    poses : Poses
    shape : (5,) float64 [mm]
        Of the board, `SHAPE`; 0 where it is taken to be flat.
    board : (k, 3) float64 [mm]
        Points of the board with that shape.
    residual : (n, 2) float64 [px]
        Observed minus predicted.
    weight : (n,) float64
        0..1, 0 of outliers.
    noise : float
        Standard deviation of residuals over stated errors.
    cluster : float
        Factor, at least 1, by which errors that the microimages of a corner share widen the covariance.
    covariance : (14 + 6 m + 5, 14 + 6 m + 5) float64
        Of camera, poses and shape, `noise` and `cluster` included; 0 of what was not fitted.
    """

    camera: Array
    free: tuple[str, ...]
    poses: Poses
    shape: Array
    board: Array
    residual: Array
    weight: Array
    noise: float
    cluster: float
    covariance: Array

    @property
    def rms(self) -> float:
        """Of the distances between observed and predicted positions [px], outliers included."""
        return float(np.sqrt((self.residual**2).sum(1).mean()))


def residuals(camera: Array, pixel: float, poses: Poses, board: Array, observations: Observations) -> Array:
    """(n, 2) [px] observed minus predicted positions."""
    points = poses.of_board(board[observations.corner], observations.pose)
    return observations.position - project(camera, pixel, points, observations.centre).position


def normal_equations(
    camera: Array, pixel: float, poses: Poses, board: Array, observations: Observations, weight: Array
) -> Normals:
    """Of the observations weighted by `weight` (n,) over their squared errors."""
    o = observations
    turned = np.einsum("nij,nj->ni", poses.rotation[o.pose], board[o.corner])
    seen = project(camera, pixel, turned + poses.translation[o.pose], o.centre)
    residual = o.position - seen.position
    x, y, z = turned.T
    zero = np.zeros_like(x)
    by_turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    by_pose = np.concatenate([seen.by_point @ by_turn, seen.by_point], axis=2)
    scale = (np.sqrt(weight) / o.error)[:, None]
    by_shape = seen.by_point @ (poses.rotation[o.pose] @ shape_derivatives(board)[o.corner])
    rows = np.concatenate([seen.by_camera, by_pose, by_shape], axis=2) * scale[:, :, None]
    scaled = residual * scale
    own = len(INTERNAL)
    size = own + 6 * len(poses.rotation) + len(SHAPE)
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    ends = np.searchsorted(o.pose, np.arange(len(poses.rotation) + 1))
    for m, (first, last) in enumerate(pairwise(ends)):
        block = rows[first:last].reshape(-1, rows.shape[2])
        index = np.r_[:own, own + 6 * m : own + 6 * m + 6, size - len(SHAPE) : size]
        matrix[np.ix_(index, index)] += block.T @ block
        gradient[index] += block.T @ scaled[first:last].ravel()
    return Normals(matrix, gradient, residual)


def adjust(
    camera: Array,
    pixel: float,
    poses: Poses,
    board: Array,
    observations: Observations,
    free: Sequence[str],
    *,
    shape: Array | None = None,
    settings: AdjustmentSettings = ADJUSTMENT,
) -> Adjusted:
    """Fit the parameters `free` of `INTERNAL` and `SHAPE`, and all poses.

    Parameters
    ----------
    camera : (14,) float64
        Start, with the values of what is not free.
    pixel : float [mm]
    poses : Poses
        Start.
    board : (k, 3) float64 [mm]
        Points of the flat board, about its middle.
    observations : Observations
    free : names of `INTERNAL` and `SHAPE`
        Empty to fit poses alone.
    shape : (5,) float64 [mm], optional
        Start; by default the board is flat.
    """
    problem = _Problem(pixel, board, observations)
    chosen = unknowns(free, len(poses.rotation))
    shape = np.zeros(len(SHAPE)) if shape is None else shape
    found = residuals(camera, pixel, poses, deform(board, shape), observations)
    weight, noise = _weights(found, observations, settings)
    for _ in range(settings.scale_passes):
        camera, poses, shape = _minimise(problem, camera, poses, shape, chosen, weight, settings)
        found = residuals(camera, pixel, poses, deform(board, shape), observations)
        weight, noise = _weights(found, observations, settings)
    # Least squares without the outliers: its errors are those of the normal matrix.
    weight = (np.hypot(*found.T) / observations.error < settings.rejection * noise).astype(np.float64)
    camera, poses, shape = _minimise(problem, camera, poses, shape, chosen, weight, settings)
    board = deform(board, shape)
    normals = normal_equations(camera, pixel, poses, board, observations, weight)
    noise = _noise(normals.residual, weight, observations, len(chosen))
    cluster = _cluster_factor(normals.residual, weight, noise, observations)
    covariance = np.zeros_like(normals.matrix)
    covariance[np.ix_(chosen, chosen)] = _inverse(normals.matrix[np.ix_(chosen, chosen)]) * noise**2 * cluster
    return Adjusted(camera, tuple(free), poses, shape, board, normals.residual, weight, noise, cluster, covariance)


def unknowns(free: Sequence[str], poses: int) -> NDArray[np.int64]:
    """Places of the parameters `free`, and of those of all poses, among the unknowns of the normal equations."""
    own, last = len(INTERNAL), len(INTERNAL) + 6 * poses
    places = {name: k for k, name in enumerate(INTERNAL)} | {name: last + k for k, name in enumerate(SHAPE)}
    return np.sort(np.r_[[places[name] for name in free], own:last].astype(np.int64))


@dataclass(frozen=True)
class _Problem:
    pixel: float
    board: Array
    observations: Observations

    def cost(self, camera: Array, poses: Poses, shape: Array, weight: Array) -> float:
        found = residuals(camera, self.pixel, poses, deform(self.board, shape), self.observations)
        if not np.isfinite(found).all():
            return np.inf
        return float((weight / self.observations.error**2 * (found**2).sum(1)).sum())


def _minimise(
    problem: _Problem,
    camera: Array,
    poses: Poses,
    shape: Array,
    chosen: NDArray[np.int64],
    weight: Array,
    settings: AdjustmentSettings,
) -> tuple[Array, Poses, Array]:
    """Levenberg-Marquardt with fixed weights."""
    cost, damping = problem.cost(camera, poses, shape, weight), settings.first_damping
    own = len(INTERNAL)
    for _ in range(settings.iterations):
        board = deform(problem.board, shape)
        normals = normal_equations(camera, problem.pixel, poses, board, problem.observations, weight)
        matrix, gradient = normals.matrix[np.ix_(chosen, chosen)], normals.gradient[chosen]
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        unit = matrix * np.outer(scale, scale)
        while True:
            step = np.zeros(len(normals.gradient))
            step[chosen] = scale * np.linalg.solve(unit + damping * np.eye(len(unit)), scale * gradient)
            turns, bend = step[own : -len(SHAPE)], step[-len(SHAPE) :]
            tried = camera + step[:own], poses.moved(turns.reshape(-1, 6)), shape + bend
            new = problem.cost(*tried, weight)
            if new < cost or damping > 1e8:
                break
            damping *= 10
        if not new < cost:
            break
        camera, poses, shape = tried
        done = cost - new <= settings.tolerance * cost
        cost, damping = new, damping / 10
        if done:
            break
    return camera, poses, shape


def _weights(residual: Array, observations: Observations, settings: AdjustmentSettings) -> tuple[Array, float]:
    """Tukey's biweight of each observation, and the robust noise, in units of the stated errors."""
    distance = np.hypot(*residual.T) / observations.error
    # The median distance of a two-dimensional normal distribution is 1.177 standard deviations.
    noise = max(float(np.median(distance)) / 1.1774, 1e-12)
    unit = np.minimum(distance / (settings.cutoff * noise), 1)
    return (1 - unit**2) ** 2, noise


def _noise(residual: Array, weight: Array, observations: Observations, unknowns: int) -> float:
    """Standard deviation of residuals over stated errors, degrees of freedom taken off."""
    square = (residual**2).sum(1) / observations.error**2
    freedom = max(2 * weight.sum() - unknowns, 1.0)
    return float(np.sqrt((weight * square).sum() / freedom))


def _cluster_factor(residual: Array, weight: Array, noise: float, observations: Observations) -> float:
    """How much more the mean residuals of the corners scatter than those of independent observations would."""
    o = observations
    _, group = np.unique(o.pose * (o.corner.max(initial=0) + 1) + o.corner, return_inverse=True)
    own = weight / o.error**2
    total = np.bincount(group, own)
    kept = total > 0
    means = np.stack([np.bincount(group, own * residual[:, k])[kept] for k in (0, 1)], axis=1)
    # Poses take up six of the means of a board.
    freedom = max(2 * kept.sum() - 6 * len(np.unique(o.pose)), 1)
    return max(1.0, float((means**2 / total[kept, None]).sum() / freedom / noise**2))


def _inverse(matrix: Array) -> Array:
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(scale, scale)
