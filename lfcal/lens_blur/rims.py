"""The blur of the rims of microimages: the disc of each lens type at `s = 0`.

A rim is the image of the main lens' pupil, which every microlens sees at `s = 0`: its blur is that
of an edge there, aperture times focus. Neither of them follows from rims alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..camera.lens_types import LensBlur
from .microimages import measure_microimages

__all__ = ["measure_rims"]

#: Tiles of the flat each way; as many as errors need.
_TILES = 2
#: Relative error of rims that a scene lights unevenly: AntLeg and GUV have 0.16 and -0.16 against
#: their white images, R5b, Letters and Beads 0.03 at most.
_SCENE_FAULT = 0.15
#: [pitch] Rims of scenes that are softer than this may be shading.
_WIDEST = 0.2
#: [pitch] Aperture until scenes or boards tell it: 0.14 to 0.5 in simulated cameras.
_APERTURE = 0.3


def measure_rims(flat: NDArray[Any], camera: Calibration) -> LensBlur | None:
    """The discs at `s = 0` from a flat (h, w) or (h, w, C); None if microimages have no rims.

    The error of the aperture is a pitch, so that no other depth has a disc that is sure. Of a
    scene, rims are measured on the mean of many microimages.
    """
    widest = np.inf if camera.source == "white" else _WIDEST * camera.lattice.pitch
    field = measure_microimages(flat, camera, _TILES, widest)
    if field is None:
        return None
    aperture = _APERTURE * camera.lattice.pitch
    discs = np.array([[blur.value] for blur in field.blur])
    errors = np.array([[blur.error] for blur in field.blur])
    if camera.source != "white":
        errors = np.hypot(errors, _SCENE_FAULT * discs)
    if not np.isfinite(errors).all():
        return None
    focus = discs[:, 0] / aperture
    return LensBlur(
        aperture,
        camera.lattice.pitch,
        focus,
        np.maximum(focus, 0.1),
        np.zeros(1),
        discs,
        np.maximum(errors, 0.05),
    )
