"""Find the disc that cuts microimages (cat-eye) from where their rims lie in parts of the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RimCut", "find_rim_cut"]

# Displacements in the corner and radii, in radii of the microimage, from which the fit starts, and the part of the
# displacement by which the lattice may have followed what is left of the microimages.
_GROWTHS = (-0.6, -0.35, -0.2, 0.2, 0.35, 0.6)
_RADII = (1.0, 1.1, 1.25)
_FOLLOWED = (0.0, 0.4)
_TURNS = 12
# A cut must explain this share of the squared deviations of the rim from a circle, and at least so many px (RMS).
_EXPLAINS, _MATTERS = 0.8, 0.05


@dataclass(frozen=True)
class RimCut:
    """A disc cut by another, both displaced in proportion to the place in the field.

    Parameters
    ----------
    own : float [px]
        Displacement of the microimages themselves in the corner: what the lattice misses.
    shift : (2,) float64 [px]
    growth, radius : float [px]
        As of `CatEye`.
    """

    own: float
    shift: NDArray[np.float64]
    growth: float
    radius: float


def _rim(
    parameters: NDArray[np.float64], field: NDArray[np.float64], along: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, d) distance from the centre to the rim of an own disc cut by another."""
    own, radius, growth, cutting, sx, sy = parameters
    nearest = np.full((len(field), len(along)), np.inf)
    for centre, r in ((own * field, radius), (growth * field + (sx, sy), cutting)):
        ahead = centre @ along.T
        aside = (centre**2).sum(1)[:, None] - ahead**2
        nearest = np.minimum(nearest, ahead + np.sqrt(np.maximum(r * r - aside, 0)))
    return nearest


def find_rim_cut(rim: NDArray[np.float64], weight: NDArray[np.float64], field: NDArray[np.float64]) -> RimCut | None:
    """The cut that explains where rims lie, or None where they are as good as round.

    Parameters
    ----------
    rim, weight : (n, d) float64 [px]
        Distance of the rim from the centre in `d` directions, counted from +x clockwise on the screen, in `n` parts
        of the field, and how much each counts.
    field : (n, 2) float64
        Where the parts lie, of length 1 in the corners.
    """
    angle = np.arange(rim.shape[1]) * 2 * np.pi / rim.shape[1]
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    mean = float(np.average(rim, weights=weight))
    widest = float(np.percentile(rim[weight > 0], 90))
    plain = float(np.average((rim - mean) ** 2, weights=weight))
    if plain < _MATTERS**2:
        return None

    def misfit(p: NDArray[np.float64]) -> float:
        return float(np.average((rim - _rim(p, field, along)) ** 2, weights=weight))

    starts = [
        np.array([-f * g * widest, widest, (1 - f) * g * widest, r * widest, 0.0, 0.0])
        for g in _GROWTHS for r in _RADII for f in _FOLLOWED
    ]  # fmt: skip
    best = min(starts, key=misfit)
    least, damping = misfit(best), 1e-2
    root = np.sqrt(weight / weight.sum()).ravel()
    for _ in range(_TURNS):
        here = _rim(best, field, along)
        slopes = [root * ((_rim(best + step, field, along) - here) / 1e-3).ravel() for step in 1e-3 * np.eye(6)]
        table = np.column_stack(slopes)
        normal = table.T @ table
        step = np.linalg.solve(
            normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(6), table.T @ (root * (rim - here).ravel())
        )
        trial = best + step
        cost = misfit(trial)
        if cost < least:
            best, least, damping = trial, cost, 0.3 * damping
        else:
            damping *= 5
    if least > (1 - _EXPLAINS) * plain or plain - least < _MATTERS**2:
        return None
    own, _, growth, radius, sx, sy = best
    return RimCut(float(own), np.array([sx, sy]), float(growth), float(radius))
