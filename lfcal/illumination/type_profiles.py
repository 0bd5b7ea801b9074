"""Light of the types of a multi-focus array: the profile of each over that of all, where they differ.

Microlenses of another focal length blur the image of the main aperture, and so the rims of their microimages, in
another way. In one part of the field all types see the same: there the sums of their light at one distance to the
centre are compared, each over the light in the middle of its lenses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..gain.gain_map import LEAST_LIGHT, GainMap
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from .estimate import clipping_luminance
from .sample import draw_sample
from .scene_profile import sum_light

__all__ = ["fit_type_profiles", "order_by_rims"]


def fit_type_profiles(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    gain: GainMap,
    types: LensTypes | None,
    scene: bool,
) -> GainMap:
    """The gain map with the light of each type of lens, or as it is if types do not differ significantly.

    Parameters
    ----------
    picture : (h, w) float32, or crops of a white image
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
        With the usable radius of the microimages.
    gain : GainMap
    types : LensTypes or None
    scene : bool
        Whether the flat is a scene capture; on a white image, the light of each lens is in the map.
    """
    if types is None or types.count == 1:
        return gain
    crops = StackedCrops.of(picture)
    sample = draw_sample(lattice, 6e6, crops)
    kinds = types.of(np.rint(lattice.to_index(sample.centres)).astype(np.int64))
    brightest = clipping_luminance(crops.picture, scene)
    light, weight = sum_light(crops.picture, lattice, gain, brightest, sample, kinds)
    radii = np.arange(len(gain.profile)) * gain.step
    core = radii < 0.5 * lattice.radius
    number = weight[..., core].sum(-1)
    level = light[..., core].sum(-1) / np.maximum(number, 1e-12)
    seen = (number > 0).all(1) & (level.min(1) > 0.02 * level.mean())
    if level.shape[1] != types.count or seen.sum() < 4:
        return gain
    light, weight, level = light[seen] / level[seen][..., None], weight[seen], level[seen]
    # A lens has few pixels in its middle: their mean would be noisier than those around it.
    middle = radii < 1.5
    for sums in (light, weight):
        sums[..., middle] = sums[..., middle].mean(-1, keepdims=True)
        sums[:] = _smooth(sums, max(1, round(1.25 / gain.step)))
    factor = 1 + _significant(light / np.maximum(weight, 1e-12), weight.min(1))
    # Rims are measured as far as there is light in them.
    last = np.flatnonzero((weight.sum((0, 1)) > 0) & (gain.profile > LEAST_LIGHT))[-1]
    factor[:, last:] = factor[:, [last]]
    if scene:
        factor *= 1 + _significant(level[..., None], number[seen].min(1)[:, None])
    factor = np.clip(factor, 0.5, 2)
    if np.abs(factor[:, radii < lattice.radius] - 1).max() < 0.005:
        return gain
    return replace(gain, type_light=factor, type_cell=types.cell)


def order_by_rims(types: LensTypes | None, gain: GainMap, radius: float) -> tuple[LensTypes | None, GainMap]:
    """The `ordered` types of a white image and their gain map, from the softest rims to the hardest where these differ.

    Rims are images of the main aperture, at `s = 0`: the farther from that a type is focused, the softer is its rim,
    and the less light is left before it (`radius` [px]: usable).
    """
    if types is None or not types.ordered or not gain.type_light.size:
        return types, gain
    rims = gain.type_rims(radius)
    rims = rims[:, np.ptp(rims, axis=0).argmax()]
    order = np.argsort(rims)
    if np.diff(rims[order]).min() < 0.005:
        return types, gain
    cell = np.argsort(order)[types.cell].astype(np.int8)
    ordered = LensTypes(cell, True, types.focus[order] if types.focus is not None else None, types.confidence)
    return ordered, replace(gain, type_light=gain.type_light[order], type_cell=cell)


def _smooth(sums: NDArray[np.float64], rings: int) -> NDArray[np.float64]:
    """Mean over neighbouring rings."""
    half = rings // 2
    wide = np.pad(sums, [(0, 0)] * (sums.ndim - 1) + [(half, half)], "edge")
    return np.mean([wide[..., k : k + sums.shape[-1]] for k in range(2 * half + 1)], axis=0)


def _significant(light: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """(t, k) differences of the light (w, t, k) of types from their mean, shrunk by their errors (James, Stein 1961).

    `weight` (w, k) is that of each window of the field.
    """
    relative = light / np.maximum(light.mean(1, keepdims=True), 1e-12) - 1
    total = np.maximum(weight.sum(0), 1e-12)
    mean = (relative * weight[:, None]).sum(0) / total
    error = np.sqrt((((relative - mean) * weight[:, None]) ** 2).sum(0) * len(light) / (len(light) - 1)) / total
    kept = mean * np.maximum(1 - (2 * error / np.maximum(np.abs(mean), 1e-12)) ** 2, 0)
    return np.asarray(kept)
