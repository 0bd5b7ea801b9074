"""Find the disc that cuts microimages (cat-eye) from where their rims lie in parts of the field.

Where lens shapes are cut from two discs, either could be the microimage: rims are the same with both in each other's
place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RimFit", "fit_best_rim", "fit_rims"]

# Displacements in the corner and radii, in radii of the microimage, from which the fit starts, and the part of the
# displacement by which the lattice may have followed what is left of the microimages.
_GROWTHS = (0.15, 0.35, 0.6)
_RADII = (1.0, 1.1, 1.25)
_FOLLOWED = (0.0, 0.4)
_TURNS = 12
# Step by which slopes are taken [px], and the share by which the squares must fall for another turn.
_NUDGE, _ENOUGH = 1e-3, 1e-4
# Where two rims cross, blur takes light from both: so many px there, times the logarithm of 2, of edges that are half a
# pixel soft and mostly blurred together.
_CROSSING = 0.22
# Cuts whose rims differ in the mean square by less than this share of what one leaves over are the same.
_OTHER = 0.1
# A cut must explain this share of the squared deviations of the rim from a circle, and at least so many px (RMS).
_EXPLAINS, _MATTERS = 0.8, 0.05


@dataclass(frozen=True)
class RimFit:
    """A disc cut by another, both displaced in proportion to the place in the field.

    Parameters
    ----------
    own, whole : float [px]
        Displacement of the microimages themselves in the corner, what the lattice misses, and their radius.
    shift : (2,) float64 [px]
    growth, radius : float [px]
        As of `CatEye`.
    left : float [px^2]
        Mean square of what the rims are off it.
    """

    own: float
    whole: float
    shift: NDArray[np.float64]
    growth: float
    radius: float
    left: float


def _rim(
    parameters: NDArray[np.float64], field: NDArray[np.float64], along: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, d) distance from the centre to the rim of an own disc cut by another."""
    own, radius, growth, cutting, sx, sy = parameters
    rims = []
    for centre, r in ((own * field, radius), (growth * field + (sx, sy), cutting)):
        ahead = centre @ along.T
        aside = (centre**2).sum(1)[:, None] - ahead**2
        rims.append(ahead + np.sqrt(np.maximum(r * r - aside, 0)))
    apart = np.abs(rims[0] - rims[1])
    return np.asarray(np.minimum(*rims) - _CROSSING * np.log1p(np.exp(-apart / _CROSSING)))


def fit_best_rim(rim: NDArray[np.float64], weight: NDArray[np.float64], field: NDArray[np.float64]) -> RimFit | None:
    """The first of `fit_rims`, or None where rims are as good as round, or no pixel shows any."""
    if not weight.any():
        return None
    mean = float(np.average(rim, weights=weight))
    plain = float(np.average((rim - mean) ** 2, weights=weight))
    if plain < _MATTERS**2:
        return None
    found = fit_rims(rim, weight, field)[0]
    return None if found.left > (1 - _EXPLAINS) * plain or plain - found.left < _MATTERS**2 else found


def fit_rims(rim: NDArray[np.float64], weight: NDArray[np.float64], field: NDArray[np.float64]) -> list[RimFit]:
    """Cuts that explain where rims lie, the best one first: of discs displaced inwards and outwards.

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
    widest = float(np.percentile(rim[weight > 0], 90))
    share = weight / weight.sum()

    def misfit(p: NDArray[np.float64]) -> float:
        return float((share * (rim - _rim(p, field, along)) ** 2).sum())

    found: list[tuple[RimFit, NDArray[np.float64]]] = []
    for growths in (_GROWTHS, [-g for g in _GROWTHS]):
        starts = [
            np.array([-f * g * widest, widest, (1 - f) * g * widest, r * widest, 0.0, 0.0])
            for g in growths for r in _RADII for f in _FOLLOWED
        ]  # fmt: skip
        best, left = _settled(min(starts, key=misfit), rim, share, field, along)
        own, whole, growth, radius, sx, sy = best.tolist()
        rims = _rim(best, field, along)
        # Discs of one size may be found twice, each in the other's place.
        if all((share * (rims - other) ** 2).sum() > _OTHER * left for _, other in found):
            found.append((RimFit(own, whole, np.array([sx, sy]), growth, radius, left), rims))
    return sorted((cut for cut, _ in found), key=lambda cut: cut.left)


def _settled(
    best: NDArray[np.float64], rim: NDArray[np.float64], share: NDArray[np.float64], field: NDArray[np.float64],
    along: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:  # fmt: skip
    """Parameters of `_rim` by damped least squares (Marquardt 1963), and the mean square that is left."""
    root = np.sqrt(share)
    miss = root * (rim - _rim(best, field, along))
    least, damping = float((miss**2).sum()), 1e-2
    fresh = True
    for _ in range(_TURNS):
        if fresh:
            table = np.column_stack(
                [
                    ((root * (rim - _rim(best + step, field, along)) - miss) / -_NUDGE).ravel()
                    for step in _NUDGE * np.eye(6)
                ]
            )
            normal, force = table.T @ table, table.T @ miss.ravel()
        trial = best + np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(6), force)
        left = root * (rim - _rim(trial, field, along))
        cost = float((left**2).sum())
        fresh = cost < least
        if fresh:
            done = least - cost < _ENOUGH * least
            best, least, miss, damping = trial, cost, left, 0.3 * damping
            if done:
                break
        else:
            damping *= 5
    return best, least
