"""Whether a flat is a white image or a scene, by the light inside its microimages and from one to
the next.
"""

from __future__ import annotations

import numpy as np

from ..camera.evidence import white_probability
from ..lattice.lattice import Lattice
from ..runtime.arrays import Singles
from .tones import measure_tones

__all__ = ["is_white_image"]


def is_white_image(picture: Singles, lattice: Lattice) -> bool:
    """Whether a picture (h, w), the square root of the luminance, shows evenly lit microimages on a
    lattice.
    """
    tones = measure_tones(picture, lattice)
    if tones is None:
        return False
    inside = float(np.log(tones.inside + 1e-3))
    detail = float(np.log(max(tones.detail, 1.0)))
    return white_probability(inside, detail, tones.unlike) > 0.5
