"""Find defects: pixels of a white image that are further from the gain map than noise can take them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .defects import Defects
from .gain_fit import GainFit
from .gain_kernels import ASIDE, describe, level_at, light, walk
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
# Rows of lenses are dealt out to so many, whatever the number of threads.
_CHUNKS = 64
# More defects than this share of the pixels are no defects but a model that does not fit.
_MOST = 0.02


@njit(cache=True, nogil=True, error_model="numpy")
def _sides(a, b, middles, ahead, height, faces):
    """First row, and last but one, of the cell of a lens; `faces` (k, 4) get where its sides lie and how they lean.

    A side is at `x0 - (y - y0) * lean`, to the right of the lens where the last number is positive, else to the left.
    Both lenses beside it find it in the same place, to the last bit.
    """
    top, bottom, far = 0.0, float(height), 0.0
    cx, cy = middles[b, a, 0], middles[b, a, 1]
    for k in range(len(ahead)):
        u, v = a + ahead[k, 0], b + ahead[k, 1]
        dx, dy = middles[v, u, 0] - cx, middles[v, u, 1] - cy
        x, y = 0.5 * (middles[v, u, 0] + cx), 0.5 * (middles[v, u, 1] + cy)
        far = max(far, dx * dx + dy * dy)
        if abs(dx) > ASIDE:
            faces[k, 0], faces[k, 1], faces[k, 2], faces[k, 3] = x, y, dy / dx, dx
        else:
            faces[k, 3] = 0.0
            if dy > 0:
                bottom = min(bottom, y)
            else:
                top = max(top, y)
    # No corner of a reduced cell is farther than its farthest neighbour.
    far = math.sqrt(far)
    return max(math.ceil(top), math.ceil(cy - far)), min(math.ceil(bottom), math.floor(cy + far) + 1)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _departures(
    picture, out, sure, windows, most, chunks, middles, own, sides, level, field, radius, profile, step, shade, rim,
    cut,
):  # fmt: skip
    """How far pixels are off, as `_ZERO + _UNIT * standard deviations`; those far off by themselves at the ends."""
    height, width = picture.shape
    per_step, last = 1 / step, len(profile) - 2
    # Most maps have neither rims that differ with the direction nor a cut.
    plain = rim.shape[0] == 1 and not cut[4] > 0
    for chunk in prange(chunks):
        powers, lens, faces = np.empty(64), np.empty(7 + rim.shape[0]), np.empty((len(sides), 4))
        for b in range(1 + chunk, middles.shape[0] - 1, chunks):
            for a in range(1, middles.shape[1] - 1):
                start, stop = _sides(a, b, middles, sides, height, faces)
                if stop <= start:
                    continue
                cx, cy = middles[b, a, 0], middles[b, a, 1]
                known = False
                bright = over = scale = sharp = 0.0
                for y in range(start, stop):
                    low, high = 0.0, float(width)
                    for k in range(len(faces)):
                        side = faces[k, 0] - (y - faces[k, 1]) * faces[k, 2]
                        if faces[k, 3] > 0:
                            high = min(high, side)
                        elif faces[k, 3] < 0:
                            low = max(low, side)
                    left, right = math.ceil(low), math.ceil(high)
                    if left >= right:
                        continue
                    if not known:
                        known = True
                        describe(cx, cy, field, radius, shade, rim, cut, powers, lens)
                        bright = own[b, a] * level_at(cx, cy, field, level, powers)
                        over, scale = 1 / bright, (1 - lens[7]) * per_step
                        column = min(max(int((cx + 0.5) / width * windows.shape[1]), 0), windows.shape[1] - 1)
                        line = min(max(int((cy + 0.5) / height * windows.shape[0]), 0), windows.shape[0] - 1)
                        sharp = 1 / windows[line, column]
                    if bright <= 0:
                        continue
                    dy = y - cy
                    first, second, lean = 1 + dy * (lens[1] + lens[4] * dy), lens[0] + lens[3] * dy, lens[2]
                    for x in range(left, right):
                        dx = x - cx
                        if plain:
                            place = math.sqrt(dx * dx + dy * dy) * scale
                            ring = min(int(place), last)
                            s = profile[ring] + (profile[ring + 1] - profile[ring]) * min(place - ring, 1.0)
                            s *= first + dx * (second + lean * dx)
                        else:
                            s, stretched, _ = light(dx, dy, lens, profile, step, cut)
                            ring = min(int(stretched * per_step), last)
                        far = (picture[y, x] * picture[y, x] * over - s) * min(sure[ring] * sharp, most)
                        if -_SURE <= far <= _SURE:
                            out[y, x] = int(_ZERO + 0.5 + _UNIT * min(max(far, -_CLIP), _CLIP))
                        else:
                            out[y, x] = 255 if far > 0 else 1


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
    places = (way.middles, way.own, way.sides, level, *gain.shape(lattice))
    found, number, warning = [], 0, ""
    margin = _SQUARES[-1] // 2
    far = np.full((height, width), _ZERO, np.uint8)
    _departures(picture, far, 1 / fit.spread, fit.windows, 1 / _FLOOR, _CHUNKS, *places)
    for top in range(0, height, _BAND):
        start, stop = max(0, top - margin), min(height, top + _BAND + margin)
        bad = np.argwhere(_marked(far[start:stop])[top - start : top - start + _BAND])
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
