"""Residuals of a gain map: pixels of a sample of lenses minus the map.

Of every pixel the residual is `v / g - m`, with its luminance `v`, the light `g` of its lens and the relative light `m`
of the map. The light of a lens is fitted to its inner part first; on scene captures with a plane, and lenses that are
no plane there have little weight.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from .sample import Sample

__all__ = ["Residuals", "clipping_luminance", "collect_residuals"]

Array = NDArray[Any]


class Residuals(NamedTuple):
    """Of those pixels (q,) whose residuals are not outliers."""

    sample: Sample  # those pixels
    error: Array  # (q,)
    weight: Array  # (q,) of the lens
    light: Array  # (q,) relative light of the map
    through: Array  # (q,) share that is not cut off
    plane: Array  # (q,) of the scene
    ring: NDArray[np.int64]  # (q,) sample of the profile before the pixel
    part: Array  # (q,) how far it lies towards the next one
    stray: (
        float  # mean error outside the cutting disc, where there is stray light alone; NaN where there is no such place
    )

    def spread(self, values: Array, rings: int) -> Array:
        """(rings,) sums of values (q,) over the profile, shared out among the two samples about each pixel."""
        sums: Array = np.bincount(self.ring, values * (1 - self.part), rings)
        return sums + np.bincount(self.ring + 1, values * self.part, rings)


def clipping_luminance(value: Array, scene: bool) -> float:
    """Luminance from which on pixels count as clipped; a white image can be as even as if it were."""
    return 0.995 * float(value.max()) if scene else math.inf


def collect_residuals(sample: Sample, gain: GainMap, scene: bool, largest: Array) -> Residuals:
    """Compare a sample of lenses with a gain map; in a scene the light of a lens is a plane.

    Pixels whose residual is above the `largest` (k,) at their distance are left out.
    """
    light, stretched, through = sample.evaluate(gain)
    level, slope, share = _fit_lens_lights(sample, light, (0.6 if scene else 0.5) * gain.radius, scene)
    lens = sample.lens
    plane = np.maximum(1 + slope[0, lens] * sample.x + slope[1, lens] * sample.y, 0.2)
    error, weight = sample.value / level[lens] - light * plane, share[lens]
    behind = (through < 0.02) & (weight > 0)
    stray = float(np.average(error[behind], weights=weight[behind])) if behind.any() else math.nan
    place = stretched / gain.step
    ring = np.minimum(place.astype(np.int64), len(gain.profile) - 2)
    kept = np.flatnonzero((weight > 0) & (np.abs(error) <= largest[ring]))
    part = np.minimum(place - ring, 1.0)
    chosen = (error[kept], weight[kept], light[kept], through[kept], plane[kept])
    return Residuals(sample.select(kept), *chosen, ring[kept], part[kept], stray)


def _fit_lens_lights(sample: Sample, light: Array, core: float, scene: bool) -> tuple[Array, Array, Array]:
    """Light (n,) of each lens, its relative slopes (2, n) [1/px], and its weight: 0 if it is clipped or too steep."""
    inside = np.flatnonzero((np.hypot(sample.x, sample.y) <= core) & (light >= 0.5))
    own = sample.select(inside)
    s, v, clipping = light[inside], own.value, clipping_luminance(sample.value, scene)
    count, clipped = own.add(np.ones_like(v)), own.add((v >= clipping).astype(np.float64))
    total, whole = own.add(s * v), own.add(s * s)
    good = (count >= 4) & (total > 0) & (clipped * 20 <= count)
    level = np.where(good, total / np.maximum(whole, 1e-300), 1.0)
    if not scene:
        return level, np.zeros((2, len(level))), good.astype(np.float64)
    # In a disc about the centre, light and slopes are hardly correlated.
    sides = [own.add(s * d * v) for d in (own.x, own.y)]
    sizes = [np.maximum(own.add(s * s * d * d), 1e-300) for d in (own.x, own.y)]
    slope = np.array([side / size for side, size in zip(sides, sizes, strict=True)]) / level
    good &= (slope**2).sum(0) * core**2 <= 1
    left = own.add(v * v) - total * level - sum(side**2 / size for side, size in zip(sides, sizes, strict=True))
    left = np.maximum(left, 0) / np.maximum(count, 1) / level**2
    # Lenses with little contrast beside a plane, relative to its light, show the rim best.
    contrast = 0.06**2
    return level, np.where(good, slope, 0), np.where(good, contrast / (contrast + left), 0)
