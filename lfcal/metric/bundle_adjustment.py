"""Robust bundle adjustment of a camera and of the poses and the shape of boards, with covariance.

`scipy.optimize.minimize` with a trust region minimises a Cauchy loss, then the squared residuals
without the outliers. The normal equations are a dense matrix of about a hundred unknowns and are
solved exactly: iterative solvers stop early along the weak directions of focal length and
distances, and `least_squares` decomposes a matrix of all observations. Each observation depends on
25 unknowns: 14 of the camera, 6 of its pose, 5 of the shape of the board.

Forward selection with score tests finds the parameters that the data require.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from ..runtime.arrays import Array, Floats, Frozen, Integers
from .camera_model import INTERNAL, SHAPE, project, project_derivatives, shape_derivatives

__all__ = [
    "BASE",
    "POSE",
    "Adjusted",
    "Observations",
    "Poses",
    "adjust",
    "eliminate",
    "gather",
    "inverse",
    "linearise",
    "pose_unknowns",
    "select_order",
    "unknowns",
]

_OWN = len(INTERNAL)
_LAST = len(SHAPE)
#: Places of the six of the pose among the 25 unknowns of an observation: turn [rad], shift [mm].
POSE = np.arange(_OWN, _OWN + 6)
#: Always fitted.
BASE = INTERNAL[:6]
# Groups of parameters that are fitted together, and the parameters that must be fitted before them.
_GROUPS: dict[tuple[str, ...], tuple[str, ...]] = {
    ("k2",): (),
    ("k3",): ("k2",),
    ("p1", "p2"): (),
    ("tilt_x", "tilt_y"): (),
    ("curvature",): (),
    ("pupil",): (),
    SHAPE[:3]: (),
    SHAPE[3:]: (),
}
# Median length of a standard normal vector in the plane.
_MEDIAN_LENGTH = np.sqrt(2 * np.log(2))
# Scale of the Cauchy loss, and residuals that are outliers [standard deviations]: normal errors
# exceed the second once in 25,000 times.
_CAUCHY = 3
_OUTLIER = 4.5
# Relative decrease of the cost at which the fit ends: with the Cauchy loss, and without outliers.
_ROUGH = 1e-4
_EXACT = 1e-9
# The trust region starts so wide that only steps that raise the cost narrow it; unknowns are scaled
# to standard deviations.
_TRUST = {"initial_trust_radius": 1e4, "max_trust_radius": 1e9, "gtol": 1e-6, "maxiter": 60}


@dataclass(frozen=True, eq=False)
class Observations(Frozen):
    """Corners seen in microimages, sorted by pose."""

    pose: Integers  # (n,) number of the flat
    corner: Integers  # (n,) number of the point of the board
    centre: Floats  # (n, 2) [px] centre of the microimage
    position: Floats  # (n, 2) [px] position of the corner on the flat
    error: Floats  # (n,) [px] its standard error along each axis; 1 if only ratios are known

    def __post_init__(self) -> None:
        order = np.argsort(self.pose, kind="stable")
        kinds = {"pose": int, "corner": int, "centre": float, "position": float, "error": float}
        for name, kind in kinds.items():
            self._set(**{name: np.asarray(getattr(self, name), kind)[order]})

    def __len__(self) -> int:
        return len(self.pose)


@dataclass(frozen=True)
class Poses:
    """Rotations (m, 3, 3) and translations (m, 3) [mm] from the board's middle to the camera."""

    rotation: Array
    translation: Array

    def of_board(self, points: Array, pose: Integers) -> Array:
        """(n, 3) points of the board, in poses (n,), in the frame of the camera."""
        return np.einsum("nij,nj->ni", self.rotation[pose], points) + self.translation[pose]

    def moved(self, steps: Array) -> Poses:
        """The poses turned by rotation vectors [rad] and shifted [mm]: steps (m, 6)."""
        turns = np.array([cv2.Rodrigues(turn)[0] for turn in steps[:, :3]])
        return Poses(turns @ self.rotation, self.translation + steps[:, 3:])


