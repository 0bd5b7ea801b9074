"""Changes of a surface that the picture proves: along the depth edges that they make, brightness changes as well.

On a blank wall all depths match alike, and a patch of another depth has a rim that nobody sees.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...data.surface import Surface
from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import nearest_lens
from .agreement import Agreement
from .settings import DEFAULT, EdgeSettings

__all__ = ["keep_proven", "spread"]

# A grid value and those beside it.
_NEARBY = np.ones((3, 3), np.uint8)


def keep_proven(
    found: Surface, before: NDArray[np.float32], gray: GrayFlat, lattice: Lattice, agreement: Agreement, gap: float,
    settings: EdgeSettings = DEFAULT,
) -> NDArray[np.float32]:  # fmt: skip
    """The surface `before`, with those connected regions in which the surface `found` is nearer or farther by more than
    a `gap` [px] whose rim has contrast in the mean; no rim is as good.

    Contrast is that of the microimage nearest to each point of the rim, where the depth `found` has it.
    """
    values, kept = found.patch_size, before.copy()
    edges = (spread(values, 1) > gap).astype(np.uint8)
    for sign in (1, -1):
        number, region = cv2.connectedComponents((sign * (values - before) > gap).astype(np.uint8))
        whose = cv2.dilate(region.astype(np.float32), _NEARBY) * edges
        v, u = np.nonzero(whose)
        points, rim = found.first + found.spacing * np.stack([u, v], -1), whose[v, u].astype(int)
        centres = gray.centres[nearest_lens(lattice, points)]
        at = centres - (points - centres) * (values[v, u, None] / lattice.pitch)
        contrast = np.bincount(rim, agreement.contrast_at(gray.image, at), number)
        proven = contrast >= settings.seen * np.bincount(rim, minlength=number)
        proven[0] = False
        np.copyto(kept, values, where=proven[region])
    return kept


def spread(values: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Difference between the largest and the least value within `reach` grid values each way."""
    around = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.dilate(values, around) - cv2.erode(values, around))
