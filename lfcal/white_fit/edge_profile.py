"""How blurred the edge of a microimage is, as its profile over the radius shows."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["edge_blur", "edge_depths"]

# Light that is nearer to none or all of it than a thousandth, which is here, says no more of how deep a place lies.
_DEEPEST = 3.09
# Places are told by their light up to so deep; fewer rings than that tell no blur.
_TOLD, _FEWEST = 2.3, 5
# Rings beside the edge that may still belong to it.
_BESIDE = 2
# The blur of uniform discs and squares has a steepness of 0.05, of normal ones none, of tails that are longer less.
_STEEPEST = (-0.03, 0.06)
_ROUNDS = 4


def edge_depths(level: NDArray[np.float64], edge: NDArray[np.bool_], dark: float, step: float) -> NDArray[np.float64]:
    """(r,) how deep inside the microimage each radius lies, in units of the blur of its edge: the normal score.

    Parameters
    ----------
    level : (r,) float64
        Profile at radii `0, step, 2*step...`.
    edge : (r,) bool
        Where it falls from the disc into the gap.
    dark : float
        Light in the gap.
    step : float [px]
    """
    radii = np.arange(len(level)) * step
    within = np.s_[: max(int(np.argmax(edge)) - 1, 1)]
    # Light inside of microimages falls with the square of the radius, and goes on to do so on their edge.
    table = np.column_stack([np.ones(len(radii)), radii**2])[:, : 1 + (len(radii[within]) > _FEWEST)]
    root = np.sqrt(radii[within] + step)
    light = table @ np.linalg.lstsq(table[within] * root[:, None], level[within] * root, rcond=None)[0]
    return np.asarray(np.interp((level - dark) / np.maximum(light - dark, 1e-12), *_normal_scores()))


def edge_blur(deep: NDArray[np.float64], edge: NDArray[np.bool_], step: float) -> tuple[float, float] | None:
    """Standard deviation of the blur [px], and by how much its tails are shorter than normal ones.

    That is the factor of the third Hermite polynomial in the normal score (Cornish and Fisher 1938). None where
    hardly a ring of `deep` (`edge_depths`) lies on the edge.
    """
    near = np.convolve(edge, np.ones(2 * _BESIDE + 1), "same") > 0
    on_edge = np.flatnonzero(near & (np.abs(deep) < _TOLD))
    if len(on_edge) < _FEWEST:
        return None
    score, weight = deep[on_edge], np.exp(-0.5 * deep[on_edge] ** 2)
    table = np.column_stack([np.ones(len(on_edge)), on_edge * step])
    inverse = np.linalg.pinv(table * weight[:, None])
    steep, bend = 0.0, np.zeros(len(on_edge))
    for _ in range(_ROUNDS):
        line = inverse @ (weight * (score - steep * bend))
        place = table @ line
        bend = (place**2 - 3) * place
        steep = float(weight**2 * bend @ (score - place) / max(float(weight**2 * bend @ bend), 1e-12))
        steep = min(max(steep, _STEEPEST[0]), _STEEPEST[1])
    return (-1 / float(line[1]), steep) if line[1] < 0 else None


@lru_cache(1)
def _normal_scores() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Light through a blurred edge, and how deep inside it each is, in units of the blur."""
    deep = np.linspace(-_DEEPEST, _DEEPEST, 2001)
    return np.array([0.5 * math.erfc(-value * math.sqrt(0.5)) for value in deep.tolist()]), deep
