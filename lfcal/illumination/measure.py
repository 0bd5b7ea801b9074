"""Illumination of a camera as one flat shows it: gain map, vignetting of the average microimage, defects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..gain.defects import Defects
from ..gain.gain_map import GainMap
from ..gain.kernel import radial_mean
from ..gain.vignetting import Vignetting
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop, StackedCrops
from ..runtime.errors import CalibrationError
from ..white_fit.model import CatEye
from .defect_search import MOST, find_defects
from .gain_fit import fit_gain
from .lens_light import dark_in_scene, lens_lights

__all__ = ["Illumination", "measure_illumination"]

# Lenses over which the vignetting of the average microimage is taken.
_LENSES = 64


@dataclass(frozen=True)
class Illumination:
    """What a flat shows of the light in its microimages.

    Parameters
    ----------
    gain_map : GainMap
    vignetting : Vignetting
        Of the average microimage.
    radius : float [px]
        Where that falls below half, at most half the distance to the nearest microimage.
    defects : Defects
    warnings : tuple of str
    unlike : float
        Share of the pixels of a white image that differ from the gain map; 0 where that was not looked at.
    """

    gain_map: GainMap
    vignetting: Vignetting
    radius: float
    defects: Defects
    warnings: tuple[str, ...]
    outlier_share: float = 0.0


def measure_illumination(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    white: bool,
    cat_eye: CatEye | None = None,
    look: ReadCrop | None = None,
) -> Illumination:
    """Gain map, vignetting and defects from a flat.

    Parameters
    ----------
    picture : (h, w) float32, or of a white image parts of such
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    white : bool
        Whether the flat is a white image. A scene capture shows only what all its microimages have in common, and
        no defects but lenses without light amid others.
    cat_eye : CatEye or None
        The disc that cuts microimages, where one is known.
    look : Look or None
        At tones of the flat, where `picture` are parts; then lenses without light are the only defects looked for.
    """
    fit = fit_gain(picture, lattice, not white, cat_eye)
    warnings: tuple[str, ...] = ()
    unlike = 0.0
    if isinstance(picture, StackedCrops):
        assert look is not None
        lights = lens_lights(look, lattice, fit)
        gain = lights.gain
        defects = Defects(lenses=lattice.indices()[lights.dark].astype(np.int32))
    elif white:
        lights = lens_lights(picture, lattice, fit)
        gain = lights.gain
        defects, unlike = find_defects(picture, lattice, gain, lights.brightest, fit, lights.dark)
        if unlike > MOST:
            warnings = (
                f"{unlike:.1%} of the pixels differ from the gain map, too many for defects: none are recorded; check "
                "the white image for structure or saturation",
            )
    else:
        gain = fit.gain
        defects = Defects(lenses=lattice.indices()[dark_in_scene(picture, lattice, gain)].astype(np.int32))
    vignetting, radius = _average(gain, lattice)
    return Illumination(gain, vignetting, radius, defects, warnings, unlike)


def _average(gain: GainMap, lattice: Lattice) -> tuple[Vignetting, float]:
    """Vignetting of the average microimage, and the radius to which it is usable."""
    centres = np.ascontiguousarray(lattice.points(lattice.indices()[:: max(1, len(lattice) // _LENSES)]))
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    rings = int(limit / gain.step) + 2
    light = np.zeros((len(centres), rings))
    radial_mean(centres, light, *gain.shape(lattice))
    relative = light.mean(0)
    if not relative.max() > 0:
        raise CalibrationError("no light is left in the average microimage; give a white image")
    relative = np.clip(relative / relative.max(), 0, 1)
    radii = np.arange(rings) * gain.step
    radius = limit
    dark = np.flatnonzero((relative < 0.5) & (radii > 0.3 * limit))
    if len(dark):
        k = int(dark[0])
        before, after = relative[k - 1], relative[k]
        radius = min(limit, float(radii[k - 1] + np.clip((before - 0.5) / max(before - after, 1e-9), 0, 1) * gain.step))
    return Vignetting(relative, gain.step), radius
