"""Illumination of a camera from one flat: gain map, vignetting, radius and defects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..camera.lens_types import LensTypes
from ..gain.gain_map import Defects, GainMap, Vignetting
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop, StackedCrops
from ..runtime.arrays import ENOUGH_PIXELS, Floats, Singles
from .defect_search import find_defects
from .estimate import estimate_gain
from .lens_light import find_unlit_in_scene, fit_lens_lights, measure_lenses
from .profiles import (
    ProfilePixels,
    average_vignetting,
    fit_scene_profiles,
    fit_type_profiles,
    order_by_rims,
)
from .residuals import draw_sample

__all__ = ["Illumination", "measure_illumination"]

#: Share of the pixels of a white image beside its gain map, above which that is doubtful: 25 white
#: images have up to 0.027 (a binary mask), one with large specks of dust 0.05, a checkerboard seen
#: through an array 0.12.
MOST_OFF_GAIN = 0.03
_NOT_MEASURED = (
    "the scene does not show the light inside its microimages: pictures are drawn without "
    "vignetting; calibrate on a white image"
)
# Rows of microimages of which one is used for the profiles of scenes and types.
_ROWS = 2


@dataclass(frozen=True)
class Illumination:
    """Illumination of the microimages of a flat."""

    gain_map: GainMap
    vignetting: Vignetting  # mean light of the average microimage, that of scenes may rise
    # [px] where that falls below half, at most half the distance to the nearest microimage
    radius: float
    defects: Defects
    warnings: tuple[str, ...]
    outlier_share: float = (
        0.0  # of the pixels of a white image that differ from the gain map; 0 if not measured
    )
    lens_types: LensTypes | None = None  # on white images in the order of their rims


def measure_illumination(
    picture: Singles | StackedCrops,
    lattice: Lattice,
    white: bool,
    cut: Floats | None = None,
    read_crop: ReadCrop | None = None,
    find_types: Callable[[Lattice], LensTypes | None] | None = None,
) -> Illumination:
    """Gain map, vignetting and defects from a flat.

    `picture` (h, w), or crops of a white image, is the square root of the luminance. From a scene
    follow only the common shape of its microimages, and of defects only unlit lenses with lit
    neighbours. `cut` is the disc that cuts microimages, if known, as `GainMap.cut`; `read_crop`
    reads further crops, of which only unlit lenses are found. `find_types` finds the types of the
    lenses of a lattice with a usable radius.
    """
    gain = estimate_gain(picture, lattice, not white, cut)
    warnings: list[str] = []
    if not white:
        sample = draw_sample(lattice, picture, ENOUGH_PIXELS, True, _ROWS)
        pixels = ProfilePixels.of(sample, gain)
        profiles = fit_scene_profiles(pixels, gain)
        gain = replace(gain, profile=profiles.light)
        if not profiles.shown:
            warnings.append(_NOT_MEASURED)
    vignetting, radius = average_vignetting(gain, lattice)
    if not white:
        vignetting, _ = average_vignetting(replace(gain, profile=profiles.mean), lattice)
    types = find_types(lattice.with_radius(radius)) if find_types else None
    if types is not None and types.count > 1:
        if white:
            sample = draw_sample(lattice, picture, ENOUGH_PIXELS, False, _ROWS)
            pixels = ProfilePixels.of(sample, gain)
        if not warnings:
            gain = fit_type_profiles(pixels, radius, gain, types)
    if white:
        types, gain = order_by_rims(types, gain, radius)
    source = picture if read_crop is None else read_crop
    assert not isinstance(source, StackedCrops)
    if white:
        described = gain.describe(lattice.field_place(lattice.centres()))
        lights = fit_lens_lights(measure_lenses(source, lattice, gain, described), lattice, gain)
        gain = lights.gain
        unlit = lights.unlit
    else:
        assert isinstance(picture, np.ndarray)
        unlit = find_unlit_in_scene(picture, lattice)
    gain = gain.limited(lattice)
    defects = Defects(lenses=lattice.indices()[unlit].astype(np.int32))
    share = 0.0
    if white and not isinstance(picture, StackedCrops):
        defects, share = find_defects(picture, lattice, lights)
        if share > MOST_OFF_GAIN:
            warnings.append(
                f"{share:.1%} of the pixels differ from the gain map, more than defects explain; "
                "check the white image for structure or saturation"
            )
    return Illumination(gain, vignetting, radius, defects, tuple(warnings), share, types)
