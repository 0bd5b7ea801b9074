"""How well the optics are known: covariance widened by what poses share, and combinations that hardly separate."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.optics import OPTICS_PARAMETERS, Optics
from .bundle_adjustment import Adjusted, unknowns
from .camera_model import INTERNAL, from_internal, to_internal
from .observations import Observations

__all__ = ["describe_degeneracies", "optics_of", "pose_factor", "rim_covariance"]

Array = NDArray[Any]

_CLOSE = 0.98  # correlation from which on two parameters are said to hardly separate
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
    chosen = np.setdiff1d(unknowns(found.free, count), unknowns((), count))
    if count <= 3 or not len(chosen):
        return 1.0
    rows, shares, gradients = found.linearise(pixel, observations), [], []
    scale = 1 / np.maximum(np.linalg.norm(rows[:, :, chosen], axis=(0, 1)), 1e-150)
    for m in range(count):
        mine = observations.pose == m
        part = rows[mine].reshape(-1, rows.shape[2])
        residual = (found.residual[mine] / observations.error[mine, None]).ravel()
        of_pose, of_camera = part[:, own + 6 * m : own + 6 * m + 6], part[:, chosen] * scale
        # What the pose takes up tells nothing about the camera.
        left = of_camera - of_pose @ (np.linalg.pinv(of_pose) @ of_camera)
        shares.append(left.T @ left)
        gradients.append(left.T @ residual)
    total = np.linalg.pinv(np.sum(shares, axis=0), hermitian=True)
    measured = sum(float(gradient @ total @ gradient) for gradient in gradients)
    # Of independent errors; the gradients of all poses add up to nothing.
    expected = sum(float(np.trace(total @ (share - share @ total @ share))) for share in shares)
    return max(1.0, measured / max(expected, 1e-300) / (found.noise**2 * found.cluster))


def rim_covariance(found: Adjusted, pixel: float, observations: Observations, radius: float) -> Array:
    """Covariance of all unknowns by errors that no scatter shows, those of corners near the rim of microimages.

    What is seen at the `radius` [px] lies too far out, or in, by 0.003 px (ray-traced boards of others show 0.002 to
    0.005) that all poses share, and by an error of the same size that the corners of each pose share, as blur and
    light differ; nearer to the centre in proportion.
    """
    rows = found.linearise(pixel, observations)
    outward = (observations.position - observations.centre) * (0.003 / radius / observations.error)[:, None]
    pulls = [np.einsum("nij,ni->j", rows[mine], outward[mine]) for mine in _by_pose(observations)]
    # The unknowns follow the gradient by the inverse of the normal matrix, which the covariance holds.
    steps = found.covariance / (found.noise**2 * found.cluster) @ np.stack(pulls, axis=1)
    total = steps.sum(1, keepdims=True)
    return np.asarray(steps @ steps.T + total @ total.T)


def _by_pose(observations: Observations) -> list[NDArray[np.bool_]]:
    return [observations.pose == m for m in range(int(observations.pose.max()) + 1)]


def optics_of(found: Adjusted, pixel: float) -> Optics:
    """The fitted camera as optics, with its covariance."""
    lengths = from_internal(found.camera[:3], pixel)
    change = np.eye(len(INTERNAL))
    change[:3, :3] = np.linalg.inv(to_internal(lengths, pixel)[1])
    own = len(INTERNAL)
    covariance = change @ found.covariance[:own, :own] @ change.T
    blank = Optics(1.0, 1.0, 1.0, pixel, principal_point=(0.0, 0.0), covariance=(covariance + covariance.T) / 2)
    return blank.with_parameters(np.concatenate([lengths, found.camera[3:]]))


def describe_degeneracies(optics: Optics) -> tuple[str, ...]:
    """Parameters that hardly separate, and the combinations of F, L and b that are well known."""
    errors, values = optics.standard_errors, optics.parameters
    fitted = np.flatnonzero(errors > 0)
    if optics.covariance is None or not len(fitted):
        return ()
    scale = np.where(errors > 0, errors, np.inf)
    correlation = optics.covariance / np.outer(scale, scale)
    notes = []
    lengths = [k for k in (0, 1, 2) if errors[k] > 0]
    weak = [k for k in lengths if errors[k] > 0.01 * values[k]]
    close = len(lengths) > 1 and abs(correlation[lengths[0], lengths[1]]) > _CLOSE
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
            if k > 2 and j > 2 and abs(correlation[k, j]) > _CLOSE:
                first, second = (_NAMES.get(OPTICS_PARAMETERS[i], OPTICS_PARAMETERS[i]) for i in (j, k))
                notes.append(
                    f"{first} and {second} hardly separate (correlation {correlation[k, j]:+.3f}); boards in all "
                    "corners of the field part them"
                )
    return tuple(notes)
