"""Find defects: pixels of a white image that differ from the gain map by more than noise explains.

Residuals in standard deviations are tested pixel by pixel, and as means over small and large squares, which show dust
too faint for single pixels.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from ..gain.defects import Defects
from ..gain.kernel import RIM_START, evaluate_level, evaluate_shape
from ..gain.rows import make_row_tables
from ..gain.settings import KERNEL as GAIN_KERNEL
from ..gain.vectorized import make_profile_tables, relative_light_at
from ..lattice.lattice import Lattice
from ..runtime.kernels.jit import njit
from .estimate import GainFit
from .lens_light import LensLights
from .settings import DEFECT_KERNEL, DEFECTS, DefectSettings

__all__ = ["find_defects"]


@njit(cache=True, nogil=True, error_model="numpy")
def _find_cell(a, b, centres, sides, height, faces):
    """First row, and last but one, of the cell of a lens; its left and right sides are written into `faces` (6, 2).

    A side is at `faces[k, 0] - y * faces[k, 1]`, the three to the right first; of each pair of opposite neighbours one
    is there. Both lenses beside a side compute it from the same numbers, to the last bit.
    """
    top, bottom, far = 0.0, float(height), 0.0
    cx, cy = centres[b, a, 0], centres[b, a, 1]
    right, left = 0, 3
    for k in range(6):
        faces[k, 0], faces[k, 1] = np.inf if k < 3 else -np.inf, 0.0
    for k in range(len(sides)):
        u, v = a + sides[k, 0], b + sides[k, 1]
        dx, dy = centres[v, u, 0] - cx, centres[v, u, 1] - cy
        x, y = 0.5 * (centres[v, u, 0] + cx), 0.5 * (centres[v, u, 1] + cy)
        far = max(far, dx * dx + dy * dy)
        if dx > GAIN_KERNEL.same_column and right < 3:
            faces[right, 0], faces[right, 1] = x + y * (dy / dx), dy / dx
            right += 1
        elif dx < -GAIN_KERNEL.same_column and left < 6:
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
def _find_row_ends(y, faces, width):
    """First pixel of a row in a cell, and the first one beyond it."""
    high = min(faces[0, 0] - y * faces[0, 1], faces[1, 0] - y * faces[1, 1])
    high = min(min(high, faces[2, 0] - y * faces[2, 1]), float(width))
    low = max(faces[3, 0] - y * faces[3, 1], faces[4, 0] - y * faces[4, 1])
    low = max(max(low, faces[5, 0] - y * faces[5, 1]), 0.0)
    return math.ceil(low), math.ceil(high)


@njit(cache=True, nogil=True, error_model="numpy")
def _copy_row(picture, y, left, right, cx, cy, pixels, count):
    """Write offset x, y from the centre and value of a row of pixels into `pixels` (3, k) from `count` on; the new
    count."""
    # Unsigned indices need no check for counting from the end, so that several pixels are moved at once.
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
def _write_row(coded, count, y, left, right, out):
    """Write `coded` from `count` on into a row of pixels; the new count."""
    row, start, at = np.uintp(y), np.uintp(left), np.uintp(count)
    for k in range(np.uintp(right - left)):
        out[row, start + k] = coded[at + k]
    return count + right - left


@njit(cache=True, nogil=True, error_model="numpy")
def _code_residuals(tone, count, light, ring, over, sharp, certainty, out):
    """Residuals as bytes, `zero + unit * standard deviations`; 1 or 255 for pixels that are defects by themselves.

    `light`, the expected relative light, is overwritten.
    """
    limit, clip = np.float32(DEFECT_KERNEL.significance), np.float32(DEFECT_KERNEL.clip)
    most = np.float32(1 / DEFECT_KERNEL.least_residual)
    middle, unit = np.float32(DEFECT_KERNEL.zero + 0.5), np.float32(DEFECT_KERNEL.unit)
    for k in range(count):
        light[k] = (tone[k] * tone[k] * over - light[k]) * min(certainty[ring[k]] * sharp, most)
    for k in range(count):
        value = light[k]
        byte = np.int32(middle + unit * min(max(value, -clip), clip))
        out[k] = byte if abs(value) <= limit else 255 if value > limit else 1


@njit(cache=True, nogil=True, error_model="numpy", share=lambda *given: given[3])
def _compute_residuals(begin, end, picture, certainty, windows, chunks, tables, level, shape, profile_tables, out):
    """Residuals of all pixels as bytes (`_code_residuals`), with `certainty` (k,) = 1 / spread over the distance.

    The `profile_tables` are `make_profile_tables` of the profiles (t, k) of the types of lenses.
    """
    height, width = picture.shape
    centres, lens_gain, sides, room = tables.centres, tables.lens_gain, tables.sides, DEFECT_KERNEL.room
    starts, rises, edge = profile_tables
    for chunk in range(begin, end):
        powers, lens, faces = np.empty(64), np.empty(RIM_START + shape.rim.shape[0]), np.empty((6, 2))
        pixels, rows = np.empty((3, room + width), np.float32), np.empty((room, 3), np.int64)
        coded, ring = np.empty(room + width, np.uint8), np.empty(room + width, np.int32)
        light, work = np.empty(room + width, np.float32), np.empty((5, room + width), np.float32)
        for b in range(1 + chunk, centres.shape[0] - 1, chunks):
            for a in range(1, centres.shape[1] - 1):
                start, stop = _find_cell(a, b, centres, sides, height, faces)
                if stop <= start or lens_gain[b, a] <= 0:
                    continue
                cx, cy, kind = centres[b, a, 0], centres[b, a, 1], tables.types[b, a]
                own_tables = starts[kind], rises[kind], edge
                known = False
                bright = sharp = 0.0
                y = start
                while y < stop:
                    count = kept = 0
                    while y < stop and count < room and kept < room:
                        left, right = _find_row_ends(y, faces, width)
                        if left < right:
                            rows[kept, 0], rows[kept, 1], rows[kept, 2] = y, left, right
                            kept += 1
                            count = _copy_row(picture, y, left, right, cx, cy, pixels, count)
                        y += 1
                    if count == 0:
                        continue
                    if not known:
                        known = True
                        evaluate_shape(cx, cy, shape, powers, lens)
                        bright = lens_gain[b, a] * evaluate_level(cx, cy, shape.frame, level, powers)
                        column = min(max(int((cx + 0.5) / width * windows.shape[1]), 0), windows.shape[1] - 1)
                        line = min(max(int((cy + 0.5) / height * windows.shape[0]), 0), windows.shape[0] - 1)
                        sharp = 1 / windows[line, column]
                    if bright <= 0:
                        break
                    relative_light_at(pixels, count, lens, shape, own_tables, work, light, ring)
                    over = np.float32(1 / bright)
                    _code_residuals(pixels[2], count, light, ring, over, np.float32(sharp), certainty, coded)
                    count = 0
                    for k in range(kept):
                        count = _write_row(coded, count, rows[k, 0], rows[k, 1], rows[k, 2], out)


def _mark_defects(coded: NDArray[np.uint8], settings: DefectSettings) -> NDArray[np.bool_]:
    """Which pixels are defects, given their residuals as bytes."""
    import cv2

    zero, unit, sigmas = DEFECT_KERNEL.zero, DEFECT_KERNEL.unit, DEFECT_KERNEL.significance
    bad: NDArray[np.bool_] = (coded == 255) | (coded == 1)
    sides = settings.small_square, settings.large_square
    few, many = (cv2.blur(coded, (side, side), borderType=cv2.BORDER_REFLECT) for side in sides)
    limit = round(unit * sigmas / settings.small_square)
    bad |= (few > zero + limit) | (few < zero - limit)
    limit = round(unit * sigmas / settings.large_square)
    near = round(unit * settings.local / settings.small_square)
    # A large square that reaches over the rim of a speck does not make its middle part of it.
    bad |= ((many > zero + limit) & (few > zero + near)) | ((many < zero - limit) & (few < zero - near))
    return bad


def find_defects(
    picture: NDArray[np.float32], lattice: Lattice, lights: LensLights, fit: GainFit, settings: DefectSettings = DEFECTS
) -> tuple[Defects, float]:
    """Defects of a white image; none if more than `largest_share` of the pixels differ from the gain map.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    lights : LensLights
        Gain map with the light of all lenses.
    fit : GainFit
        Noise of pixels about the map.
    settings : DefectSettings

    Returns
    -------
    defects : Defects
    share : float
        Of the pixels that differ from the map.
    """
    height, width = picture.shape
    gain, band = lights.gain, settings.band
    level = gain.level.copy()
    level[0] += np.log(lights.brightest)
    # More than can be defects are counted, but not kept.
    found, number, most = [], 0, settings.largest_share * width * height
    margin = settings.large_square // 2
    coded = np.full((height, width), DEFECT_KERNEL.zero, np.uint8)
    tables = make_row_tables(lattice, gain.lens_gain, gain.type_cell)
    shape = gain.shape(lattice)
    _compute_residuals(
        picture,
        (1 / fit.spread[:-1]).astype(np.float32),
        fit.windows,
        settings.chunks,
        tables,
        level,
        shape,
        make_profile_tables(gain.profiles),
        coded,
    )

    def search_band(top: int) -> tuple[int, NDArray[np.int32]]:
        start, stop = max(0, top - margin), min(height, top + band + margin)
        marked = _mark_defects(coded[start:stop], settings)[top - start : top - start + band]
        # Most rows have no defect.
        rows = np.flatnonzero(marked.any(1))
        row, column = np.nonzero(marked[rows])
        kept = slice(None if len(row) <= most else 0)
        return len(row), np.column_stack([column[kept], rows[row[kept]] + top]).astype(np.int32)

    with ThreadPoolExecutor(get_num_threads()) as threads:
        for count, pixels in threads.map(search_band, range(0, height, band)):
            number += count
            if number <= most:
                found.append(pixels)
            else:
                found.clear()
    pixels = np.concatenate(found) if found else np.zeros((0, 2), np.int32)
    return Defects(pixels, lattice.indices()[lights.unlit].astype(np.int32)), number / (width * height)
