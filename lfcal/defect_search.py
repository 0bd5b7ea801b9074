"""Find defects: pixels of a white image that are further from the gain map than noise can take them."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .defects import Defects
from .gain_fit import GainFit
from .gain_kernels import BLOCK, SLOTS, described, first_lens, light, next_lens, walk
from .gain_map import GainMap
from .lattice import Lattice

__all__ = ["find_defects"]

# A pixel is a defect so many standard deviations from what it should be: beyond what Gaussian noise ever reaches.
_SURE = 6.0
# A dust speck shows in the mean over so many pixels' squares where it is too faint for single pixels.
_SQUARES = (3, 7)
# In those means, single pixels count for at most so many standard deviations: they are found by themselves.
_CLIP = 3.0
# Beside such a mean over a large square, that over the small one must be off by so many standard errors.
_LOCAL = 3.0
# Departures are kept as bytes: no departure, and one standard deviation.
_ZERO, _UNIT = 128, 40
# Departures below this share of the light of a lens harm no picture.
_FLOOR = 0.01
# Rows looked at together, so that memory does not grow with the flat.
_BAND = 512
# More defects than this share of the pixels are no defects but a model that does not fit.
_MOST = 0.02


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _departures(
    picture, top, out, sure, windows, most, middles, own, starts, ahead, level, field, radius, profile, step, shade,
    rim, cut,
):  # fmt: skip
    """How far pixels are off, as `_ZERO + _UNIT * standard deviations`; those far off by themselves at the ends."""
    rows, width = out.shape
    height, per_step = picture.shape[0], 1 / step
    for block in prange((rows + BLOCK - 1) // BLOCK):
        keys, powers, lens = np.full(SLOTS, -1), np.empty(64), np.empty(7 + rim.shape[0])
        lenses = np.empty((SLOTS, 8 + rim.shape[0]))
        for row in range(block * BLOCK, min((block + 1) * BLOCK, rows)):
            y = top + row
            a, b = first_lens(y, starts[y, 0], starts[y, 1], middles)
            x = 0
            while x < width:
                stop, p, q = next_lens(y, a, b, width, middles, ahead)
                bright = described(
                    a, b, middles, own, level, field, radius, shade, rim, cut, keys, powers, lenses, lens
                )
                cx, cy = middles[b, a, 0], middles[b, a, 1]
                column = min(max(int((cx + 0.5) / width * windows.shape[1]), 0), windows.shape[1] - 1)
                line = min(max(int((cy + 0.5) / height * windows.shape[0]), 0), windows.shape[0] - 1)
                sharp = 1 / windows[line, column]
                if bright <= 0:
                    out[row, x:stop] = _ZERO
                else:
                    over = 1 / bright
                    for at in range(x, stop):
                        s, stretched, _ = light(at - cx, y - cy, lens, profile, step, cut)
                        ring = min(int(stretched * per_step), len(sure) - 1)
                        far = (picture[y, at] * picture[y, at] * over - s) * min(sure[ring] * sharp, most)
                        if -_SURE <= far <= _SURE:
                            out[row, at] = int(_ZERO + 0.5 + _UNIT * min(max(far, -_CLIP), _CLIP))
                        else:
                            out[row, at] = 255 if far > 0 else 1
                x, a, b = max(x, stop), p, q


def _marked(far: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which pixels are defects, given how many standard deviations each is off in the scale of `_departures`."""
    import cv2

    bad: NDArray[np.bool_] = (far == 255) | (far == 1)
    few, many = (cv2.blur(far, (side, side), borderType=cv2.BORDER_REFLECT) for side in _SQUARES)
    limit = round(_UNIT * _SURE / _SQUARES[0])
    bad |= (few > _ZERO + limit) | (few < _ZERO - limit)
    limit, near = round(_UNIT * _SURE / _SQUARES[1]), round(_UNIT * _LOCAL / _SQUARES[0])
    # A large square that reaches over the rim of a speck does not make its middle part of it.
    bad |= ((many > _ZERO + limit) & (few > _ZERO + near)) | ((many < _ZERO - limit) & (few < _ZERO - near))
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
    way = walk(lattice, gain.own)
    places = (way.middles, way.own, way.starts, way.ahead, level, *gain.shape(lattice))
    found, number, warning = [], 0, ""
    margin = _SQUARES[-1] // 2
    far = np.empty((min(height, _BAND + 2 * margin), width), np.uint8)
    for top in range(0, height, _BAND):
        start, stop = max(0, top - margin), min(height, top + _BAND + margin)
        band = far[: stop - start]
        _departures(picture, start, band, 1 / fit.spread, fit.windows, 1 / _FLOOR, *places)
        bad = np.argwhere(_marked(band)[top - start : top - start + _BAND])
        number += len(bad)
        # More than can be defects are counted, but not kept.
        if number <= _MOST * width * height:
            found.append((bad + np.array([top, 0]))[:, ::-1].astype(np.int32))
    pixels = np.concatenate(found) if found else np.zeros((0, 2), np.int32)
    if number > _MOST * width * height:
        warning = (
            f"{number / (width * height):.1%} of the pixels differ from the gain map, too many for defects: none are "
            "recorded; check the white image for structure or saturation"
        )
        pixels = pixels[:0]
    return Defects(pixels, lattice.indices()[dark].astype(np.int32)), warning
