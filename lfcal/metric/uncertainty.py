"""How well the optics are known: covariance widened by what poses share, and combinations that hardly separate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.optics import OPTICS_PARAMETERS, Optics
from .bundle_adjustment import Adjusted, Poses, normal_equations, unknowns
from .camera_model import INTERNAL, from_internal, to_internal
from .observations import Observations
from .settings import UNCERTAINTY, UncertaintySettings

__all__ = ["describe_degeneracies", "optics_of", "pose_factor", "rim_covariance"]

Array = NDArray[Any]

_NAMES = {
    "focal_length": "F",
    "mla_distance": "L",
    "sensor_distance": "b",
    "principal_x": "principal point (x)",
    "principal_y": "principal point (y)",
}


def pose_factor(found: Adjusted, pixel: float, observations: Observations) -> float:
    """How much more the gradients of single poses scatter than those of independent errors would.

    Variance factor, at least 1, of the fitted parameters: the cluster-robust (sandwich) covariance with poses as
    clusters, over what it is expected to be, as the mean over all directions (MacKinnon, Nielsen and Webb 2023). Errors
    of the model show here.
    """
    count, own = len(found.poses.rotation), len(INTERNAL)
    # With one pose, its own unknowns lie between those of the camera and of the board.
    of_pose = slice(own, own + 6)
    chosen = np.setdiff1d(unknowns(found.free, 1), np.arange(own, own + 6))
    if count <= 3 or not len(chosen):
        return 1.0
    reduced = np.zeros((count, len(chosen), len(chosen)))
    gradient = np.zeros((count, len(chosen)))
    for m in range(count):
        mine = observations.pose == m
        part = observations.select(mine)
        part = Observations(part.pose * 0, part.corner, part.centre, part.position, part.error)
        pose = Poses(found.poses.rotation[m : m + 1], found.poses.translation[m : m + 1])
        normals = normal_equations(found.camera, pixel, pose, found.board, part, found.weight[mine])
        across = normals.matrix[chosen][:, of_pose]
        both = np.linalg.lstsq(normals.matrix[of_pose, of_pose], across.T, rcond=1e-12)[0]
        reduced[m] = normals.matrix[np.ix_(chosen, chosen)] - across @ both
        gradient[m] = normals.gradient[chosen] - both.T @ normals.gradient[of_pose]
    scale = 1 / np.sqrt(np.maximum(np.diag(reduced.sum(0)), 1e-300))
    reduced, gradient = reduced * np.outer(scale, scale), gradient * scale
    total = reduced.sum(0)
    inverse = np.linalg.pinv(total, hermitian=True)
    measured = expected = 0.0
    for own_share, own_gradient in zip(reduced, gradient, strict=True):
        measured += float(own_gradient @ inverse @ own_gradient)
        # Of independent errors; the gradients of all poses add up to nothing.
        expected += float(np.trace(inverse @ (own_share - own_share @ inverse @ own_share)))
    return max(1.0, measured / max(expected, 1e-300) / (found.noise**2 * found.cluster))


def rim_covariance(found: Adjusted, pixel: float, observations: Observations, radius: float, bias: float) -> Array:
    """Covariance of all unknowns by errors that no scatter shows, those of corners near the rim of microimages.

    What is seen at the `radius` [px] lies too far out, or in, by a `bias` [px] that all poses share, and by one of the
    same size that the corners of each pose share, as blur and light differ; nearer to the centre in proportion.
    """
    count = len(found.poses.rotation)

    def gradient(position: Array) -> Array:
        moved = replace(observations, position=position)
        return normal_equations(found.camera, pixel, found.poses, found.board, moved, found.weight).gradient

    start = gradient(observations.position)
    outward = (observations.position - observations.centre) * (bias / radius)
    moved = [observations.position + outward * (observations.pose == m)[:, None] for m in range(count)]
    # The unknowns follow the gradient by the inverse of the normal matrix, which the covariance holds.
    inverse = found.covariance / (found.noise**2 * found.cluster)
    steps = inverse @ np.stack([gradient(position) - start for position in moved], axis=1)
    total = steps.sum(1, keepdims=True)
    return steps @ steps.T + total @ total.T


def optics_of(found: Adjusted, pixel: float) -> Optics:
    """The fitted camera as optics, with its covariance."""
    lengths = from_internal(found.camera[:3], pixel)
    change = np.eye(len(INTERNAL))
    change[:3, :3] = np.linalg.inv(to_internal(lengths, pixel)[1])
    own = len(INTERNAL)
    covariance = change @ found.covariance[:own, :own] @ change.T
    blank = Optics(1.0, 1.0, 1.0, pixel, principal_point=(0.0, 0.0), covariance=(covariance + covariance.T) / 2)
    return blank.with_parameters(np.concatenate([lengths, found.camera[3:]]))


def describe_degeneracies(optics: Optics, *, settings: UncertaintySettings = UNCERTAINTY) -> tuple[str, ...]:
    """Parameters that hardly separate, and the combinations of F, L and b that are well known."""
    errors, values = optics.standard_errors, optics.parameters
    fitted = np.flatnonzero(errors > 0)
    if optics.covariance is None or not len(fitted):
        return ()
    scale = np.where(errors > 0, errors, np.inf)
    correlation = optics.covariance / np.outer(scale, scale)
    notes = []
    lengths = [k for k in (0, 1, 2) if errors[k] > 0]
    weak = [k for k in lengths if errors[k] > settings.weak_length * values[k]]
    close = len(lengths) > 1 and abs(correlation[lengths[0], lengths[1]]) > settings.correlated
    if weak or close:
        stated = ", ".join(f"{_NAMES[OPTICS_PARAMETERS[k]]} = {values[k]:.4g} +- {errors[k]:.2g} mm" for k in lengths)
        internal, derivatives = to_internal(values[:3], optics.pixel)
        sure = np.sqrt(np.maximum(np.diag(derivatives @ optics.covariance[:3, :3] @ derivatives.T), 0))
        notes.append(
            f"F, L and b hardly separate ({stated}); well known are (L + b) / pixel = {internal[0]:.6g} +- "
            f"{sure[0]:.2g} px and D / s = A + B / Z with A = {internal[1]:.5g} +- {sure[1]:.2g}, "
            f"B = {internal[2]:.6g} +- {sure[2]:.2g} mm, on which distances rest; boards at very "
            "different distances part them"
        )
    for n, k in enumerate(fitted):
        for j in fitted[:n]:
            if k > 2 and j > 2 and abs(correlation[k, j]) > settings.correlated:
                first, second = (_NAMES.get(OPTICS_PARAMETERS[i], OPTICS_PARAMETERS[i]) for i in (j, k))
                notes.append(
                    f"{first} and {second} hardly separate (correlation {correlation[k, j]:+.3f}); boards in all "
                    "corners of the field part them"
                )
    return tuple(notes)
