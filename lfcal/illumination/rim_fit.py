"""Two discs that cut each other, fitted to the rims of microimages in parts of the field.

Both discs are displaced in proportion to the position in the field; the rim is where the first of them ends. Rims are
the same with the two discs interchanged: which of them is the microimage is not decided here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .settings import RIMS

__all__ = ["RimFit", "fit_best_rim", "fit_rims"]


@dataclass(frozen=True)
class RimFit:
    """A disc cut by another."""

    lattice_growth: float  # [px] displacement of the microimages themselves in the corner, which the lattice misses
    disc_radius: float  # [px] of the microimages
    shift: NDArray[np.float64]  # (2,) [px] as of `CatEye`
    growth: float  # [px] as of `CatEye`
    radius: float  # [px] as of `CatEye`
    residual: float  # [px^2] mean squared residual of the rims


def fit_best_rim(rim: NDArray[np.float64], weight: NDArray[np.float64], field: NDArray[np.float64]) -> RimFit | None:
    """The best of `fit_rims`, or None if rims are as good as circular, or no pixel shows any."""
    if not weight.any():
        return None
    mean = float(np.average(rim, weights=weight))
    circle = float(np.average((rim - mean) ** 2, weights=weight))
    if circle < RIMS.least_effect**2:
        return None
    best = fit_rims(rim, weight, field)[0]
    gain = circle - best.residual
    clear = best.residual <= (1 - RIMS.explained) * circle and gain >= RIMS.least_effect**2
    return best if clear else None


def fit_rims(rim: NDArray[np.float64], weight: NDArray[np.float64], field: NDArray[np.float64]) -> list[RimFit]:
    """Pairs of discs that explain the rims, the best one first: with the cut displaced outwards, and inwards.

    Parameters
    ----------
    rim, weight : (n, d) float64 [px]
        Distance of the rim from the centre in `d` directions, counted from +x clockwise on the screen, in `n` parts
        of the field, and weights of these distances.
    field : (n, 2) float64
        Where the parts lie, of length 1 in the corners.
    """
    angle = np.arange(rim.shape[1]) * 2 * np.pi / rim.shape[1]
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    widest = float(np.percentile(rim[weight > 0], 90))
    share = weight / weight.sum()

    def cost(p: NDArray[np.float64]) -> float:
        return float((share * (rim - _predict_rim(p, field, along)) ** 2).sum())

    found: list[tuple[RimFit, NDArray[np.float64]]] = []
    for growths in (RIMS.start_growths, [-g for g in RIMS.start_growths]):
        starts = [
            np.array([-f * g * widest, widest, (1 - f) * g * widest, r * widest, 0.0, 0.0])
            for g in growths for r in RIMS.start_radii for f in RIMS.start_shares
        ]  # fmt: skip
        best, left = _levenberg_marquardt(min(starts, key=cost), rim, share, field, along)
        own, disc, growth, radius, sx, sy = best.tolist()
        rims = _predict_rim(best, field, along)
        # Discs of one size may be found twice, once interchanged.
        if all((share * (rims - other) ** 2).sum() > RIMS.distinct * left for _, other in found):
            found.append((RimFit(own, disc, np.array([sx, sy]), growth, radius, left), rims))
    return sorted((fit for fit, _ in found), key=lambda fit: fit.residual)


def _predict_rim(
    parameters: NDArray[np.float64], field: NDArray[np.float64], along: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, d) distance from the centre to the nearer of two discs' edges, rounded where these cross."""
    own, radius, growth, cut_radius, sx, sy = parameters
    rims = []
    for centre, r in ((own * field, radius), (growth * field + (sx, sy), cut_radius)):
        ahead = centre @ along.T
        aside = (centre**2).sum(1)[:, None] - ahead**2
        rims.append(ahead + np.sqrt(np.maximum(r * r - aside, 0)))
    apart = np.abs(rims[0] - rims[1])
    return np.asarray(np.minimum(*rims) - RIMS.crossing * np.log1p(np.exp(-apart / RIMS.crossing)))


def _levenberg_marquardt(
    best: NDArray[np.float64], rim: NDArray[np.float64], share: NDArray[np.float64], field: NDArray[np.float64],
    along: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float]:  # fmt: skip
    """Parameters of `_predict_rim` by damped least squares (Marquardt 1963), and the mean squared residual."""
    root = np.sqrt(share)
    miss = root * (rim - _predict_rim(best, field, along))
    least, damping = float((miss**2).sum()), 1e-2
    fresh = True
    for _ in range(RIMS.passes):
        if fresh:
            nearby = (rim - _predict_rim(best + step, field, along) for step in RIMS.difference * np.eye(6))
            table = np.column_stack([((root * other - miss) / -RIMS.difference).ravel() for other in nearby])
            normal, force = table.T @ table, table.T @ miss.ravel()
        trial = best + np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(6), force)
        left = root * (rim - _predict_rim(trial, field, along))
        cost = float((left**2).sum())
        fresh = cost < least
        if fresh:
            done = least - cost < RIMS.converged * least
            best, least, miss, damping = trial, cost, left, 0.3 * damping
            if done:
                break
        else:
            damping *= 5
    return best, least