@dataclass(frozen=True)
class Adjusted:
    """A fitted camera, poses and shape of the board."""

    camera: Array  # (14,) the parameters `INTERNAL`
    free: tuple[str, ...]  # those of `INTERNAL` and `SHAPE` that were fitted
    poses: Poses
    shape: Array  # (5,) [mm] of the board, `SHAPE`; 0 if the board is assumed to be flat
    board: Array  # (k, 3) [mm] points of the board with that shape
    residual: Array  # (n, 2) [px] observed minus predicted
    weight: Array  # (n,) 0 for outliers, else 1
    noise: float  # standard deviation of residuals over stated errors
    # Variance factor, at least 1, of the errors that all microimages of a corner share.
    cluster: float
    # Of camera, poses and shape, with `noise` and `cluster`; 0 for parameters that were not fitted.
    covariance: Array
    normal: Array  # (m, 25, 25) matrices of the normal equations of each pose
    right: Array  # (m, 25) right sides of the normal equations


def unknowns(free: Sequence[str], poses: int) -> Integers:
    """Indices of the parameters `free` and of all poses among the unknowns."""
    names = [*INTERNAL, *["pose"] * 6 * poses, *SHAPE]
    return np.flatnonzero(np.isin(names, [*free, "pose"]))


def linearise(
    camera: Array,
    pixel: float,
    poses: Poses,
    board: Array,
    observations: Observations,
    turns: Array | None = None,
) -> Array:
    """(n, 2, 25) derivatives of predicted positions over their errors by camera, pose and shape.

    With `turns` (m, 3) [rad], derivatives are taken by these rotation vectors, which were already
    applied to `poses`; by default they are 0.
    """
    o = observations
    turned = np.einsum("nij,nj->ni", poses.rotation[o.pose], board[o.corner])
    points = turned + poses.translation[o.pose]
    by_camera, by_point = project_derivatives(camera, pixel, points, o.centre)
    if turns is None:
        turns = np.zeros((len(poses.rotation), 3))
    # d(exp(w) y) / dw of y = exp(-w) turned.
    bend = [
        np.einsum("kij,lj->ikl", jacobian.reshape(3, 3, 3), rotation)
        for rotation, jacobian in (cv2.Rodrigues(turn) for turn in turns)
    ]
    by_turn = np.einsum("nikl,nl->nik", np.array(bend)[o.pose], turned)
    by_shape = poses.rotation[o.pose] @ shape_derivatives(board)[o.corner]
    rows = np.concatenate([by_camera, by_point @ by_turn, by_point, by_point @ by_shape], axis=2)
    return rows / o.error[:, None, None]


# The matrices are small: threads that wait for each other double the processor time.
@threadpool_limits.wrap(limits=1, user_api="blas")
def adjust(
    camera: Array,
    pixel: float,
    poses: Poses,
    board: Array,
    observations: Observations,
    free: Sequence[str],
    shape: Array | None = None,
) -> Adjusted:
    """Fit the parameters `free` of `INTERNAL` and `SHAPE`, and all poses.

    The fit starts from `camera` (14,), `poses` and `shape` (5,) [mm], by default a flat board.
    `board` (k, 3) [mm] are the points of the flat board about its middle.
    """
    count = len(poses.rotation)
    chosen = unknowns(free, count)
    problem = _Problem(poses, pixel, board, observations, chosen)
    if shape is None:
        shape = np.zeros(_LAST)
    values = np.concatenate([camera, np.zeros(6 * count), shape])
    everything = np.ones(len(observations))
    for _ in range(2):
        scale = _CAUCHY * _robust_noise(problem.residual(values))
        values = problem.solve(values, everything, scale)
    # Without outliers the normal matrix of least squares gives the errors.
    found = problem.residual(values)
    weight = (np.hypot(*found.T) < _OUTLIER * _robust_noise(found)).astype(np.float64)
    values = problem.solve(values, weight, None)
    camera, poses, shaped = problem.state(values)
    found = problem.residual(values)
    noise = float(np.sqrt((weight @ found**2).sum() / max(2 * weight.sum() - len(chosen), 1.0)))
    cluster = _cluster_factor(found, weight, noise, observations)
    rows = linearise(camera, pixel, poses, shaped, observations)
    equations = _normal_equations(rows, found, weight, observations.pose, count)
    covariance = np.zeros((len(values), len(values)))
    fitted = np.ix_(chosen, chosen)
    covariance[fitted] = inverse(gather(*equations)[0][fitted]) * noise**2 * cluster
    return Adjusted(
        camera,
        tuple(free),
        poses,
        values[-_LAST:],
        shaped,
        found * observations.error[:, None],
        weight,
        noise,
        cluster,
        covariance,
        *equations,
    )


