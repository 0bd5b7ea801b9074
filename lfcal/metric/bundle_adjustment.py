"""Robust bundle adjustment of the camera, the poses of the boards and their shape, with the
covariance of all.

Which parameters the data ask for is found by forward selection with score tests.

`scipy.optimize.minimize` in a trust region, on the normal equations, with a Cauchy loss, then
without the outliers. These are a dense matrix of a hundred unknowns, solved exactly: iterative
solvers stop short along the weak directions that focal length and distances have, and
`least_squares` takes a singular value decomposition of all observations. An observation depends on
25 of the unknowns alone: 14 of the camera, 6 of its pose, 5 of the shape of the board.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

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
# Groups that are fitted together, and what has to be fitted before.
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


@dataclass(frozen=True, eq=False)
class Observations(Frozen):
    """Corners seen in microimages, sorted by pose."""

    pose: Integers  # (n,) which flat
    corner: Integers  # (n,) which point of the board
    centre: Floats  # (n, 2) [px] of the microimage
    position: Floats  # (n, 2) [px] where on the flat the corner is seen
    error: Floats  # (n,) [px] standard error of that along each axis; 1 where only ratios are known

    def __post_init__(self) -> None:
        order = np.argsort(self.pose, kind="stable")
        whole = {"pose": np.int64, "corner": np.int64}
        names = ("pose", "corner", "centre", "position", "error")
        self._set(
            **{
                name: np.asarray(getattr(self, name), whole.get(name, np.float64))[order]
                for name in names
            }
        )

    def __len__(self) -> int:
        return len(self.pose)


@dataclass(frozen=True)
class Poses:
    """Rotations (m, 3, 3) and translations (m, 3) [mm] from the board, about its middle, to the
    camera.
    """

    rotation: Array
    translation: Array

    def of_board(self, points: Array, pose: Integers) -> Array:
        """(n, 3) points of the board, in poses (n,), in the frame of the camera."""
        return np.einsum("nij,nj->ni", self.rotation[pose], points) + self.translation[pose]

    def moved(self, steps: Array) -> Poses:
        """Turned by vectors [rad] and shifted by [mm], (m, 6)."""
        turned = [
            cv2.Rodrigues(step[:3])[0] @ rotation
            for step, rotation in zip(steps, self.rotation, strict=True)
        ]
        return Poses(np.array(turned), self.translation + steps[:, 3:])


@dataclass(frozen=True)
class Adjusted:
    """A fitted camera with poses. The unknowns are 14 parameters of the camera, 6 of each pose, 5
    of the shape.
    """

    camera: Array  # (14,) the parameters `INTERNAL`
    free: tuple[str, ...]  # those of `INTERNAL` and `SHAPE` that were fitted
    poses: Poses
    shape: Array  # (5,) [mm] of the board, `SHAPE`; 0 where it is taken to be flat
    board: Array  # (k, 3) [mm] points of the board with that shape
    residual: Array  # (n, 2) [px] observed minus predicted
    weight: Array  # (n,) 1, or 0 of outliers
    noise: float  # standard deviation of residuals over stated errors
    cluster: float  # factor, at least 1, by which errors that the microimages of a corner share widen the covariance
    covariance: Array  # of camera, poses and shape, `noise` and `cluster` included; 0 of what was not fitted
    normal: Array  # (m, 25, 25) normal equations of each pose, with their right side
    right: Array  # (m, 25)


def unknowns(free: Sequence[str], poses: int) -> Integers:
    """Places of the parameters `free`, and of those of all poses, among the unknowns."""
    last = _OWN + 6 * poses
    places = {name: k for k, name in enumerate(INTERNAL)} | {
        name: last + k for k, name in enumerate(SHAPE)
    }
    return np.sort(np.r_[[places[name] for name in free], _OWN:last].astype(np.int64))


def linearise(
    camera: Array,
    pixel: float,
    poses: Poses,
    board: Array,
    observations: Observations,
    turns: Array | None = None,
) -> Array:
    """(n, 2, 25) derivatives of the predicted positions over their errors by camera, pose and
    shape.

    `turns` (m, 3) [rad] are the turns that led to `poses`, where derivatives are taken by those; by
    default none.
    """
    o = observations
    turned = np.einsum("nij,nj->ni", poses.rotation[o.pose], board[o.corner])
    points = turned + poses.translation[o.pose]
    by_camera, by_point = project_derivatives(camera, pixel, points, o.centre)
    turns = np.zeros((len(poses.rotation), 3)) if turns is None else turns
    # d(exp(w) y) / dw of y = exp(-w) turned.
    bend = [
        np.einsum("kij,lj->ikl", jacobian.reshape(3, 3, 3), rotation)
        for rotation, jacobian in (cv2.Rodrigues(turn) for turn in turns)
    ]
    by_turn = np.einsum("nikl,nl->nik", np.array(bend)[o.pose], turned)
    by_shape = poses.rotation[o.pose] @ shape_derivatives(board)[o.corner]
    rows = np.concatenate([by_camera, by_point @ by_turn, by_point, by_point @ by_shape], axis=2)
    return rows / o.error[:, None, None]


def adjust(
    camera: Array,
    pixel: float,
    poses: Poses,
    board: Array,
    observations: Observations,
    free: Sequence[str],
    shape: Array | None = None,
) -> Adjusted:
    """Fit the parameters `free` of `INTERNAL` and `SHAPE` (none: poses alone), and all poses.

    `camera` (14,), `poses` and `shape` (5,) [mm] (by default flat) are the start, `board` (k, 3)
    [mm] the points of the flat board about its middle.
    """
    count = len(poses.rotation)
    chosen = unknowns(free, len(poses.rotation))
    problem = _Problem(poses, pixel, board, observations, chosen)
    values = np.concatenate(
        [camera, np.zeros(6 * count), np.zeros(_LAST) if shape is None else shape]
    )
    everything = np.ones(len(observations))
    for _ in range(2):
        values = problem.solve(values, everything, 3 * _robust_noise(problem.residual(values)))
    # Least squares without the outliers: its errors are those of the normal matrix. One normal
    # error in 25,000 is off by 4.5 standard deviations.
    found = problem.residual(values)
    weight = (np.hypot(*found.T) < 4.5 * _robust_noise(found)).astype(np.float64)
    values = problem.solve(values, weight, None)
    camera, poses, shaped = problem.state(values)
    found = problem.residual(values)
    noise = float(np.sqrt((weight @ found**2).sum() / max(2 * weight.sum() - len(chosen), 1.0)))
    cluster = _cluster_factor(found, weight, noise, observations)
    rows = linearise(camera, pixel, poses, shaped, observations)
    equations = _normal_equations(rows, found, weight, observations.pose, count)
    covariance = np.zeros((len(values), len(values)))
    off = found * observations.error[:, None]
    covariance[np.ix_(chosen, chosen)] = (
        inverse(gather(*equations)[0][np.ix_(chosen, chosen)]) * noise**2 * cluster
    )
    return Adjusted(
        camera,
        tuple(free),
        poses,
        values[-_LAST:],
        shaped,
        off,
        weight,
        noise,
        cluster,
        covariance,
        *equations,
    )


@dataclass(frozen=True)
class _Problem:
    """Poses to start from, and what is fitted: all unknowns are `values`, with the turns and shifts
    from the start.
    """

    poses: Poses
    pixel: float
    board: Array
    observations: Observations
    chosen: Integers

    def state(self, values: Array) -> tuple[Array, Poses, Array]:
        """Camera, poses and board."""
        steps = values[_OWN:-_LAST].reshape(-1, 6)
        shape = values[-_LAST:]
        return (
            values[:_OWN],
            self.poses.moved(steps),
            self.board + shape_derivatives(self.board) @ shape,
        )

    def residual(self, values: Array) -> Array:
        """(n, 2) observed minus predicted positions over their errors."""
        (camera, poses, board), o = self.state(values), self.observations
        seen = project(camera, self.pixel, poses.of_board(board[o.corner], o.pose), o.centre)
        return np.asarray((o.position - seen) / o.error[:, None])

    def normal(self, values: Array, weight: Array) -> tuple[Array, Array]:
        """Normal equations of what is fitted."""
        turns = values[_OWN:-_LAST].reshape(-1, 6)[:, :3]
        camera, poses, board = self.state(values)
        rows = linearise(camera, self.pixel, poses, board, self.observations, turns)
        pose = self.observations.pose
        count = len(turns)
        normal, right = gather(*_normal_equations(rows, self.residual(values), weight, pose, count))
        return normal[np.ix_(self.chosen, self.chosen)], right[self.chosen]

    def solve(self, values: Array, weight: Array, scale: float | None) -> Array:
        """The values that minimise the weighted squares of residuals, or their Cauchy loss of this
        `scale`.
        """
        from scipy.optimize import minimize

        # Unknowns of very different size: in units in which each changes the residuals as much.
        unit = 1 / np.sqrt(
            np.maximum(np.diag(self.normal(values, np.ones_like(weight))[0]), 1e-300)
        )
        last = [np.inf]

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
            """Gradient, and the Hessian of Gauss and Newton."""
            at = full(np.frombuffer(x))
            share = (
                weight
                if scale is None
                else weight / (1 + (self.residual(at) ** 2).sum(1) / scale**2)
            )
            normal, right = self.normal(at, share)
            return -right * unit, normal * np.outer(unit, unit)

        def stop(intermediate_result: Any) -> None:
            before, last[0] = last[0], float(intermediate_result.fun)
            if 0 < before - last[0] <= (1e-9 if scale is None else 1e-4) * last[0]:
                raise StopIteration

        found = minimize(
            loss,
            np.zeros(len(unit)),
            callback=stop,
            method="trust-exact",
            jac=lambda x: derivatives(x.tobytes())[0],
            hess=lambda x: derivatives(x.tobytes())[1],
            options={
                "initial_trust_radius": 1e4,
                "max_trust_radius": 1e9,
                "gtol": 1e-6,
                "maxiter": 60,
            },
        )
        return full(found.x)


def _normal_equations(
    rows: Array, residual: Array, weight: Array, pose: Integers, count: int
) -> tuple[Array, Array]:
    """(m, 25, 25) and (m, 25): weighted normal equations of the observations of each pose, which
    are sorted by it.
    """
    size = rows.shape[2]
    normal = np.zeros((count, size, size))
    right = np.zeros((count, size))
    ends = np.searchsorted(pose, np.arange(count + 1))
    for m in range(count):
        own = slice(ends[m], ends[m + 1])
        part = rows[own].reshape(-1, size)
        w = np.repeat(weight[own], 2)
        normal[m], right[m] = part.T @ (part * w[:, None]), part.T @ (residual[own].ravel() * w)
    return normal, right


def gather(normal: Array, right: Array) -> tuple[Array, Array]:
    """The normal equations of all poses together, in the order of the unknowns."""
    count = len(normal)
    whole = np.zeros((_OWN + 6 * count + _LAST,) * 2)
    total = np.zeros(_OWN + 6 * count + _LAST)
    for m in range(count):
        places = pose_unknowns(m, count)
        whole[np.ix_(places, places)] += normal[m]
        total[places] += right[m]
    return whole, total


def pose_unknowns(m: int, count: int) -> Integers:
    """Places among the unknowns of the 25 that pose `m` of `count` depends on."""
    first = _OWN + 6 * m
    last = _OWN + 6 * count
    return np.r_[:_OWN, first : first + 6, last : last + _LAST]


def eliminate(normal: Array, right: Array, kept: Integers, gone: Integers) -> tuple[Array, Array]:
    """Normal equations of the unknowns `kept`, without what those that are `gone` take up (Schur
    complement).
    """
    taken = normal[np.ix_(kept, gone)] @ inverse(normal[np.ix_(gone, gone)])
    return normal[np.ix_(kept, kept)] - taken @ normal[np.ix_(gone, kept)], right[
        kept
    ] - taken @ right[gone]


def inverse(matrix: Array) -> Array:
    """Of a normal matrix, whose unknowns have scales of their own."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-14, hermitian=True) * np.outer(
        scale, scale
    )


