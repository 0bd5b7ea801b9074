"""Whether the lens types of a camera are those that a flat shows.

Where the flat shows the order of the types by itself, that decides. Elsewhere the order of the
camera is tested: rims get harder from type to type, and as sharpness falls with the square of the
defocus, a middle type is never the least sharp. So is the light before the rims that the gain map
of the camera itself has for each type: it grows from the softest rims to the hardest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..gain.gain_map import GainMap
from ..lattice.lattice import Lattice
from ..runtime.arrays import Singles
from .classify import MIN_RADIUS, find_lens_types, is_in_step
from .focus_order import FLATTENED, RIM_FAULT, TypeMeans
from .lens_sample import measure_lens_features, sample_lenses

__all__ = ["find_rim_conflict", "find_type_conflict"]

# Least confidence of the types of a flat that contradict those of a camera.
_SURE = 0.9
# The given order of rims is wrong if twice the logarithm of its likelihood ratio to the best order
# is larger than this: 24 right cameras had 13 at most.
_WRONG = 20


def find_type_conflict(
    picture: Singles, lattice: Lattice, types: LensTypes, rims_known: bool = False
) -> str | None:
    """What contradicts the lens types of a camera on a scene, None where nothing does.

    `picture` (h, w) is as made by `images.preprocessing.sqrt_luminance`. With `rims_known`, the
    gain map has the light at the rims of each type, which is more reliable than rims of a scene.
    """
    found = find_lens_types(picture, lattice, False)
    if found is not None and found.count == types.count:
        seen = found.focus is not None and bool(np.isfinite(found.focus).all())
        if found.ordered and types.ordered and (seen or not rims_known):
            same = np.array_equal(_numbers(found, types), _numbers(types, found))
            if same:
                return None
            return "the lens types of the camera are in another order than on the flat"
        # Lenses are alike in one pattern where they are in the other, whatever their numbers.
        pairs = np.unique(
            np.stack([_numbers(found, types).ravel(), _numbers(types, found).ravel()]), axis=1
        )
        if found.confidence > _SURE and pairs.shape[1] != found.count:
            return "the lens types of the camera lie at other lenses than on the flat"
    large = lattice.radius >= MIN_RADIUS
    if (
        types.ordered
        and types.count == 3
        and large
        and _is_refuted(picture, lattice, types, rims_known)
    ):
        return "the lens types of the camera are in another order than on the flat"
    return None


def find_rim_conflict(types: LensTypes, gain: GainMap, radius: float) -> str | None:
    """Sentence about a contradiction between gain map and lens types of a camera.

    None if there is none. `radius` [px] is the usable one.
    """
    cells = LensTypes(gain.type_cell)
    own = _numbers(types, cells).ravel()
    other = _numbers(cells, types).ravel()
    light = gain.type_rims(radius)
    light = light[other, np.ptp(light, axis=0).argmax()]
    rims = np.array([light[own == kind].mean() for kind in range(types.count)])
    mixed = max(float(np.ptp(light[own == kind])) for kind in range(types.count))
    falls = float((np.maximum.accumulate(rims) - rims).max())
    if max(falls, mixed) <= RIM_FAULT:
        return None
    return (
        "the lens types of the camera are in another order than the light at the rims of its "
        "microimages"
    )


def _numbers(types: LensTypes, other: LensTypes) -> NDArray[np.int8]:
    """Types of a cell after which both patterns repeat."""
    period = int(np.lcm(len(types.cell), len(other.cell)))
    return types.of(
        np.stack(np.meshgrid(np.arange(period), np.arange(period), indexing="ij"), axis=-1)
    )


def _is_refuted(picture: Singles, lattice: Lattice, types: LensTypes, rims_known: bool) -> bool:
    """Whether rims or sharpness of three types contradict their order."""
    sample = sample_lenses(lattice)
    features = measure_lens_features(picture, sample)
    means = TypeMeans.from_sample(sample, types.cell.astype(np.int64))
    rim = features.outer_light
    if is_in_step(types.cell, lattice):
        rim = features.inner_loss
    if features.rim_ratio < FLATTENED and not rims_known:
        softness = means.fit_means(sample.subtract_neighbours(rim))
        if softness is not None:
            # Softness is expected to fall by equal steps.
            given = max(float(softness[0][0] - softness[0][2]), 0.0)
            if float(np.ptp(softness[0])) ** 2 - given**2 > _WRONG * max(softness[1], 1e-12) ** 2:
                return True
    sharpness = means.fit_means(sample.subtract_neighbours(features.sharpness))
    if sharpness is None:
        return False
    valley = min(sharpness[0][0], sharpness[0][2]) - sharpness[0][1]
    return bool(valley > 5 * sharpness[1])
