"""By how much pixels of neighbouring lenses differ that show the same surface: noise, compression, uneven light."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...data.depth_map import DepthMap
from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import neighbour_rows

__all__ = ["measure_noise"]


def measure_noise(gray: GrayFlat, lattice: Lattice, depth: DepthMap, gap: float) -> np.float32:
    """Squared difference of brightness (white = 1) of two lenses that is no mismatch: noise, rounding, uneven light.

    Nine times the median square over plain patches, those with the lowest fifth of the contrasts, of lenses that have
    one depth with all their neighbours, to half a `gap` [px]; but for rounding, nothing where there are none.
    """
    around, sizes, rounding2 = neighbour_rows(lattice, lattice.steps), depth.filled_patch_size, 255.0**-2
    alone = (around >= 0).all(1) & (depth.reason == 0)
    alone &= (np.abs(sizes[around] - sizes[:, None]) < 0.5 * gap).all(1)
    some = np.flatnonzero(alone)
    if not len(some):
        return np.float32(rounding2)
    some = some[:: max(1, len(some) // 100)]
    patches = [_compare(gray, int(a), int(around[a, 0]), float(sizes[a]) / lattice.pitch) for a in some]
    differences, contrasts = (np.concatenate(values) for values in zip(*patches, strict=True))
    return np.float32(max(9 * np.median(differences[contrasts <= np.quantile(contrasts, 0.2)]), rounding2))


def _compare(gray: GrayFlat, lens: int, other: int, slope: float) -> tuple[NDArray[np.float32], ...]:
    """Mean squared difference of patches in the middle of a lens from another lens, and their variance."""
    side = 2 * int(0.3 * gray.pitch) + 1
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
