"""Find defects: pixels of a white image that are further from the gain map than noise can take them."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from ..gain.defects import Defects
from ..gain.gain_map import GainMap
from ..gain.kernel import evaluate_level, evaluate_shape
from ..gain.rows import ASIDE, walk
from ..gain.vectorized import make_edge_table, relative_light_general, relative_light_round
from ..lattice.lattice import Lattice
from .gain_fit import GainFit

__all__ = ["MOST", "find_defects"]

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
# Pixels of a lens looked at together.
_ROOM = 4096
#: More defects than this share of the pixels are no defects but a model that does not fit.
MOST = 0.02


@njit(cache=True, nogil=True, error_model="numpy")
def _sides(a, b, middles, ahead, height, faces):
    """First row, and last but one, of the cell of a lens, and into `faces` (6, 2) where its sides are.

    A side is at `faces[k, 0] - y * faces[k, 1]`, the three to the right first; of each pair of opposite neighbours one
    is there. Both lenses beside a side find it in the same place, to the last bit.
    """
    top, bottom, far = 0.0, float(height), 0.0
    cx, cy = middles[b, a, 0], middles[b, a, 1]
    right, left = 0, 3
    for k in range(6):
        faces[k, 0], faces[k, 1] = np.inf if k < 3 else -np.inf, 0.0
    for k in range(len(ahead)):
        u, v = a + ahead[k, 0], b + ahead[k, 1]
        dx, dy = middles[v, u, 0] - cx, middles[v, u, 1] - cy
        x, y = 0.5 * (middles[v, u, 0] + cx), 0.5 * (middles[v, u, 1] + cy)
        far = max(far, dx * dx + dy * dy)
        if dx > ASIDE and right < 3:
            faces[right, 0], faces[right, 1] = x + y * (dy / dx), dy / dx
            right += 1
        elif dx < -ASIDE and left < 6:
            faces[left, 0], faces[left, 1] = x + y * (dy / dx), dy / dx
            left += 1
        elif dy > 0:
            bottom = min(bottom, y)
        else:
            top = max(top, y)
    # No corner of a reduced cell is farther than its farthest neighbour.
    far = math.sqrt(far)
    return max(math.ceil(top), math.ceil(cy - far)), min(math.ceil(bottom), math.floor(cy + far) + 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ends(y, faces, width):
    """First pixel of a row in a cell, and the first one beyond it."""
    high = min(faces[0, 0] - y * faces[0, 1], faces[1, 0] - y * faces[1, 1])
    high = min(min(high, faces[2, 0] - y * faces[2, 1]), float(width))
    low = max(faces[3, 0] - y * faces[3, 1], faces[4, 0] - y * faces[4, 1])
    low = max(max(low, faces[5, 0] - y * faces[5, 1]), 0.0)
    return math.ceil(low), math.ceil(high)


@njit(cache=True, nogil=True, error_model="numpy")
def _taken(picture, y, left, right, cx, cy, pixels, count):
    """Put distance from the centre and tone of a row of pixels into `pixels` (3, k) from `count` on; the next place."""
    # Indices without a sign need no look at it, so that several pixels are moved at once.
    row, start, at, across, down, tone = (
        np.uintp(y), np.uintp(left), np.uintp(count), np.uintp(0), np.uintp(1), np.uintp(2)
    )  # fmt: skip
    x, dy = left - cx, np.float32(y - cy)
    for k in range(np.uintp(right - left)):
        pixels[across, at + k] = x + np.float64(k)
        pixels[down, at + k] = dy
        pixels[tone, at + k] = picture[row, start + k]
    return count + right - left


@njit(cache=True, nogil=True, error_model="numpy")
def _put_back(noted, count, y, left, right, out):
    """Write what is noted from `count` on into a row of pixels; the next place."""
    row, start, at = np.uintp(y), np.uintp(left), np.uintp(count)
    for k in range(np.uintp(right - left)):
        out[row, start + k] = noted[at + k]
    return count + right - left


@njit(cache=True, nogil=True, error_model="numpy")
def _noted(tone, count, shape, ring, over, sharp, certain, out):
    """How far pixels are off as bytes, `_ZERO + _UNIT * standard deviations`; far off by themselves at the ends.

    `shape` is spent: it gets standard deviations.
    """
    sure, clip, most = np.float32(_SURE), np.float32(_CLIP), np.float32(1 / _FLOOR)
    middle, unit = np.float32(_ZERO + 0.5), np.float32(_UNIT)
    for k in range(count):
        shape[k] = (tone[k] * tone[k] * over - shape[k]) * min(certain[ring[k]] * sharp, most)
    for k in range(count):
        value = shape[k]
        byte = np.int32(middle + unit * min(max(value, -clip), clip))
        out[k] = byte if abs(value) <= sure else 255 if value > sure else 1


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _departures(
    picture, out, sure, windows, chunks, middles, own, sides, level, field, radius, profile, step, shade, rim, cut
):
    """How far pixels are off: see `_noted`."""
    height, width = picture.shape
    # Most maps have neither rims that differ with the direction nor a cut.
    plain = rim.shape[0] == 1 and not cut[4] > 0
    base, rise = profile[:-1].astype(np.float32), np.diff(profile).astype(np.float32)
    sure_32, table = sure[:-1].astype(np.float32), make_edge_table()
    for y in prange(height):
        out[y] = _ZERO
    for chunk in prange(chunks):
        powers, lens, faces = np.empty(64), np.empty(7 + rim.shape[0]), np.empty((6, 2))
        pixels, rows = np.empty((3, _ROOM + width), np.float32), np.empty((_ROOM, 3), np.int64)
        noted, ring = np.empty(_ROOM + width, np.uint8), np.empty(_ROOM + width, np.int32)
        shape, spare = np.empty(_ROOM + width, np.float32), np.empty((5, _ROOM + width), np.float32)
        for b in range(1 + chunk, middles.shape[0] - 1, chunks):
            for a in range(1, middles.shape[1] - 1):
                start, stop = _sides(a, b, middles, sides, height, faces)
                if stop <= start or own[b, a] <= 0:
                    continue
                cx, cy = middles[b, a, 0], middles[b, a, 1]
                known = False
                bright = sharp = 0.0
                y = start
                while y < stop:
                    count = kept = 0
                    while y < stop and count < _ROOM and kept < _ROOM:
                        left, right = _ends(y, faces, width)
                        if left < right:
                            rows[kept, 0], rows[kept, 1], rows[kept, 2] = y, left, right
                            kept += 1
                            count = _taken(picture, y, left, right, cx, cy, pixels, count)
                        y += 1
                    if count == 0:
                        continue
                    if not known:
                        known = True
                        evaluate_shape(cx, cy, field, radius, shade, rim, cut, powers, lens)
                        bright = own[b, a] * evaluate_level(cx, cy, field, level, powers)
                        column = min(max(int((cx + 0.5) / width * windows.shape[1]), 0), windows.shape[1] - 1)
                        line = min(max(int((cy + 0.5) / height * windows.shape[0]), 0), windows.shape[0] - 1)
                        sharp = 1 / windows[line, column]
                    if bright <= 0:
                        break
                    if plain:
                        scale = np.float32((1 - lens[7]) / step)
                        relative_light_round(pixels, count, lens, base, rise, scale, shape, ring)
                    else:
                        relative_light_general(pixels, count, lens, base, rise, step, cut, table, spare, shape, ring)
                    over = np.float32(1 / bright)
                    _noted(pixels[2], count, shape, ring, over, np.float32(sharp), sure_32, noted)
                    count = 0
                    for k in range(kept):
                        count = _put_back(noted, count, rows[k, 0], rows[k, 1], rows[k, 2], out)


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
) -> tuple[Defects, float]:  # fmt: skip
    """Defects of a white image, none where more pixels than `MOST` are further from the map than noise can take them.

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
    share : float
        Of the pixels that differ from the map.
    """
    height, width = picture.shape
    level = gain.level.copy()
    level[0] += np.log(brightest)
    way = walk(lattice, gain.lens_gain)
    places = (way.middles, way.lens_gain, way.sides, level, *gain.shape(lattice))
    # More than can be defects are counted, but not kept.
    found, number, most = [], 0, MOST * width * height
    margin = _SQUARES[-1] // 2
    far = np.empty((height, width), np.uint8)
    _departures(picture, far, 1 / fit.spread, fit.windows, _CHUNKS, *places)

    def marked_from(top: int) -> tuple[int, NDArray[np.int32]]:
        start, stop = max(0, top - margin), min(height, top + _BAND + margin)
        marked = _marked(far[start:stop])[top - start : top - start + _BAND]
        # Most rows have no defect.
        rows = np.flatnonzero(marked.any(1))
        row, column = np.nonzero(marked[rows])
        kept = slice(None if len(row) <= most else 0)
        return len(row), np.column_stack([column[kept], rows[row[kept]] + top]).astype(np.int32)

    with ThreadPoolExecutor(get_num_threads()) as threads:
        for count, pixels in threads.map(marked_from, range(0, height, _BAND)):
            number += count
            if number <= most:
                found.append(pixels)
            else:
                found.clear()
    pixels = np.concatenate(found) if found else np.zeros((0, 2), np.int32)
    share = number / (width * height)
    return Defects(pixels, lattice.indices()[dark].astype(np.int32)), share
