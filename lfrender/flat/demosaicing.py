"""Colour from a filter mosaic, without colour bleeding from one microimage into the next."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.fastmath import FAST

from .distorted_lookup import displacement_at, lens_displacements, nearest_index

__all__ = ["SUPPORT", "demosaic"]

# Differences below this share of white say nothing about the direction of an edge: noise and rounding make them.
_EVEN = 0.01
# A guide that differs by this share of white belongs to another surface, more likely than not.
_ALIKE = 0.08
# Weight of a pixel 0, 1 and 2 rows or columns away: farther ones have lost the colour.
_NEAR = np.exp(-0.5 * np.arange(3.0) ** 2).astype(np.float32)
#: Colours are taken from so far away [px]: two, by a colour that is taken there from two, whose green is from two.
SUPPORT = 6
_COLOURS = {"R": 0, "G": 1, "B": 2}


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _owners(origin, inverse, basis, bend, low, left, top, out):
    """Number of the lens whose centre is nearest to each pixel; alike for no two lenses that could be neighbours."""
    height, width = out.shape
    bent = bend.size > 0
    for y in prange(height):
        for x in range(width):
            i, j = nearest_index(float(left + x), float(top + y), origin, inverse, bend, low)
            dx = left + x - origin[0] - i * basis[0, 0] - j * basis[1, 0]
            dy = top + y - origin[1] - i * basis[0, 1] - j * basis[1, 1]
            nearest = np.inf
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    ex = dx - di * basis[0, 0] - dj * basis[1, 0]
                    ey = dy - di * basis[0, 1] - dj * basis[1, 1]
                    if bent:
                        bend_x, bend_y = displacement_at(bend, low, i + di, j + dj)
                        ex, ey = ex - bend_x, ey - bend_y
                    square = ex * ex + ey * ey
                    if square < nearest:
                        nearest = square
                        out[y, x] = ((int(i) + di) & 127) * 128 + ((int(j) + dj) & 127)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _is(owner, own, y, x):
    """Whether a pixel is on the flat and belongs to the microimage `own`."""
    return 0 <= y < owner.shape[0] and 0 <= x < owner.shape[1] and owner[y, x] == own


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _along(flat, owner, y, x, step_y, step_x):
    """Green at a red or blue pixel from its two neighbours in one direction, the change there, and how many took part.

    The bend of the pixel's own colour is added, as all colours of an edge bend alike (Hamilton and Adams 1997).
    """
    own, here = owner[y, x], np.float32(flat[y, x])
    total = change = np.float32(0.0)
    count = 0
    first = np.float32(0.0)
    for side in (-1, 1):
        y1, x1, y2, x2 = y + side * step_y, x + side * step_x, y + 2 * side * step_y, x + 2 * side * step_x
        if not _is(owner, own, y1, x1):
            continue
        green = np.float32(flat[y1, x1])
        bend = np.float32(0.5) * (here - np.float32(flat[y2, x2])) if _is(owner, own, y2, x2) else np.float32(0.0)
        total += green + bend
        change += bend
        if count == 1:
            change = abs(change) + abs(green - first)
        first = green
        count += 1
    return total / max(count, 1), abs(change), count


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _fill_green(flat, owner, colours, even, out):
    height, width = flat.shape
    for y in prange(height):
        for x in range(width):
            if colours[y & 1, x & 1] == 1:
                out[y, x, 1] = flat[y, x]
                continue
            across, change_x, count_x = _along(flat, owner, y, x, 0, 1)
            down, change_y, count_y = _along(flat, owner, y, x, 1, 0)
            weight_x = count_x * count_x / (change_x * change_x + even * even)
            weight_y = count_y * count_y / (change_y * change_y + even * even)
            if count_x + count_y > 0:
                out[y, x, 1] = max((weight_x * across + weight_y * down) / (weight_x + weight_y), np.float32(0.0))
            else:
                out[y, x, 1] = flat[y, x]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _guided(flat, owner, colours, wanted, guide, y, x, near, alike, out):
    """One colour from another: that plus their mean difference at the wanted pixels around, of the same lens.

    `near` weighs them by rows and columns of distance; those where the guide differs by more than `alike` count less.
    """
    reach = len(near) - 1
    total = weights = np.float32(0.0)
    for v in range(y - reach, y + reach + 1):
        for u in range(x - reach, x + reach + 1):
            if colours[v & 1, u & 1] == wanted and _is(owner, owner[y, x], v, u):
                unlike = out[v, u, guide] - out[y, x, guide]
                weight = near[abs(v - y)] * near[abs(u - x)] / (unlike * unlike + alike * alike)
                total += weight * (np.float32(flat[v, u]) - out[v, u, guide])
                weights += weight
    if weights > 0:
        total /= weights
    return max(out[y, x, guide] + total, np.float32(0.0))


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _fill_colour(flat, owner, colours, colour, near, alike, out):
    """Red or blue, with green as the guide."""
    height, width = flat.shape
    for y in prange(height):
        for x in range(width):
            if colours[y & 1, x & 1] == colour:
                out[y, x, colour] = flat[y, x]
            else:
                out[y, x, colour] = _guided(flat, owner, colours, colour, 1, y, x, near, alike, out)


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _refill_rim(flat, owner, colours, near, alike, out):
    """Green at the rim of a microimage, where a neighbour for the edge rule is missing: the own colour guides."""
    height, width = flat.shape
    for y in prange(height):
        for x in range(width):
            own, colour = owner[y, x], colours[y & 1, x & 1]
            if colour != 1 and not (
                _is(owner, own, y - 1, x)
                and _is(owner, own, y + 1, x)
                and _is(owner, own, y, x - 1)
                and _is(owner, own, y, x + 1)
            ):
                out[y, x, 1] = _guided(flat, owner, colours, 1, colour, y, x, near, alike, out)


def demosaic(flat: NDArray, calibration: Calibration, corner: tuple[int, int] = (0, 0)) -> NDArray:
    """Colour flat from one behind a colour filter mosaic; any other flat is given back as it is.

    Green is interpolated along edges, red and blue by their difference to green (J. F. Hamilton and J. E. Adams,
    US patent 5629734, 1997) at places of like green, each pixel from pixels of its own microimage alone.

    Parameters
    ----------
    flat : (H, W) uint8, uint16 or float
        Of the calibration's image size, or a part of such.
    calibration : Calibration
        Its `mosaic` names the filters; None means that there are none.
    corner : (int, int) [px]
        Flat coordinates x, y of the first pixel of a part, both even. Its outermost pixels, up to `SUPPORT`, are not
        those of the whole.

    Returns
    -------
    (H, W, 3) array of the type of `flat`, or `flat` itself where it has channels or the camera no mosaic
    """
    pixels = np.asarray(flat)
    if pixels.ndim != 2 or calibration.mosaic is None:
        return pixels
    colours = np.array([_COLOURS[letter] for letter in calibration.mosaic], np.int8).reshape(2, 2)
    if corner[0] % 2 or corner[1] % 2:
        raise ValueError(f"corner must be two even numbers, or colours are exchanged; got {corner}")
    owner = _owner_of_pixels(calibration.lattice, corner, pixels.shape)
    white = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else 1.0
    out = np.empty((*pixels.shape, 3), np.float32)
    _fill_green(pixels, owner, colours, np.float32(_EVEN * white), out)
    alike = np.float32(_ALIKE * white)
    for colour in (0, 2):
        _fill_colour(pixels, owner, colours, colour, _NEAR, alike, out)
    _refill_rim(pixels, owner, colours, _NEAR, alike, out)
    if pixels.dtype.kind == "f":
        return out.astype(pixels.dtype, copy=False)
    return np.minimum(np.rint(out, out=out), white).astype(pixels.dtype)


def _owner_of_pixels(lattice: Lattice, corner: tuple[int, int], shape: tuple[int, ...]) -> NDArray[np.int32]:
    owner = np.empty(shape, np.int32)
    bend, low = lens_displacements(lattice)
    _owners(lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, bend, low, *corner, owner)
    return owner
