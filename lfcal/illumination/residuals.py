"""Residuals of a gain map: pixels of a sample of lenses minus the map.

The lenses are spread over windows of the field.

Of every pixel the residual is `v / g - m`, with its luminance `v`, the light `g` of its lens and
the relative light `m` of the map. The light of a lens is fitted to its inner part first; on scene
captures with a plane, and lenses that are no plane there have little weight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..gain.gain_map import GainMap, count_terms, field_monomials
from ..images.stack import CLIPPED_LIGHT
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_mask
from ..microimage.average import LensPixels, ProfilePlaces
from ..microimage.lit import bright_light
from ..runtime.arrays import Array, Integers, Singles

__all__ = [
    "CLIPPED_PIXELS",
    "CORES",
    "Residuals",
    "Sample",
    "collect_residuals",
    "draw_sample",
]

# Pixels that remain of each lens where rows and columns are left out.
_PIXELS_OF_LENS = 700
# Lenses of a sample, at least.
_FEWEST_LENSES = 200
# Windows of the field each way, if six lenses fall into each.
_WINDOWS = np.array([8, 6])
# Terms of third order in the field.
_TERMS = count_terms(3)
#: [radius] Disc in the middle in which the light of a lens is measured, on scenes and white images.
CORES = (0.6, 0.5)
# Least light of a plane over that in the middle, and light through the cutting disc behind it.
_LEAST_PLANE = 0.2
_BEHIND = 0.02
# Lenses of scenes with this squared contrast beside a plane have half the weight of even ones.
_CONTRAST = 0.06**2
#: A lens is used if at most one of this number of its pixels is clipped.
CLIPPED_PIXELS = 20


class Sample(NamedTuple):
    """Pixels (p,) of lenses (n,)."""

    indices: Integers  # (n, 2) of the lattice
    field: Array  # (n, 2) places of the lenses in the field
    terms: Array  # (n, 10) their `field_monomials`
    window: Integers  # (n,) of the field that each lens lies in
    pixels: LensPixels  # (p,) luminance
    clipping: float  # luminance from which on pixels count as clipped; infinite for white images

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.window.max(initial=-1)) + 1

    def evaluate(self, gain: GainMap) -> Array:
        """(3, p) relative light of each pixel, distance on the profile [px], share not cut off."""
        own = self.pixels
        return gain.evaluate(gain.describe(self.field), own.lens, own.x, own.y)

    def select(self, pixels: Integers) -> Sample:
        """Some of the pixels."""
        return self._replace(pixels=self.pixels.select(pixels))

    def add(self, values: Array) -> Array:
        """(n,) sums over the pixels of each lens."""
        return np.bincount(self.pixels.lens, values, len(self.field))


def draw_sample(
    lattice: Lattice, picture: Singles | StackedCrops, pixels: float, scene: bool, step: int = 1
) -> Sample:
    """Sample of the lenses of a flat, or of crops of it, with about so many pixels.

    `picture` is the square root of the luminance. Of large lenses rows and columns are left out;
    with a `step` of 2 every other row, as the content of scenes differs little from row to row.
    """
    crops = StackedCrops.of(picture)
    cell = Cell.of(lattice)
    area = abs(float(np.linalg.det(lattice.basis)))
    stride = max(1, int(math.sqrt(area / _PIXELS_OF_LENS)))
    margin = cell.circumradius + 1
    wanted = max(pixels * stride**2 / area, _FEWEST_LENSES)
    indices, centres, crop = crops.lenses(lattice, margin)
    chosen = sample_mask(len(centres), wanted / max(len(centres), 1))
    centres = centres[chosen]
    places = centres - crops.offsets[crop[chosen]]
    shrink = min(1.0, math.sqrt(len(centres) / (6 * _WINDOWS.prod())))
    shape = np.maximum(1, _WINDOWS * shrink).astype(int)
    column, row = np.minimum((centres + 0.5) / lattice.image_size * shape, shape - 1).astype(int).T
    window = np.unique(row * shape[0] + column, return_inverse=True)[1].ravel()
    own = LensPixels.of(crops.picture, places, cell, (stride, stride * step))
    own = own._replace(value=own.value**2)
    field = lattice.field_place(centres)
    terms = field_monomials(field, _TERMS)
    clipping = CLIPPED_LIGHT * float(own.value.max()) if scene else math.inf
    return Sample(indices[chosen], field, terms, window, own, clipping)


class Residuals(NamedTuple):
    """Of those pixels (q,) whose residuals are not outliers."""

    sample: Sample  # those pixels
    error: Array  # (q,)
    weight: Array  # (q,) of the lens
    light: Array  # (q,) relative light of the map
    through: Array  # (q,) share that is not cut off
    plane: Array  # (q,) of the scene
    places: ProfilePlaces  # (q,) on the profile
    # mean error outside the cutting disc, where there is stray light alone; NaN where there is no
    # such place
    stray: float

    def select(self, pixels: Integers) -> Residuals:
        """Some of the pixels."""
        of_pixels = ("error", "weight", "light", "through", "plane")
        chosen = {name: getattr(self, name)[pixels] for name in of_pixels}
        return self._replace(
            sample=self.sample.select(pixels), places=self.places.select(pixels), **chosen
        )


def collect_residuals(sample: Sample, gain: GainMap, scene: bool, largest: Array) -> Residuals:
    """Compare a sample of lenses with a gain map; in a scene the light of a lens is a plane.

    Pixels whose residual is above the `largest` (k,) at their distance are left out.
    """
    light, stretched, through = sample.evaluate(gain)
    core = CORES[0] if scene else CORES[1]
    level, slope, share = _fit_lens_lights(sample, light, core * gain.radius, scene)
    lens, x, y, value = sample.pixels
    plane = np.maximum(1 + slope[0, lens] * x + slope[1, lens] * y, _LEAST_PLANE)
    error = value / level[lens] - light * plane
    weight = share[lens]
    behind = (through < _BEHIND) & (weight > 0)
    stray = math.nan
    if behind.any():
        stray = float(np.average(error[behind], weights=weight[behind]))
    places = ProfilePlaces.of(stretched / gain.step, len(gain.profile))
    kept = np.flatnonzero((weight > 0) & (np.abs(error) <= largest[places.before]))
    whole = Residuals(sample, error, weight, light, through, plane, places, stray)
    return whole.select(kept)


def _fit_lens_lights(
    sample: Sample, light: Array, core: float, scene: bool
) -> tuple[Array, Array, Array]:
    """Light (n,) of each lens, its relative slopes (2, n) [1/px], and its weight.

    The weight is 0 for lenses that are clipped or too steep.
    """
    inside = np.flatnonzero((sample.pixels.distance() <= core) & (light >= 0.5))
    own = sample.select(inside)
    s = light[inside]
    _, x, y, v = own.pixels
    count = own.add(np.ones_like(v))
    clipped = own.add((v >= sample.clipping).astype(np.float64))
    total = own.add(s * v)
    whole = own.add(s * s)
    good = (count >= 4) & (total > 0) & (clipped * CLIPPED_PIXELS <= count)
    level = np.where(good, total / np.maximum(whole, 1e-300), 1.0)
    if not scene:
        # The noise of light grows with its root.
        share = level / max(bright_light(level[good]), 1e-300)
        return level, np.zeros((2, len(level))), np.where(good, np.minimum(share, 1), 0)
    # In a disc about the centre, light and slopes are hardly correlated.
    sides = [own.add(s * d * v) for d in (x, y)]
    sizes = [np.maximum(own.add(s * s * d * d), 1e-300) for d in (x, y)]
    slope = np.array([side / size for side, size in zip(sides, sizes, strict=True)]) / level
    good &= (slope**2).sum(0) * core**2 <= 1
    left = (
        own.add(v * v)
        - total * level
        - sum(side**2 / size for side, size in zip(sides, sizes, strict=True))
    )
    left = np.maximum(left, 0) / np.maximum(count, 1) / level**2
    # Lenses with little contrast beside a plane, relative to its light, show the rim best.
    share = np.where(good, _CONTRAST / (_CONTRAST + left), 0)
    return level, np.where(good, slope, 0), share
