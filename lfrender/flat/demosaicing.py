"""Colour from a colour filter mosaic, each pixel from pixels of its own microimage alone.

Green is interpolated along edges, red and blue by their difference to green (J. F. Hamilton and J.
E. Adams, US patent 5629734, 1997), from pixels of similar green.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.kernels import FAST, kernel

from .lens_graph import displacement_at, lens_displacements, nearest_index

__all__ = ["SUPPORT", "demosaic"]

#: A colour depends on pixels up to so far away [px]: two, times three steps of interpolation.
SUPPORT = 6
_COLOURS = {"R": 0, "G": 1, "B": 2}
# Smaller differences do not show the direction of an edge: noise and rounding [white].
_EVEN = 0.01
# [pixels] largest part of which the lens of each pixel is kept for the next flat.
_MOST_KEPT = 1 << 24
# A guide that differs by more belongs to another surface, more likely than not [white].
_SIMILAR = 0.08


class _Mosaic(NamedTuple):
    """A flat (H, W) behind colour filters, as kernels take it: number of the lens of each pixel (H,
    W), colour of the 2 x 2 filters, weight of a pixel 0, 1 and 2 rows or columns away, and
    difference of a guide that halves it.
    """

    flat: NDArray
    lens: NDArray[np.int32]
    colours: NDArray[np.int8]
    near: NDArray[np.float32]
    similar: np.float32


@kernel(
    share=lambda origin, inverse, basis, displacement, low, left, top, out: len(out), fastmath=FAST
)
def _number_lenses(begin, end, origin, inverse, basis, displacement, low, left, top, out):
    """Number of the lens whose centre is nearest to each pixel; different for lenses that could be
    neighbours.
    """
    width = out.shape[1]
    distorted = displacement.size > 0
    for y in range(begin, end):
        for x in range(width):
            i, j = nearest_index(
                float(left + x), float(top + y), origin, inverse, displacement, low
            )
            dx = left + x - origin[0] - i * basis[0, 0] - j * basis[1, 0]
            dy = top + y - origin[1] - i * basis[0, 1] - j * basis[1, 1]
            nearest = np.inf
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    ex = dx - di * basis[0, 0] - dj * basis[1, 0]
                    ey = dy - di * basis[0, 1] - dj * basis[1, 1]
                    if distorted:
                        bend_x, bend_y = displacement_at(displacement, low, i + di, j + dj)
                        ex = ex - bend_x
                        ey = ey - bend_y
                    square = ex * ex + ey * ey
                    if square < nearest:
                        nearest = square
                        out[y, x] = ((int(i) + di) & 127) * 128 + ((int(j) + dj) & 127)


@njit(fastmath=FAST, inline="always")
def _belongs(lens, own, y, x):
    """Whether a pixel is on the flat and belongs to the microimage `own`."""
    return 0 <= y < lens.shape[0] and 0 <= x < lens.shape[1] and lens[y, x] == own


@njit(fastmath=FAST, inline="always")
def _interpolate_green(flat, lens, y, x, step_y, step_x):
    """Green at a red or blue pixel from its two neighbours in one direction, the change there, and
    their number.

    Half the second difference of the pixel's own colour is added, as all colours change alike at an
    edge.
    """
    own = lens[y, x]
    here = np.float32(flat[y, x])
    total = change = np.float32(0.0)
    count = 0
    first = np.float32(0.0)
    for side in (-1, 1):
        y1 = y + side * step_y
        x1 = x + side * step_x
        y2 = y + 2 * side * step_y
        x2 = x + 2 * side * step_x
        if not _belongs(lens, own, y1, x1):
            continue
        green = np.float32(flat[y1, x1])
        bend = (
            np.float32(0.5) * (here - np.float32(flat[y2, x2]))
            if _belongs(lens, own, y2, x2)
            else np.float32(0.0)
        )
        total += green + bend
        change += bend
        if count == 1:
            change = abs(change) + abs(green - first)
        first = green
        count += 1
    return total / max(count, 1), abs(change), count


@kernel(share=lambda mosaic, *_: len(mosaic.flat), fastmath=FAST)
def _fill_green(begin, end, mosaic, even, out):
    """Green by the directions of edges; changes below `even` do not show one."""
    flat = mosaic.flat
    lens = mosaic.lens
    colours = mosaic.colours
    width = flat.shape[1]
    for y in range(begin, end):
        for x in range(width):
            if colours[y & 1, x & 1] == 1:
                out[y, x, 1] = flat[y, x]
                continue
            across, change_x, count_x = _interpolate_green(flat, lens, y, x, 0, 1)
            down, change_y, count_y = _interpolate_green(flat, lens, y, x, 1, 0)
            weight_x = count_x * count_x / (change_x * change_x + even * even)
            weight_y = count_y * count_y / (change_y * change_y + even * even)
            if count_x + count_y > 0:
                out[y, x, 1] = max(
                    (weight_x * across + weight_y * down) / (weight_x + weight_y), np.float32(0.0)
                )
            else:
                out[y, x, 1] = flat[y, x]


@njit(fastmath=FAST, inline="always")
def _has_green_beside(lens, y, x):
    """Whether all four neighbours of a red or blue pixel belong to its microimage."""
    own = lens[y, x]
    return (
        _belongs(lens, own, y - 1, x)
        and _belongs(lens, own, y + 1, x)
        and _belongs(lens, own, y, x - 1)
        and _belongs(lens, own, y, x + 1)
    )


@kernel(share=lambda mosaic, *_: len(mosaic.flat), fastmath=FAST)
def _fill_colour(begin, end, mosaic, wanted, out):
    """Red or blue guided by green, or green at the rim of a microimage guided by the colour of the
    pixel: the guide plus the mean difference at the pixels around of the `wanted` colour, weighted
    by distance and by similarity of the guide.
    """
    flat = mosaic.flat
    lens = mosaic.lens
    colours = mosaic.colours
    near = mosaic.near
    similar2 = mosaic.similar * mosaic.similar
    reach = len(near) - 1
    for y in range(begin, end):
        for x in range(flat.shape[1]):
            colour = colours[y & 1, x & 1]
            if colour == wanted:
                out[y, x, wanted] = flat[y, x]
                continue
            if wanted == 1 and _has_green_beside(lens, y, x):
                continue
            guide = np.int64(colour) if wanted == 1 else 1
            own = lens[y, x]
            here = out[y, x, guide]
            left = x - reach
            total = weights = np.float32(0.0)
            for v in range(y - reach, y + reach + 1):
                # Every second pixel of a row has a colour, or none.
                first = left if colours[v & 1, left & 1] == wanted else left + 1
                if colours[v & 1, first & 1] != wanted:
                    continue
                for u in range(first, x + reach + 1, 2):
                    if _belongs(lens, own, v, u):
                        unlike = out[v, u, guide] - here
                        weight = near[abs(v - y)] * near[abs(u - x)]
                        weight /= unlike * unlike + similar2
                        total += weight * (np.float32(flat[v, u]) - out[v, u, guide])
                        weights += weight
            if weights > 0:
                total /= weights
            out[y, x, wanted] = max(here + total, np.float32(0.0))


def demosaic(flat: NDArray, calibration: Calibration, corner: tuple[int, int] = (0, 0)) -> NDArray:
    """Colour flat from one behind a colour filter mosaic; any other flat is returned as it is.

    Parameters
    ----------
    flat : (H, W) uint8, uint16 or float
        Of the calibration's image size, or a part of such.
    calibration : Calibration
        Its `mosaic` names the filters; None means that there are none.
    corner : (int, int) [px]
        Flat coordinates x, y of the first pixel of a part, both even. Its outermost pixels, up to
        `SUPPORT`, differ from those of the whole.

    Returns
    -------
    (H, W, 3) array of the type of `flat`
        Or `flat` itself if it has channels or the camera has no mosaic.

    Examples
    --------
    A flat of even colour behind a mosaic gets that colour at every pixel:

    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice((8, 8), ((8, 0), (0, 8)), (32, 24), 4.0), mosaic="RGGB")
    >>> flat = np.tile(np.array([[90, 120], [120, 40]], np.uint8), (12, 16))
    >>> np.unique(demosaic(flat, camera).reshape(-1, 3), axis=0)
    array([[ 90, 120,  40]], dtype=uint8)
    """
    pixels = np.asarray(flat)
    if pixels.ndim != 2 or calibration.mosaic is None:
        return pixels
    if corner[0] % 2 or corner[1] % 2:
        raise ValueError(f"corner must be two even numbers, or colours are exchanged; got {corner}")
    white = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else 1.0
    # Frames of live cameras follow one another; 16 megapixels take 64 MB.
    if pixels.size <= _MOST_KEPT:
        lens = calibration.lattice.derived(_lens_of_pixels, corner, pixels.shape)
    else:
        lens = _lens_of_pixels(calibration.lattice, corner, pixels.shape)
    mosaic = _Mosaic(
        pixels,
        lens,
        np.array([_COLOURS[letter] for letter in calibration.mosaic], np.int8).reshape(2, 2),
        np.exp(-0.5 * np.arange(3.0) ** 2).astype(np.float32),
        np.float32(_SIMILAR * white),
    )
    out = np.empty((*pixels.shape, 3), np.float32)
    _fill_green(mosaic, np.float32(_EVEN * white), out)
    for colour in (0, 2, 1):
        _fill_colour(mosaic, colour, out)
    if pixels.dtype.kind == "f":
        return out.astype(pixels.dtype, copy=False)
    return np.minimum(np.rint(out, out=out), white).astype(pixels.dtype)


def _lens_of_pixels(
    lattice: Lattice, corner: tuple[int, int], shape: tuple[int, ...]
) -> NDArray[np.int32]:
    lens = np.empty(shape, np.int32)
    displacement, low = lens_displacements(lattice)
    _number_lenses(
        lattice.origin,
        np.linalg.inv(lattice.basis),
        lattice.basis,
        displacement,
        low,
        *corner,
        lens,
    )
    return lens
