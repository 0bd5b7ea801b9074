"""The mode in which the lenses work that see a scene: telescopic or binocular, where it is one for nearly all."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import sqrt_luminance
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from .coarse_disparity import estimate_coarse_disparity
from .lens_sample import sample_lenses

__all__ = ["find_scene_mode"]


def find_scene_mode(flat: NDArray, lattice: Lattice) -> Literal["telescopic", "binocular"] | None:
    """The sign of the coarse disparity of a sample of lenses.

    Parameters
    ----------
    flat : (h, w) or (h, w, 3) array
    lattice : Lattice
        Of the same image size.

    Returns
    -------
    str or None
        None where too few lenses show a disparity, or a part of them the other mode.
    """
    crops = StackedCrops.of(sqrt_luminance(flat))
    sample = sample_lenses(lattice, crops)
    ratio = estimate_coarse_disparity(crops.picture, sample)
    known = ratio[np.isfinite(ratio) & (ratio != 0)]
    if len(known) < 100:
        return None
    telescopic = float((known > 0).mean())
    # Of a scene in one mode, 1 to 9 % of the lenses show the other.
    if min(telescopic, 1 - telescopic) > 0.2:
        return None
    return "telescopic" if telescopic > 0.5 else "binocular"