@dataclass(frozen=True)
class _Problem:
    """A fit; its `values` are all unknowns, with turns and shifts from the first poses."""

    poses: Poses  # at the start
    pixel: float  # [mm]
    board: Array  # (k, 3) [mm]
    observations: Observations
    chosen: Integers  # unknowns that are fitted

    def state(self, values: Array) -> tuple[Array, Poses, Array]:
        """Camera, poses and points of the board."""
        steps = values[_OWN:-_LAST].reshape(-1, 6)
        shape = values[-_LAST:]
        return (
            values[:_OWN],
            self.poses.moved(steps),
            self.board + shape_derivatives(self.board) @ shape,
        )

    def residual(self, values: Array) -> Array:
        """(n, 2) observed minus predicted positions over their errors."""
        camera, poses, board = self.state(values)
        o = self.observations
        seen = project(camera, self.pixel, poses.of_board(board[o.corner], o.pose), o.centre)
        return np.asarray((o.position - seen) / o.error[:, None])

    def normal(self, values: Array, weight: Array) -> tuple[Array, Array]:
        """Normal equations of the unknowns that are fitted."""
        turns = values[_OWN:-_LAST].reshape(-1, 6)[:, :3]
        camera, poses, board = self.state(values)
        rows = linearise(camera, self.pixel, poses, board, self.observations, turns)
        pose = self.observations.pose
        count = len(turns)
        normal, right = gather(*_normal_equations(rows, self.residual(values), weight, pose, count))
        return normal[np.ix_(self.chosen, self.chosen)], right[self.chosen]

    def solve(self, values: Array, weight: Array, scale: float | None) -> Array:
        """The values of least weighted squared residuals, or of least Cauchy loss of `scale`."""
        from scipy.optimize import minimize

        # In these units, a step of any unknown changes the residuals equally.
        normal, _ = self.normal(values, np.ones_like(weight))
        unit = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        last = np.inf

        def full(x: Array) -> Array:
            changed = values.copy()
            changed[self.chosen] += x * unit
            return changed

        def loss(x: Array) -> float:
            square = (self.residual(full(x)) ** 2).sum(1)
            if scale is not None:
                square = scale**2 * np.log1p(square / scale**2)
            return float(weight @ square) / 2

        @lru_cache(2)
        def derivatives(x: bytes) -> tuple[Array, Array]:
            """Gradient and Hessian (Gauss-Newton)."""
            at = full(np.frombuffer(x))
            share = weight
            if scale is not None:
                share = weight / (1 + (self.residual(at) ** 2).sum(1) / scale**2)
            normal, right = self.normal(at, share)
            return -right * unit, normal * np.outer(unit, unit)

        def stop(intermediate_result: Any) -> None:
            nonlocal last
            before = last
            last = float(intermediate_result.fun)
            if 0 < before - last <= (_EXACT if scale is None else _ROUGH) * last:
                raise StopIteration

        found = minimize(
            loss,
            np.zeros(len(unit)),
            callback=stop,
            method="trust-exact",
            jac=lambda x: derivatives(x.tobytes())[0],
            hess=lambda x: derivatives(x.tobytes())[1],
            options=_TRUST,
        )
        return full(found.x)


def _normal_equations(
    rows: Array, residual: Array, weight: Array, pose: Integers, count: int
) -> tuple[Array, Array]:
    """Weighted normal equations of each pose, (m, 25, 25) and (m, 25); `pose` (n,) is sorted."""
    size = rows.shape[2]
    normal = np.zeros((count, size, size))
    right = np.zeros((count, size))
    ends = np.searchsorted(pose, np.arange(count + 1))
    for m in range(count):
        own = slice(ends[m], ends[m + 1])
        part = rows[own].reshape(-1, size)
        w = np.repeat(weight[own], 2)
        normal[m] = part.T @ (part * w[:, None])
        right[m] = part.T @ (residual[own].ravel() * w)
    return normal, right


