"""Uncertainty of the optics: errors that all poses share, and parameters that a fit confuses."""

from __future__ import annotations

import numpy as np

from ..camera.optics import OPTICS_PARAMETERS, Optics
from ..runtime.arrays import Array
from .bundle_adjustment import (
    POSE,
    Adjusted,
    Observations,
    eliminate,
    linearise,
    pose_unknowns,
    unknowns,
)
from .camera_model import INTERNAL, from_internal, to_internal

__all__ = ["describe_degeneracies", "internal_camera", "optics_of", "pose_factor", "rim_covariance"]

# Error of corners at the rim of a microimage [px], outwards or inwards: 0.002 to 0.005 on
# ray-traced boards of others.
_RIM_ERROR = 0.003
# Correlation above which a fit hardly separates two parameters.
_CORRELATED = 0.98
# Relative standard error above which a length is not known well.
_UNCERTAIN = 0.01


def pose_factor(found: Adjusted) -> float:
    """Variance factor, at least 1, of the fitted parameters from the scatter of single poses.

    It is the cluster-robust (sandwich) covariance with poses as clusters (MacKinnon, Nielsen and
    Webb 2023) over the one expected for independent errors, averaged over all directions. Errors of
    the model make it larger.
    """
    chosen = np.setdiff1d(unknowns(found.free, 1), POSE)
    if len(found.normal) <= 3 or not len(chosen):
        return 1.0
    # Each pose takes up a part of the information about the camera.
    left = [
        eliminate(*equations, chosen, POSE)
        for equations in zip(found.normal, found.right, strict=True)
    ]
    scale = 1 / np.sqrt(sum(np.diag(normal)[chosen] for normal in found.normal))
    shares = [share * np.outer(scale, scale) for share, _ in left]
    total = np.linalg.pinv(np.sum(shares, axis=0), hermitian=True)
    measured = sum(float((pull * scale) @ total @ (pull * scale)) for _, pull in left)
    # The scatter of independent errors; the gradients of all poses add up to zero.
    expected = sum(float(np.trace(total @ (share - share @ total @ share))) for share in shares)
    return max(1.0, measured / max(expected, 1e-300) / (found.noise**2 * found.cluster))


def rim_covariance(
    found: Adjusted, pixel: float, observations: Observations, radius: float
) -> Array:
    """Covariance of all unknowns by systematic errors of corners near the rims.

    Corners at the `radius` [px] lie too far out, or in, by an error that all poses share and by
    another one that the corners of each pose share, because blur and light differ. Errors nearer to
    the centre are smaller in proportion.
    """
    o = observations
    count = len(found.normal)
    rows = linearise(found.camera, pixel, found.poses, found.board, o) * found.weight[:, None, None]
    outward = (o.position - o.centre) * (_RIM_ERROR / radius / o.error)[:, None]
    pulls = np.zeros((len(found.covariance), count))
    for m in range(count):
        pulls[pose_unknowns(m, count), m] = np.einsum(
            "nij,ni->j", rows[o.pose == m], outward[o.pose == m]
        )
    # The covariance holds the inverse of the normal matrix, which turns gradients into steps.
    steps = found.covariance / (found.noise**2 * found.cluster) @ pulls
    total = steps.sum(1, keepdims=True)
    return np.asarray(steps @ steps.T + total @ total.T)


def optics_of(found: Adjusted, pixel: float) -> Optics:
    """The fitted camera as optics, with its covariance."""
    lengths = from_internal(found.camera[:3], pixel)
    change = np.eye(len(INTERNAL))
    own = len(INTERNAL)
    change[:3, :3] = np.linalg.inv(to_internal(lengths, pixel)[1])
    covariance = change @ found.covariance[:own, :own] @ change.T
    blank = Optics(
        1.0, 1.0, 1.0, pixel, principal_point=(0.0, 0.0), covariance=(covariance + covariance.T) / 2
    )
    return blank.with_parameters(np.concatenate([lengths, found.camera[3:]]))


def internal_camera(optics: Optics) -> tuple[Array, Array]:
    """Parameters `INTERNAL` (14,) of optics and their derivatives (14, 14) by the optics."""
    change = np.eye(len(INTERNAL))
    lengths, change[:3, :3] = to_internal(optics.parameters[:3], optics.pixel)
    return np.concatenate([lengths, optics.parameters[3:]]), change


def describe_degeneracies(optics: Optics) -> tuple[str, ...]:
    """Messages about parameters that the fit hardly separates, and what is known well instead."""
    errors = optics.standard_errors
    values = optics.parameters
    covariance = optics.covariance
    if covariance is None or not (errors > 0).any():
        return ()
    scale = np.where(errors > 0, errors, np.inf)
    correlation = covariance / np.outer(scale, scale)
    close = np.abs(correlation) > _CORRELATED
    notes = []
    lengths = [k for k in (0, 1, 2) if errors[k] > 0]
    uncertain = any(errors[k] > _UNCERTAIN * values[k] for k in lengths)
    if uncertain or (len(lengths) > 1 and close[lengths[0], lengths[1]]):
        stated = ", ".join(f"{'FLb'[k]} = {values[k]:.4g} +- {errors[k]:.2g} mm" for k in lengths)
        internal, derivatives = to_internal(values[:3], optics.pixel)
        sure = np.sqrt(np.maximum(np.diag(derivatives @ covariance[:3, :3] @ derivatives.T), 0))
        notes.append(
            f"F, L and b hardly separate ({stated}). Distances depend on (L + b) / pixel = "
            f"{internal[0]:.6g} +- {sure[0]:.2g} px and on D / s = A + B / Z with A = "
            f"{internal[1]:.5g} +- {sure[1]:.2g}, B = {internal[2]:.6g} +- {sure[2]:.2g} mm, which "
            "are known better. Boards at very different distances separate F, L and b"
        )
    names = [name.replace("principal_", "principal point ") for name in OPTICS_PARAMETERS]
    pairs = np.argwhere(np.tril(close, -1))
    notes += [
        f"{names[j]} and {names[k]} hardly separate (correlation {correlation[k, j]:+.3f}); "
        "boards in all corners of the field separate them"
        for k, j in pairs[pairs[:, 1] > 2]
    ]
    return tuple(notes)
