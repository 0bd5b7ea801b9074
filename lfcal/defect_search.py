"""Find defects: pixels of a white image that are further from the gain map than noise can take them."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .defects import Defects
from .gain_fit import GainFit
from .gain_kernels import centre_of, describe, level_of, light, nearest, walk
from .gain_map import GainMap
from .lattice import Lattice

__all__ = ["find_defects"]

# A pixel is a defect so many standard deviations from what it should be: beyond what Gaussian noise ever reaches.
_SURE = 6.0
# A dust speck shows in the mean over so many pixels' squares where it is too faint for single pixels.
_SQUARES = (3, 7)
# In those means, single pixels count for at most so many standard deviations: they are found by themselves.
_CLIP = 3.0
# Departures below this share of the light of a lens harm no picture.
_FLOOR = 0.01
# Rows looked at together, so that memory does not grow with the flat.
_BAND = 512
# More defects than this share of the pixels are no defects but a model that does not fit.
_MOST = 0.02


@njit(cache=True, nogil=True, parallel=True)
def _departures(
    picture, top, out, spread, windows, floor, size, origin, basis, bend, steps, faces, starts, grid, low, level, field,
    radius, profile, step, shade, rim, cut,
):  # fmt: skip
    rows, width = out.shape
    for row in prange(rows):
        y = top + row
        powers = np.empty(64)
        lens = np.empty(7 + rim.shape[0])
        i, j = starts[y, 0], starts[y, 1]
        cx, cy = centre_of(i, j, origin, basis, bend)
        fresh, bright, noise = True, 0.0, 1.0
        for x in range(width):
            ni, nj, cx, cy = nearest(x, y, i, j, cx, cy, origin, basis, bend, steps, faces)
            if fresh or ni != i or nj != j:
                i, j, fresh = ni, nj, False
                describe(cx, cy, field, shade, rim, cut, powers, lens)
                bright = level_of(i, j, cx, cy, field, level, grid, low, powers)
                a = min(max(int((cx + 0.5) / size[0] * windows.shape[1]), 0), windows.shape[1] - 1)
                b = min(max(int((cy + 0.5) / size[1] * windows.shape[0]), 0), windows.shape[0] - 1)
                noise = windows[b, a]
            if bright <= 0:
                out[row, x] = 0.0
                continue
            s, stretched, _ = light(x - cx, y - cy, lens, radius, profile, step, cut)
            ring = min(int(stretched / step), len(spread) - 1)
            v = picture[y, x]
            out[row, x] = (v * v / bright - s) / max(spread[ring] * noise, floor)


def _marked(far: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which pixels are defects, given how many standard deviations each is off."""
    import cv2

    bad: NDArray[np.bool_] = np.abs(far) > _SURE
    clipped = np.clip(far, -_CLIP, _CLIP)
    for side in _SQUARES:
        mean = cv2.blur(clipped, (side, side), borderType=cv2.BORDER_REFLECT)
        bad |= np.abs(mean) > _SURE / side
    return bad


def find_defects(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, brightest: float, fit: GainFit,
    dark: NDArray[np.int64],
) -> tuple[Defects, str]:  # fmt: skip
    """Defects of a white image.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    gain : GainMap
        With the light of all lenses.
    brightest : float
        Luminance in `picture` where the map is 1.
    fit : GainFit
        How far pixels scatter about the map.
    dark : (m,) int64
        Rows of `lattice.centres()` of lenses without light.

    Returns
    -------
    defects : Defects
    warning : str
        Empty where there is nothing to warn about.
    """
    height, width = picture.shape
    level = gain.level.copy()
    level[0] += np.log(brightest)
    size = np.array([width, height], np.float64)
    places = (*walk(lattice, gain.own), level, *gain.shape(lattice))
    found, warning = [], ""
    margin = _SQUARES[-1] // 2
    far = np.empty((min(height, _BAND + 2 * margin), width), np.float32)
    for top in range(0, height, _BAND):
        start, stop = max(0, top - margin), min(height, top + _BAND + margin)
        band = far[: stop - start]
        _departures(picture, start, band, fit.spread, fit.windows, _FLOOR, size, *places)
        bad = np.argwhere(_marked(band)[top - start : top - start + _BAND])
        found.append((bad + np.array([top, 0]))[:, ::-1])
    pixels = np.concatenate(found)
    if len(pixels) > _MOST * width * height:
        share = len(pixels) / (width * height)
        warning = (
            f"{share:.1%} of the pixels differ from the gain map, too many for defects: none are recorded; "
            "check the white image for structure or saturation"
        )
        pixels = pixels[:0]
    return Defects(pixels.astype(np.int32), lattice.indices()[dark].astype(np.int32)), warning