def _robust_noise(residual: Array) -> float:
    """The median distance of a two-dimensional normal distribution is 1.177 standard deviations."""
    return max(float(np.median(np.hypot(*residual.T))) / 1.1774, 1e-12)


def _cluster_factor(
    residual: Array, weight: Array, noise: float, observations: Observations
) -> float:
    """How much more the mean residuals of the corners scatter than those of independent
    observations would.
    """
    o = observations
    _, group = np.unique(o.pose * (o.corner.max(initial=0) + 1) + o.corner, return_inverse=True)
    total = np.bincount(group, weight / o.error**2)
    kept = total > 0
    sums = np.stack(
        [np.bincount(group, weight / o.error * residual[:, k])[kept] for k in (0, 1)], axis=1
    )
    # Poses take up six of the means of a board.
    freedom = max(2 * kept.sum() - 6 * len(np.unique(o.pose)), 1)
    return max(1.0, float((sums**2 / total[kept, None]).sum() / freedom / noise**2))


def select_order(
    start: Adjusted, pixel: float, board: Array, observations: Observations
) -> Adjusted:
    """Add groups of parameters to an adjusted camera as long as the likelihood gains more than
    noise would.

    Each group's gain is that of one Gauss-Newton step on the normal equations of all parameters
    (Rao's score test). Those that pass the Bayesian information criterion, with one independent
    observation for each corner, may join. The two best ones are fitted, as one step can mistake a
    tilt for a tangential distortion; the better fit stays.
    """
    found = start
    corners = len(np.unique(np.stack([observations.pose, observations.corner]), axis=1).T)
    while True:
        gains = {
            group: _gain(found, group) / len(group)
            for group, before in _GROUPS.items()
            if group[0] not in found.free and set(before) <= set(found.free)
        }
        passed = [group for group in gains if gains[group] > math.log(2 * corners)]
        tried = [
            adjust(
                found.camera,
                pixel,
                found.poses,
                board,
                observations,
                (*found.free, *group),
                found.shape,
            )
            for group in sorted(passed, key=lambda group: -gains[group])[:2]
        ]
        best = min(tried, key=lambda one: one.noise, default=found)
        if not best.noise < found.noise:
            return found
        found = best


def _gain(found: Adjusted, group: tuple[str, ...]) -> float:
    """Expected fall of -2 log likelihood if `group` is fitted too."""
    normal, right = gather(found.normal, found.right)
    count = len(found.normal)
    new = np.setdiff1d(unknowns(group, count), unknowns((), count))
    # What the fitted parameters cannot take up.
    left, pull = eliminate(normal, right, new, unknowns(found.free, count))
    scale = 1 / np.sqrt(np.maximum(np.diag(normal)[new], 1e-300))
    left = left * np.outer(scale, scale)
    pull = pull * scale
    if np.linalg.eigvalsh(left)[0] < 1e-9:
        return 0.0
    return float(pull @ np.linalg.solve(left, pull)) / (found.noise**2 * found.cluster)
