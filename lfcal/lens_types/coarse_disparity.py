"""Coarse disparity of single lenses, to sort them by depth and to find the mode of a scene.

Neighbouring microimages are compared along the lines between them (`detection.neighbours`) over a
grid of signed patch sizes; differences are summed over 3 x 3 lenses.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..detection.neighbours import compare_neighbours
from ..images.preprocessing import sqrt_luminance
from ..lattice.lattice import Lattice
from ..runtime.arrays import Floats, Singles
from .lens_sample import LensSample, sample_lenses

__all__ = ["STEP", "estimate_coarse_disparity", "find_scene_mode"]

#: Spacing of the disparities that are tried [s / D].
STEP = 0.05
# [s / D] Beyond this, neighbours have too little in common.
_REACH = 0.6
# [usable radius] Pixels that are compared.
_RADIUS = 0.88
# Largest difference of lenses that show the same, over their contrast; independent ones have 0.7.
_ALIKE = 0.5
# Difference of this of two disparities below which neither is sure.
_AMBIGUOUS = 0.04
# Contrast of noise.
_FLOOR = 1e-3
# Share of lenses in the other mode: 1 to 9 % in scenes that are in one.
_OTHER_MODE = 0.2


def estimate_coarse_disparity(picture: Singles, sample: LensSample) -> Floats:
    """(n,) `s / D` of the inner lenses of a sample, in steps of `STEP`.

    NaN if lenses are not alike, at several disparities, or at the first or last step. `picture`
    (h, w) is made by `images.preprocessing.sqrt_luminance`.
    """
    lattice = sample.lattice
    ratios = np.linspace(-_REACH, _REACH, 2 * round(_REACH / STEP) + 1)
    # Every other lens is enough, as sums are over 3 x 3 lenses.
    chosen = sample.whole & (sample.index.sum(-1) % 2 == 0)
    sums = np.zeros((2, len(ratios), *chosen.shape))
    sums[:, :, chosen] = compare_neighbours(
        picture, lattice, sample.place[chosen], _RADIUS * lattice.radius, ratios
    )
    inner = np.lib.stride_tricks.sliding_window_view(sums, (3, 3), (-2, -1)).sum((-2, -1))
    difference, contrast = inner.reshape(2, len(ratios), -1)
    unlike = difference / (contrast + _FLOOR)
    best = unlike.argmin(0)
    apart = np.abs(np.arange(len(ratios))[:, None] - best) > 2
    second = np.where(apart, unlike, 1.0).min(0)
    least = unlike.min(0)
    known = (least < _ALIKE) & (second - least > _AMBIGUOUS)
    known &= (best > 0) & (best < len(ratios) - 1)
    return np.where(known, ratios[best], np.nan)


def find_scene_mode(flat: NDArray, lattice: Lattice) -> Literal["telescopic", "binocular"] | None:
    """The mode of a scene, from the sign of its coarse disparity.

    None if too few lenses have a disparity, or too many have the other mode.

    `flat` is (h, w) or (h, w, 3).
    """
    ratio = estimate_coarse_disparity(sqrt_luminance(flat), sample_lenses(lattice))
    known = ratio[np.isfinite(ratio) & (ratio != 0)]
    telescopic = 0.5
    if len(known):
        telescopic = float((known > 0).mean())
    if len(known) < 100 or min(telescopic, 1 - telescopic) > _OTHER_MODE:
        return None
    if telescopic > 0.5:
        return "telescopic"
    return "binocular"
