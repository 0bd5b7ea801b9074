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
from .settings import DEFAULT, LensTypeSettings

__all__ = ["find_scene_mode"]


def find_scene_mode(
    flat: NDArray, lattice: Lattice, settings: LensTypeSettings = DEFAULT
) -> Literal["telescopic", "binocular"] | None:
    """The sign of the coarse disparity of a sample of lenses.

    Parameters
    ----------
    flat : (h, w) or (h, w, 3) array
    lattice : Lattice
        Of the same image size.
    settings : LensTypeSettings

    Returns
    -------
    str or None
        None where too few lenses show a disparity, or a part of them the other mode.
    """
    crops = StackedCrops.of(sqrt_luminance(flat))
    sample = sample_lenses(lattice, crops, settings.sample)
    ratio = estimate_coarse_disparity(crops.picture, sample, settings.disparity)
    known = ratio[np.isfinite(ratio) & (ratio != 0)]
    if len(known) < settings.pattern.fewest_lenses:
        return None
    telescopic = float((known > 0).mean())
    if min(telescopic, 1 - telescopic) > settings.other_mode:
        return None
    return "telescopic" if telescopic > 0.5 else "binocular"
