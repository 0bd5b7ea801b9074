"""Profiles of microimages from sums over many lenses: of scenes, and of lens types.

On the average a scene is as bright at the rims of microimages as in their middles. The ratio of the
summed light at one distance to that at others is free of it. The mean of ratios within lenses is
not: a lens with something bright in its middle is darker around it more often than not. A scene of
bright objects before black can be brighter at the rims by its content. No lens is: profiles never
rise towards the rim, and where the scene does, its light is not measured. Microlenses
of another focal length blur the image of the main aperture, and so the rims of their microimages,
in another way: their sums in one part of the field, where all types see the same, are compared.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..gain.gain_map import BEFORE_RIM, GainMap, Vignetting, first_half, nearest_half
from ..lattice.lattice import Lattice
from ..microimage.average import ProfilePlaces, average_profile
from ..microimage.lit import UNLIT, is_lit
from ..runtime.arrays import Floats, evenly
from ..runtime.errors import CalibrationError
from .residuals import CLIPPED_PIXELS, CORES, Sample

__all__ = [
    "ProfilePixels",
    "SceneProfiles",
    "average_vignetting",
    "fit_scene_profiles",
    "fit_type_profiles",
    "order_by_rims",
]

# Weight of rings without pixels in the fit of a falling profile, over that of the fullest one.
_LEAST_WEIGHT = 1e-3
# [px] Width over which profiles of types are smoothed.
_SMOOTH = 1.25
# Relative difference of the light of types that matters.
_LEAST = 0.005
# [limit] Radius below which light is not taken for the rim.
_INNER = 0.3
# Lenses over which the vignetting is averaged.
_LENSES = 64
# Windows of the field from whose scatter the error of a profile follows.
_FEWEST_WINDOWS = 4
# RMS rise of a scene towards the rims, over its light, from which on it is no light of lenses.
# Scenes that agree with their white images have up to 0.01, those whose profiles would be wrong
# 0.04 to 0.4.
_CONTENT = 0.03


class ProfilePixels(NamedTuple):
    """Lit pixels (p,) of lenses (n,) without clipped ones, and their places on the profile."""

    sample: Sample  # pixels, not cut off by more than half
    through: Floats  # (p,) share that is not cut off
    places: ProfilePlaces  # (p,) on the profile

    @classmethod
    def of(cls, sample: Sample, gain: GainMap) -> ProfilePixels:
        """Those of a sample.

        They depend on the rim and the cutting disc of the gain map, not on its profile.
        """
        _, stretched, through = sample.evaluate(gain)
        lit = through >= 0.5
        clipped = (sample.pixels.value >= sample.clipping) & lit
        whole = sample.add(clipped.astype(np.float64)) * CLIPPED_PIXELS <= sample.add(
            lit.astype(np.float64)
        )
        chosen = np.flatnonzero(lit & whole[sample.pixels.lens])
        places = ProfilePlaces.of(stretched[chosen] / gain.step, len(gain.profile))
        return cls(sample.select(chosen), through[chosen], places)

    def sum_windows(
        self, gain: GainMap, types: NDArray[np.int8], core: float
    ) -> tuple[Floats, Floats]:
        """Light over that of the core (w, t, k), and its weight.

        Windows without light are left out.

        `core` [px] is its radius; `types` (n,) are those of the lenses.
        """
        sample = self.sample
        shape = sample.windows, int(types.max(initial=0)) + 1, len(gain.profile)
        size = math.prod(shape)
        first = (shape[2] * (types + shape[1] * sample.window))[sample.pixels.lens]
        light, weight = (
            self.places.add(values, size, first).reshape(shape)
            for values in (sample.pixels.value, self.through)
        )
        radii = np.arange(shape[2]) * gain.step
        number = weight[..., radii < core].sum(-1)
        level = light[..., radii < core].sum(-1) / np.maximum(number, 1e-12)
        bright = (number > 0).all(1) & (is_lit(level.min(1), UNLIT))
        # A lens has few pixels in its middle: their mean would be noisier than those around it.
        for sums in (light, weight):
            sums[..., radii < 1.5] = sums[..., radii < 1.5].mean(-1, keepdims=True)
        return light[bright] / level[bright][..., None], weight[bright]


def _shrunk_mean(values: Floats, weight: Floats) -> Floats:
    """Means (...) of values (w, ...) over windows of the field, shrunk by their errors.

    James and Stein (1961).
    """
    total = np.maximum(weight.sum(0), 1e-12)
    mean = (values * weight).sum(0) / total
    windows = max(len(values), 2)
    error = np.sqrt((((values - mean) * weight) ** 2).sum(0) * windows / (windows - 1)) / total
    return np.asarray(mean * np.maximum(1 - (2 * error / np.maximum(np.abs(mean), 1e-12)) ** 2, 0))


class SceneProfiles(NamedTuple):
    """Profiles (k,) of a gain map with known rims, from a scene."""

    # Mean light of the scene, 1 wherever that cannot be excluded. It is what lenses have in common
    # when they are compared. If microimages fill their cells, their rims have light of neighbours,
    # and it rises there.
    mean: Floats
    # Light of the lenses, which pictures are divided by: it never rises. If the scene does not
    # show it, it is 1 before the rim.
    light: Floats
    shown: bool


def fit_scene_profiles(found: ProfilePixels, gain: GainMap) -> SceneProfiles:
    """Profiles from the sums over many lenses of a scene.

    If the light rises already in the middle of microimages, it is that of objects: the mean falls,
    too.
    """
    from scipy.optimize import isotonic_regression

    types = np.zeros(len(found.sample.field), np.int8)
    core = CORES[0] * gain.radius
    light, weight = found.sum_windows(gain, types, core)
    pixels = weight.sum((0, 1))
    mean = gain.profile
    shown = len(light) >= _FEWEST_WINDOWS
    rings = np.arange(len(mean))
    if shown:
        ratio = light[:, 0] / np.maximum(weight[:, 0], 1e-12)
        mean = 1 + average_profile(_shrunk_mean(ratio - 1, weight[:, 0]) * pixels, pixels)
    pixels = np.maximum(pixels, _LEAST_WEIGHT * max(float(pixels.max()), 1.0))
    falling = isotonic_regression(mean, weights=pixels, increasing=False).x

    def rises(radius: float) -> bool:
        inside = rings * gain.step < radius
        even = isotonic_regression(mean[inside], weights=pixels[inside], increasing=False).x
        return bool(np.average((mean[inside] - even) ** 2, weights=pixels[inside]) > _CONTENT**2)

    shown &= not rises(gain.radius)
    falling /= max(float(falling[0]), 1e-9)
    if not shown:
        falling[falling > BEFORE_RIM] = 1
    return SceneProfiles(falling if rises(core) else mean, falling, shown)


def fit_type_profiles(
    found: ProfilePixels, radius: float, gain: GainMap, types: LensTypes
) -> GainMap:
    """Add the light of each lens type to the gain map.

    The map is returned unchanged if the types do not differ significantly.

    `radius` [px] is the usable one. The profiles of types differ in shape, not in level: on white
    images the light of each lens is in the map, on scenes types are as bright as each other.
    """
    sample = found.sample
    kinds = types.of(sample.indices)
    light, weight = found.sum_windows(gain, kinds, 0.5 * radius)
    if light.shape[1] != types.count or len(light) < _FEWEST_WINDOWS:
        return gain
    wide = 2 * (round(_SMOOTH / gain.step) // 2) + 1
    edge = ((0, 0), (0, 0), (wide // 2, wide // 2))
    light, weight = (
        sliding_window_view(np.pad(sums, edge, "edge"), wide, -1).mean(-1)
        for sums in (light, weight)
    )
    radii = np.arange(len(gain.profile)) * gain.step
    least = weight.min(1, keepdims=True)
    ratio = light / np.maximum(weight, 1e-12)
    factor = 1 + _shrunk_mean(ratio / np.maximum(ratio.mean(1, keepdims=True), 1e-12) - 1, least)
    # Rims are measured as far as there is light in them.
    last = np.flatnonzero((weight.sum((0, 1)) > 0) & (gain.profile > 0.25))[-1]
    factor[:, last:] = factor[:, [last]]
    factor = np.clip(factor, 0.5, 2)
    if np.abs(factor[:, radii < radius] - 1).max() < _LEAST:
        return gain
    return replace(gain, type_light=factor, type_cell=types.cell)


def order_by_rims(
    types: LensTypes | None, gain: GainMap, radius: float
) -> tuple[LensTypes | None, GainMap]:
    """Order the lens types of a white image from soft rims to hard ones.

    Returns the types and their gain map. Types whose rims do not differ stay in their order.

    Rims are images of the main aperture, at `s = 0`: the farther from that a type is focused, the
    softer is its rim, and the less light is left before it (`radius` [px]: usable).
    """
    if types is None or not types.ordered or not gain.type_light.size:
        return types, gain
    rims = gain.type_rims(radius)
    rims = rims[:, np.ptp(rims, axis=0).argmax()]
    order = np.argsort(rims)
    if np.diff(rims[order]).min() < _LEAST:
        return types, gain
    cell = np.argsort(order)[types.cell].astype(np.int8)
    ordered = LensTypes(
        cell, True, types.focus[order] if types.focus is not None else None, types.confidence
    )
    return ordered, replace(gain, type_light=gain.type_light[order], type_cell=cell)


def average_vignetting(gain: GainMap, lattice: Lattice) -> tuple[Vignetting, float]:
    """Vignetting of the average microimage, and its usable radius."""
    some = lattice.indices()[evenly(len(lattice), _LENSES)]
    field = lattice.field_place(lattice.points(some))
    limit = nearest_half(lattice)
    rings = int(limit / gain.step) + 2
    relative = gain.sample(gain.describe(field), rings).mean((0, 1))
    if not relative.max() > 0:
        raise CalibrationError("no light is left in the average microimage; give a white image")
    radii = np.arange(rings) * gain.step
    relative = np.clip(relative / relative.max(), 0, 1)
    # In clipped flats only the rims of bright microimages are measured.
    middle = max(float(relative[radii <= CORES[0] * limit].max()), 0.5)
    inside = radii <= max(_INNER * limit, float(radii[relative.argmax()]))
    radius = float(first_half(np.where(inside, 1, relative), gain.step, limit))
    return Vignetting(relative / middle, gain.step), radius
