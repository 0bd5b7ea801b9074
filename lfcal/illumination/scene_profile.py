"""Profile of microimages from scene captures: the content of the scene cancels in sums over many lenses.

On the average a scene is as bright at the rims of microimages as in their middles. The ratio of the summed light at one
distance to that at others is free of it. The mean of ratios within lenses is not: a lens with something bright in its
middle is darker around it more often than not. Types of lenses differ in the blur of their rims: their sums in one part
of the field, where all see the same, are compared.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from ..gain.kernel import RIM_START, evaluate_shape, relative_light
from ..lattice.cell import Cell, is_outside_cell
from ..lattice.lattice import Lattice
from ..runtime.kernels import kernel
from .sample import Sample, draw_sample

__all__ = ["fit_scene_profile", "sum_light"]


class RingSums(NamedTuple):
    """Sums over the distance to the centre, by window of the field and type of lens.

    Parameters
    ----------
    light, weight : (w, t, k) float64
        Of the luminance, and of weights.
    """

    light: NDArray[np.float64]
    weight: NDArray[np.float64]


@kernel(error_model="numpy", share=lambda picture, sample, *_: len(sample.first) - 1)
def _sum_light(begin, end, picture, sample, cell, brightest, shape, types, light, weight):
    """Add up `RingSums`; `types` (n,) are those of the sampled lenses."""
    centres, places, first, stride, reach = (
        sample.centres, sample.places, sample.first, sample.stride, cell.circumradius
    )  # fmt: skip
    profile, step, cut = shape.profile, shape.step, shape.cut
    powers, lens = np.empty(64), np.empty(RIM_START + shape.rim.shape[0])
    total, number = np.empty(len(profile)), np.empty(len(profile))
    for window in range(begin, end):
        for n in range(first[window], first[window + 1]):
            evaluate_shape(centres[n, 0], centres[n, 1], shape, powers, lens)
            cx, cy = places[n, 0], places[n, 1]
            total[:], number[:] = 0.0, 0.0
            clipped, count = 0, 0
            # The content of a scene differs little from row to row.
            for y in range(math.ceil(cy - reach) + n % (2 * stride), math.floor(cy + reach) + 1, 2 * stride):
                dy = y - cy
                half = math.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(math.ceil(cx - half) + (n // stride) % stride, math.floor(cx + half) + 1, stride):
                    dx = x - cx
                    if dx * dx + dy * dy > cell.inradius * cell.inradius and is_outside_cell(dx, dy, cell.normals):
                        continue
                    _, stretched, through = relative_light(dx, dy, lens, profile, step, cut)
                    if through < 0.5:
                        continue
                    v = picture[y, x] * picture[y, x]
                    clipped += v >= brightest
                    count += 1
                    place = stretched / step
                    ring = min(int(place), len(profile) - 2)
                    part = min(place - ring, 1.0)
                    total[ring] += v * (1 - part)
                    total[ring + 1] += v * part
                    number[ring] += through * (1 - part)
                    number[ring + 1] += through * part
            if clipped * 20 <= count:
                for k in range(len(profile)):
                    light[window, types[n], k] += total[k]
                    weight[window, types[n], k] += number[k]


def sum_light(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, brightest: float, sample: Sample,
    types: NDArray[np.int8],
) -> RingSums:  # fmt: skip
    """Sums of the light of a sample of lenses of these `types` (n,); other arguments as of `fit_scene_profile`."""
    shape = len(sample.first) - 1, int(types.max(initial=0)) + 1, len(gain.profile)
    sums = RingSums(np.zeros(shape), np.zeros(shape))
    kernel: Any = _sum_light
    kernel(picture, sample, Cell.of(lattice), brightest, gain.shape(lattice), types, *sums)
    return sums


def fit_scene_profile(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, brightest: float
) -> NDArray[np.float64]:
    """(k,) profile of a gain map with known rims, from a scene capture; 1 wherever that cannot be excluded.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    gain : GainMap
        Its profile is returned if the capture is too dark.
    brightest : float
        Luminance from which on pixels count as clipped.
    """
    sample = draw_sample(lattice, 1e6)
    light, weight = sum_light(picture, lattice, gain, brightest, sample, np.zeros(len(sample.centres), np.int8))
    light, weight = light[:, 0], weight[:, 0]
    rings = np.arange(len(gain.profile))
    core = rings * gain.step < 0.6 * gain.radius
    level = light[:, core].sum(1) / np.maximum(weight[:, core].sum(1), 1e-12)
    bright = level > 0.02 * level.mean()
    if not bright.any():
        return gain.profile
    # A lens has few pixels in its middle: their mean would be noisier than those around it.
    middle = rings * gain.step < 1.5
    for sums in (light, weight):
        sums[:, middle] = sums[:, middle].mean(1, keepdims=True)
    # Each part of the field is weighted by its pixels, not by its light.
    light, weight = light[bright] / level[bright, None], weight[bright]
    pixels = weight.sum(0)
    ratio = light.sum(0) / np.maximum(pixels, 1e-12)
    filled = pixels > 1e-3 * pixels.max()
    profile = np.interp(rings, rings[filled], ratio[filled])
    errors = np.interp(rings, rings[filled], _standard_errors(light, weight)[filled])
    profile = _shrink(profile, errors)
    smooth = np.convolve(np.pad(profile, 2, "edge"), np.ones(5) / 5, "valid")
    even: NDArray[np.float64] = profile / smooth[rings * gain.step < gain.radius].max()
    return even


def _standard_errors(light: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k,) standard error of the profile, from the differences between windows of the field."""
    total = np.maximum(weight.sum(0), 1e-12)
    miss = light - weight * (light.sum(0) / total)
    windows = max(len(light), 2)
    errors: NDArray[np.float64] = np.sqrt((miss**2).sum(0) * windows / (windows - 1)) / total
    return errors


def _shrink(profile: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """The profile with its departures from 1 shrunk by their errors (James and Stein 1961)."""
    away = profile - 1
    kept = np.maximum(1 - (2 * error / np.where(away == 0, 1e-12, away)) ** 2, 0)
    return 1 + away * kept
