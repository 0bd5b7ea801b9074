"""Edge of a microimage in its radial profile: where it is, how far it is blurred, and the shape of the blur.

Light falls across the edge like the cumulative distribution of the blur. Its normal score is therefore the distance
from the edge in units of the blur: a straight line for a normal distribution, curved where tails are longer or shorter.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .settings import PIXELS

__all__ = ["edge_depths", "estimate_edge_blur", "find_edge"]


def find_edge(profile: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(r,) where a profile falls from the disc into the gap."""
    slope = -np.gradient(profile)
    core = float(np.median(profile[: max(2, len(profile) // 2)]))
    half = 0.5 * (core + float(np.quantile(profile, 0.1)))
    crossing = int(np.argmax(profile < half))
    near = np.s_[max(crossing - 2, 0) : crossing + 2]
    gentle = np.flatnonzero(slope < PIXELS.steep * slope[near].max())
    edge = np.ones(len(profile), dtype=bool)
    edge[: gentle[gentle < crossing - 1].max(initial=-1) + 1] = False
    edge[gentle[gentle > crossing].min(initial=len(profile)) :] = False
    return edge


def edge_depths(profile: NDArray[np.float64], edge: NDArray[np.bool_], gap: float, step: float) -> NDArray[np.float64]:
    """(r,) depth inside the microimage of each radius, in units of the blur of its edge: the normal score of the light.

    `profile` (r,) is the light at radii `0, step, 2*step...` [px], `edge` where it falls to the light in the `gap`.
    """
    radii = np.arange(len(profile)) * step
    within = np.s_[: max(int(np.argmax(edge)) - 1, 1)]
    # Light inside a microimage falls with the square of the radius, and goes on to do so on its edge.
    table = np.column_stack([np.ones(len(radii)), radii**2])[:, : 1 + (len(radii[within]) > PIXELS.fewest_rings)]
    root = np.sqrt(radii[within] + step)
    inside = table @ np.linalg.lstsq(table[within] * root[:, None], profile[within] * root, rcond=None)[0]
    return np.asarray(np.interp((profile - gap) / np.maximum(inside - gap, 1e-12), *_normal_scores()))


def estimate_edge_blur(depths: NDArray[np.float64], edge: NDArray[np.bool_], step: float) -> tuple[float, float] | None:
    """Standard deviation of the blur [px] and its tail, None where hardly a ring lies on the edge.

    `depths` (r,) are those of `edge_depths`. The tail is the factor of the third Hermite polynomial in the normal score
    (Cornish and Fisher 1938): positive where tails are shorter than normal.
    """
    near = np.convolve(edge, np.ones(2 * PIXELS.beside + 1), "same") > 0
    on_edge = np.flatnonzero(near & (np.abs(depths) < PIXELS.used_depth))
    if len(on_edge) < PIXELS.fewest_rings:
        return None
    score, weight = depths[on_edge], np.exp(-0.5 * depths[on_edge] ** 2)
    table = np.column_stack([np.ones(len(on_edge)), on_edge * step])
    inverse = np.linalg.pinv(table * weight[:, None])
    tail, hermite = 0.0, np.zeros(len(on_edge))
    for _ in range(PIXELS.blur_rounds):
        line = inverse @ (weight * (score - tail * hermite))
        straight = table @ line
        hermite = (straight**2 - 3) * straight
        tail = float(weight**2 * hermite @ (score - straight) / max(float(weight**2 * hermite @ hermite), 1e-12))
        tail = min(max(tail, PIXELS.least_tail), PIXELS.most_tail)
    return (-1 / float(line[1]), tail) if line[1] < 0 else None


@lru_cache(1)
def _normal_scores() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Light through a blurred edge at a row of depths, and these depths."""
    depths = np.linspace(-PIXELS.deepest, PIXELS.deepest, 2001)
    return np.array([0.5 * math.erfc(-depth * math.sqrt(0.5)) for depth in depths.tolist()]), depths
