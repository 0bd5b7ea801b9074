"""Flats that carry a colour filter mosaic: light as if the filters were not there, at the resolution of the sensor.

Colours are not interpolated, as that would smear the lattice. The four phases of the 2 x 2 mosaic are given the same
local mean instead, and where the scene is coloured what is left of the mosaic is taken out by a filter that is blind
to its three frequencies and alike to all sides.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError

__all__ = ["Mosaic", "check_mosaic", "equalise_mosaic", "has_mosaic", "remove_mosaic"]

#: Colour filters of the top left 2 x 2 pixels, row by row.
Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]

# Green pixels stand on one diagonal and differ from the others by more than this share of the light; lattices of
# whole pixels make less there, and in rows and columns less than the second share.
_VISIBLE = 0.03
_STRONG = 0.1
# Differences are real where they are so many standard errors of the scatter over the flat.
_SURE = 6.0
_BLOCK, _BLOCKS = 64, 16
# Side of the window over which phases get the same mean, as a share of the flat, and the least [px]: many lenses.
_WINDOW = 1 / 8
_SMALLEST_WINDOW = 65


def check_mosaic(mosaic: str | None, flat: NDArray[Any]) -> None:
    """ValueError where `mosaic` is no name of one, FlatError where the flat is in colour already."""
    if mosaic is None:
        return
    if mosaic not in get_args(Mosaic):
        raise ValueError(f"mosaic must be one of {', '.join(get_args(Mosaic))} or None, got {mosaic!r}")
    if flat.ndim == 3:
        raise FlatError(f"the flat is in colour, so it has no {mosaic} mosaic any more; give it without 'mosaic'")


def has_mosaic(flat: NDArray[Any]) -> bool:
    """Whether the phases of the 2 x 2 cells of `flat` (h, w) differ as colour filters make them, all over it.

    A lattice of microimages and a scene show the same light to all four phases but for chance.
    """
    height, width = flat.shape
    side = min(_BLOCK, height // 2 * 2, width // 2 * 2)
    rows = np.unique(np.linspace(0, height - side, _BLOCKS).astype(int) // 2 * 2)
    columns = np.unique(np.linspace(0, width - side, _BLOCKS).astype(int) // 2 * 2)
    # Rows first, whole ones at once: half the time.
    blocks = [flat[y : y + side, x : x + side].reshape(side // 2, 2, side) for y in rows for x in columns]
    sums = [block.sum(0, dtype=np.float64) for block in blocks]
    means = np.array(sums).reshape(len(sums), 2, side // 2, 2).mean(2).reshape(len(sums), 4) / (side // 2)
    level = means.mean()
    if not level > 0 or len(means) < 2:
        return False
    signs = np.array([(1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1)]) / 4
    parts = means @ signs.T / level
    error = parts.std(0, ddof=1) / np.sqrt(len(parts))
    found = np.abs(parts.mean(0))
    return bool(((found > [_STRONG, _STRONG, _VISIBLE]) & (found > _SURE * error)).any())


def equalise_mosaic(flat: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 light of a mosaic `flat` (h, w), its four phases with the same local mean."""
    import cv2

    light = np.array(flat, dtype=np.float32)
    height, width = light.shape
    window = max(_SMALLEST_WINDOW, int(min(height, width) * _WINDOW)) // 2 | 1
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
    """`light` (h, w) without anything that repeats every two pixels: weights 1, 2, 1 each way."""
    import cv2

    kernel = np.array([0.25, 0.5, 0.25], np.float32)
    return cv2.sepFilter2D(light, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
