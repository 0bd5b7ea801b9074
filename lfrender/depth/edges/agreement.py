"""By how much pixels of neighbouring lenses differ that show the same surface: noise, compression, light of lenses."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...data.depth_map import DepthMap
from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import neighbour_rows
from .settings import DEFAULT, EdgeSettings

__all__ = ["measure_agreement"]

# Side of the box in the middle of a lens that is compared [pitch].
_SIDE = 0.6
# Share of the patches that show hardly any contrast, of all lenses together.
_PLAIN = 0.2


def measure_agreement(
    gray: GrayFlat, lattice: Lattice, depth: DepthMap, gap: float, settings: EdgeSettings = DEFAULT
) -> float:
    """Difference of brightness, white = 1, that is no mismatch of two lenses that show the same.

    Measured on lenses that have one depth with all their neighbours, to half a `gap` [px]; that of rounding where there
    are none.
    """
    around, sizes, rounding = neighbour_rows(lattice, lattice.steps), depth.filled_patch_size, 1 / 255
    alone = (around >= 0).all(1) & (depth.reason == 0)
    alone &= (np.abs(sizes[around] - sizes[:, None]) < 0.5 * gap).all(1)
    some = np.flatnonzero(alone)
    some = some[:: max(1, len(some) // settings.agreeing)]
    if not len(some):
        return rounding
    patches = [_compare(gray, int(a), int(around[a, 0]), float(sizes[a]) / lattice.pitch) for a in some]
    differences, contrasts = (np.concatenate(values) for values in zip(*patches, strict=True))
    plain = differences[contrasts <= np.quantile(contrasts, _PLAIN)]
    return max(settings.noise * float(np.sqrt(max(np.median(plain), 0.0))), rounding)


def _compare(gray: GrayFlat, lens: int, other: int, slope: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean squared difference of patches of a lens from another lens, and their variance."""
    side = 2 * int(0.5 * _SIDE * gray.pitch) + 1
    x, y = np.rint(gray.centres[lens]).tolist()
    there = np.array([x, y]) + (gray.centres[other] - gray.centres[lens]) * (1 + slope)
    own = cv2.getRectSubPix(gray.image, (side, side), (x, y))
    apart = own - cv2.getRectSubPix(gray.image, (side, side), tuple(there.tolist()))
    contrast = cv2.blur(own * own, (3, 3)) - cv2.blur(own, (3, 3)) ** 2
    # Where both microimages show the place.
    at = np.arange(side) - side // 2
    shift = (gray.centres[other] - gray.centres[lens]) * slope
    seen = np.hypot(at + shift[0], (at + shift[1])[:, None]) < gray.radius
    return cv2.blur(apart * apart, (3, 3))[seen], contrast[seen]
