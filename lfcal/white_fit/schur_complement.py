"""Least squares of a step of a white image's fit: gains solved for first, the profile along with all lenses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..lattice.robust_fit import tukey_weights
from .normal_equations import NormalEquations

__all__ = ["ReducedEquations", "eliminate_gains", "invert_2x2", "solve_robustly"]

# Passes of robust weighting.
_ROBUST_TURNS = 3


@dataclass(frozen=True)
class ReducedEquations:
    """Least squares without the gains: local parameters (n, m), profile (r,) and between them; none where unneeded.

    Of the six local parameters only the place, `m = 2`, where nothing is cut. `mixed` (n, 7, r) is with the gains:
    what a local parameter shares with the profile is its row less its `share` (n, m) of the last one.
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    share: NDArray[np.float64]
    mixed: NDArray[np.float64]
    profile: NDArray[np.float64]
    force: NDArray[np.float64]

    @cached_property
    def _factors(self) -> NDArray[np.float64]:
        """Cholesky factors of the profile, which all least squares of one step have in common."""
        # Compiled code has loaded this module already.
        from scipy.linalg.lapack import dpotrf

        factors, failed = dpotrf(self.profile, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the pixels do not tell the profile of the microimages")
        return np.asarray(factors)

    def profiles(self, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """(r, k) steps of the profile that forces (r, k) on it make, or (r,); LinAlgError where there are none."""
        from scipy.linalg.lapack import dpotrs

        return np.asarray(dpotrs(self._factors, forces, lower=1)[0])

    def with_gains(self, columns: NDArray[np.float64], half: NDArray[np.bool_] | slice) -> NDArray[np.float64]:
        """(n, m + 1, p) change of the local parameters of a part of the lenses and, which follow them, of the gains."""
        return np.concatenate([columns, -(self.share[half][:, None] @ columns)], axis=1)


def eliminate_gains(
    steps: NormalEquations, level: NDArray[np.float64], say: NDArray[np.float64] | None = None
) -> ReducedEquations:
    """`say` (n,) is by how much the weights of lenses have changed since these steps."""
    own = np.maximum(steps.normal[:, -1, -1], 1e-30)
    share = steps.normal[:, :-1, -1] / own[:, None]
    normal = steps.normal[:, :-1, :-1] - share[:, :, None] * steps.normal[:, None, :-1, -1]
    right = steps.right[:, :-1] - share * steps.right[:, [-1]]
    if say is not None:
        normal, right = normal * say[:, None, None], right * say[:, None]
    if len(steps.force) == 0:
        return ReducedEquations(normal, right, share, steps.mixed[:, :0], steps.profile, steps.force)
    gain = steps.mixed[:, -1]
    even = gain / np.sqrt(own)[:, None]
    # Gains and profile share one scale, which the profile keeps.
    scale = np.trace(steps.profile) / (level @ level) * np.outer(level, level)
    return ReducedEquations(
        normal,
        right,
        share,
        steps.mixed if steps.mixed.shape[1] > 1 else steps.mixed[:, :0],
        steps.profile - even.T @ even + scale,
        steps.force - (steps.right[:, -1] / own) @ gain,
    )


def solve_robustly(
    columns: NDArray[np.float64],
    reduced: ReducedEquations,
    half: NDArray[np.bool_] | slice,
    before: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Robust least squares over a part of the lenses: change (p,), covariance (p, p) and weights (n,) of the lenses.

    Weights (n,) of all lenses as they were `before`, in nearly the same state, need one turn to be right.
    """
    columns = np.ascontiguousarray(columns[half])
    normal, right = reduced.normal[half], reduced.right[half]
    part = len(columns) / len(reduced.normal)
    lenses, local, globals_ = columns.shape
    places = normal[:, :2, :2] + 1e-9 * np.trace(normal[:, :2, :2].sum(0)) / lenses * np.eye(2)
    inverse = invert_2x2(places)
    force, matter = right.reshape(-1), (normal @ columns).reshape(-1, globals_)
    if reduced.mixed.shape[1]:
        all_local = reduced.with_gains(columns, half)
        mixed = reduced.mixed[half].reshape(lenses * (local + 1), -1)
    weight = np.ones(lenses) if before is None else before[half]
    for _ in range(_ROBUST_TURNS if before is None else 1):
        weighted = (weight[:, None, None] * columns).reshape(-1, globals_).T
        information, pull = weighted @ matter, weighted @ force
        if reduced.mixed.shape[1]:
            # The profile changes along with the parameters: what it can take over says nothing about them.
            joint = (weight[:, None, None] * all_local).reshape(len(mixed), -1).T @ mixed
            taken = reduced.profiles(joint.T).T / part
            information -= taken @ joint.T / weight.mean()
            pull -= part * taken @ reduced.force
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
        change = covariance @ pull
        left = right[:, :2] - (matter @ change).reshape(lenses, local)[:, :2]
        far = left[:, 0] ** 2 * inverse[:, 0, 0] + left[:, 1] ** 2 * inverse[:, 1, 1]
        far += 2 * left[:, 0] * left[:, 1] * inverse[:, 0, 1]
        weight, variance = tukey_weights(far)
    return change, covariance * variance, weight


def invert_2x2(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) inverses of symmetric positive matrices; LAPACK takes several times as long for such small ones."""
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    over = 1 / np.maximum(xx * yy - xy * xy, np.finfo(float).tiny)
    return np.stack([yy * over, -xy * over, -xy * over, xx * over], axis=1).reshape(-1, 2, 2)
