"""By how much pixels of neighbouring lenses differ that show the same surface: noise, compression, light of lenses."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...data.depth_map import DepthMap
from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import neighbour_rows
from .settings import DEFAULT, EdgeSettings

__all__ = ["Agreement", "measure_agreement"]

# Side of the box in the middle of a lens that is compared [pitch].
_SIDE = 0.6
# Share of the patches that show hardly any contrast, of the brighter and of the darker ones.
_PLAIN = 0.2


class Agreement(NamedTuple):
    """Difference of brightness that is no mismatch: the root of `fixed`^2 + (`share` * brightness)^2; white = 1.

    Noise and rounding are fixed, a share are the gain of lenses and the lattice, which are never quite right.
    """

    fixed: float
    share: float

    def contrast_at(self, image: NDArray[np.float32], points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Standard deviation of the pixels at `points` (n, 2) and the four beside each, in units of that difference."""
        x, y = np.clip(np.rint(points).astype(int), 1, np.array(image.shape[::-1]) - 2).T
        five = np.stack([image[y, x], image[y, x - 1], image[y, x + 1], image[y - 1, x], image[y + 1, x]])
        return np.asarray(five.std(0) / np.hypot(self.fixed, self.share * five.mean(0)))


def measure_agreement(
    gray: GrayFlat, lattice: Lattice, depth: DepthMap, gap: float, settings: EdgeSettings = DEFAULT
) -> Agreement:
    """How well two lenses agree that show the same, measured on those that have one depth with all their neighbours, to
    half a `gap` [px]; but for rounding, they agree where there are none.

    The brighter half of their plain patches tells the share, the darker one what is fixed.
    """
    around, sizes, rounding = neighbour_rows(lattice, lattice.steps), depth.filled_patch_size, 1 / 255
    alone = (around >= 0).all(1) & (depth.reason == 0)
    alone &= (np.abs(sizes[around] - sizes[:, None]) < 0.5 * gap).all(1)
    some = np.flatnonzero(alone)
    some = some[:: max(1, len(some) // settings.agreeing)]
    if not len(some):
        return Agreement(rounding, 0.0)
    patches = [_compare(gray, int(a), int(around[a, 0]), float(sizes[a]) / lattice.pitch) for a in some]
    differences, levels, contrasts = (np.concatenate(values) for values in zip(*patches, strict=True))
    bright = levels >= np.median(levels)
    dark = ~bright | bright.all()
    bright &= contrasts <= np.quantile(contrasts[bright], _PLAIN)
    dark &= contrasts <= np.quantile(contrasts[dark], _PLAIN)
    share2 = float(np.median(differences[bright] / np.maximum(levels[bright], rounding) ** 2))
    fixed2 = float(np.median(differences[dark] - share2 * levels[dark] ** 2))
    noise = settings.noise
    return Agreement(max(noise * float(np.sqrt(max(fixed2, 0.0))), rounding), noise * float(np.sqrt(share2)))


def _compare(gray: GrayFlat, lens: int, other: int, slope: float) -> tuple[NDArray[np.float32], ...]:
    """Mean squared difference of patches of a lens from another lens, their brightness and variance."""
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
    return cv2.blur(apart * apart, (3, 3))[seen], own[seen], contrast[seen]
