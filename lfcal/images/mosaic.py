"""Colour filter mosaics: whether a flat has one, and its light without one, at the resolution of the sensor.

Colours are not interpolated, which would blur the lattice. The four phases of the 2 x 2 mosaic are scaled to the same
local mean instead; where the scene is coloured, a filter with zeros at the three mosaic frequencies removes the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import MOSAICS
from .settings import MOSAIC

__all__ = ["check_mosaic", "equalise_mosaic", "has_mosaic", "remove_mosaic"]


def check_mosaic(mosaic: str | None, flat: NDArray[Any]) -> None:
    """ValueError where `mosaic` is no name of one, FlatError where the flat is in colour already."""
    if mosaic is None:
        return
    if mosaic not in MOSAICS:
        raise ValueError(f"mosaic must be one of {', '.join(MOSAICS)} or None, got {mosaic!r}")
    if flat.ndim == 3:
        raise FlatError(f"the flat is in colour, so it has no {mosaic} mosaic any more; give it without 'mosaic'")


def has_mosaic(flat: NDArray[Any]) -> bool:
    """Whether the means of the four phases of 2 x 2 cells differ significantly over a `flat` (h, w).

    Without colour filters a lattice of microimages and a scene give all four phases the same mean but for chance.
    """
    height, width = flat.shape
    side = min(MOSAIC.block, height // 2 * 2, width // 2 * 2)
    rows = np.unique(np.linspace(0, height - side, MOSAIC.blocks).astype(int) // 2 * 2)
    columns = np.unique(np.linspace(0, width - side, MOSAIC.blocks).astype(int) // 2 * 2)
    # Summing over rows first takes half the time.
    blocks = [flat[y : y + side, x : x + side].reshape(side // 2, 2, side) for y in rows for x in columns]
    sums = [block.sum(0, dtype=np.float64) for block in blocks]
    means = np.array(sums).reshape(len(sums), 2, side // 2, 2).mean(2).reshape(len(sums), 4) / (side // 2)
    level = means.mean()
    if not level > 0 or len(means) < 2:
        return False
    signs = np.array([(1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1)]) / 4
    parts = means @ signs.T / level
    error = parts.std(0, ddof=1) / np.sqrt(len(parts))
    difference = np.abs(parts.mean(0))
    least = [MOSAIC.row_difference, MOSAIC.row_difference, MOSAIC.diagonal_difference]
    return bool(((difference > least) & (difference > MOSAIC.significance * error)).any())


def equalise_mosaic(flat: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 light of a mosaic `flat` (h, w), its four phases scaled to the same local mean."""
    import cv2

    light = np.array(flat, dtype=np.float32)
    height, width = light.shape
    window = max(MOSAIC.smallest_window, int(min(height, width) * MOSAIC.window)) // 2 | 1
    phases = [light[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    size = (width // 2, height // 2)
    means: list[Any] = [cv2.blur(phase, (window, window)) for phase in phases]
    common: Any = np.mean([mean[: size[1], : size[0]] for mean in means], axis=0)
    floor = np.float32(1e-6 * float(common.mean()) + 1e-30)
    for phase, mean in zip(phases, means, strict=True):
        h, w = mean.shape
        # Odd sizes leave two phases a row or column more than the others.
        target = common[np.minimum(np.arange(h), size[1] - 1)][:, np.minimum(np.arange(w), size[0] - 1)]
        phase *= target / np.maximum(mean, floor)
    return light


def remove_mosaic(light: NDArray[np.float32]) -> NDArray[Any]:
    """`light` (h, w) filtered with weights 1, 2, 1 along both axes, zero at the frequencies of a mosaic."""
    import cv2

    kernel = np.array([0.25, 0.5, 0.25], np.float32)
    return cv2.sepFilter2D(light, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