def gather(normal: Array, right: Array) -> tuple[Array, Array]:
    """The sum of the normal equations of all poses, in the order of the unknowns."""
    count = len(normal)
    total = np.zeros(_OWN + 6 * count + _LAST)
    whole = np.zeros((len(total),) * 2)
    for m in range(count):
        places = pose_unknowns(m, count)
        whole[np.ix_(places, places)] += normal[m]
        total[places] += right[m]
    return whole, total


def pose_unknowns(m: int, count: int) -> Integers:
    """(25,) indices of the unknowns that the observations of pose `m` of `count` depend on."""
    first = _OWN + 6 * m
    last = _OWN + 6 * count
    return np.r_[:_OWN, first : first + 6, last : last + _LAST]


def eliminate(normal: Array, right: Array, kept: Integers, gone: Integers) -> tuple[Array, Array]:
    """Normal equations of the unknowns `kept`; the others are eliminated (Schur complement)."""
    taken = normal[np.ix_(kept, gone)] @ inverse(normal[np.ix_(gone, gone)])
    left = normal[np.ix_(kept, kept)] - taken @ normal[np.ix_(gone, kept)]
    return left, right[kept] - taken @ right[gone]


def inverse(matrix: Array) -> Array:
    """Inverse of a normal matrix, computed in units in which its diagonal is 1."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    units = np.outer(scale, scale)
    return np.linalg.pinv(matrix * units, rcond=1e-14, hermitian=True) * units


def _robust_noise(residual: Array) -> float:
    """Standard deviation along each axis of residuals (n, 2), from their median length."""
    return max(float(np.median(np.hypot(*residual.T))) / _MEDIAN_LENGTH, 1e-12)


def _cluster_factor(
    residual: Array, weight: Array, noise: float, observations: Observations
) -> float:
    """Variance of the mean residual of each corner over that of independent observations."""
    o = observations
    _, group = np.unique(o.pose * (o.corner.max(initial=0) + 1) + o.corner, return_inverse=True)
    total = np.bincount(group, weight / o.error**2)
    kept = total > 0
    pulls = residual * (weight / o.error)[:, None]
    sums = np.stack([np.bincount(group, pull)[kept] for pull in pulls.T], axis=1)
    # A pose fits six of the means of a board.
    freedom = max(2 * kept.sum() - 6 * len(np.unique(o.pose)), 1)
    return max(1.0, float((sums**2 / total[kept, None]).sum() / freedom / noise**2))


def select_order(
    start: Adjusted, pixel: float, board: Array, observations: Observations
) -> Adjusted:
    """Add groups of parameters to an adjusted camera as long as they explain more than noise.

    The gain of a group is that of one Gauss-Newton step on the normal equations of all parameters
    (Rao's score test). A group is a candidate if it passes the Bayesian information criterion, with
    one independent observation for each corner. The two best candidates are fitted, because one
    step can mistake a tilt for a tangential distortion, and the better fit is kept.
    """
    found = start
    corners = np.unique([observations.pose, observations.corner], axis=1).shape[1]
    while True:
        gains = {
            group: _gain(found, group) / len(group)
            for group, before in _GROUPS.items()
            if group[0] not in found.free and set(before) <= set(found.free)
        }
        passed = [group for group in gains if gains[group] > math.log(2 * corners)]
        known = (found.camera, pixel, found.poses, board, observations)
        tried = [
            adjust(*known, (*found.free, *group), found.shape)
            for group in sorted(passed, key=lambda group: -gains[group])[:2]
        ]
        best = min(tried, key=lambda one: one.noise, default=found)
        if not best.noise < found.noise:
            return found
        found = best


def _gain(found: Adjusted, group: tuple[str, ...]) -> float:
    """Expected decrease of -2 log likelihood if `group` is fitted too."""
    normal, right = gather(found.normal, found.right)
    count = len(found.normal)
    new = np.setdiff1d(unknowns(group, count), unknowns((), count))
    # The part that the fitted parameters cannot explain.
    left, pull = eliminate(normal, right, new, unknowns(found.free, count))
    scale = 1 / np.sqrt(np.maximum(np.diag(normal)[new], 1e-300))
    left = left * np.outer(scale, scale)
    pull = pull * scale
    if np.linalg.eigvalsh(left)[0] < 1e-9:
        return 0.0
    return float(pull @ np.linalg.solve(left, pull)) / (found.noise**2 * found.cluster)
