"""Shading that microimages have in common, whatever the scene: found by averaging nearby lenses, and removed.

Left in, it makes neighbouring microimages look alike without any shift, and every smooth lens
claims a patch size of zero. It is what vignetting correction leaves behind, or what it has added
where the black level was not subtracted first.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST

from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached
from .gray_flat import GrayFlat
from .lens_graph import count_neighbours, neighbour_rows
from .microimages import extract_strips

__all__ = ["MAX_SHADING_CONTRAST", "remove_shading"]

# Contrast (white = 1) that shading may well have: stronger patterns in common are more likely the scene's.
MAX_SHADING_CONTRAST = np.float32(0.02)
# Contrast below which lenses are equally smooth: a few grey levels of 8 bits.
_SMOOTH = 0.01
# Lenses up to this many pitches away share the shading; nearer than one pitch there are none.
_NEARBY = 4.2
# An average counts as common as far as its energy exceeds this many times that of unrelated pictures.
_SIGNIFICANT = np.float32(2.0)
# Vector loops take so many values at a time: what lies beyond the end of a strip is not looked at.
_BUNCH = 32
# What is said of a microimage is read from it and so many pixels beyond.
_BESIDE = 2
# So many lenses share the memory that their sums are in.
_TOGETHER = 32


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_strip(strip, aside, down, count, w00, w01, w10, w11, shade):
    """Add what lies between the pixels of a strip to `shade`, for `count` places."""
    a00, a01 = strip[aside : aside + count], strip[aside + 1 : aside + 1 + count]
    a10, a11 = strip[aside + down : aside + down + count], strip[aside + down + 1 : aside + down + 1 + count]
    for k in range(count):
        shade[k] += w00 * a00[k] + w01 * a01[k] + w10 * a10[k] + w11 * a11[k]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _add_lenses(strips, middle, whole, width, centres, near, lens, weights, contrast, shade):
    """Weighted sum of what the lenses `near` one show at its pixels, less their means; the sum of the weights, and the
    energy that unrelated pictures would have."""
    size, count = width * width, len(shade)
    # The first row, and the first pixel of the next one, are there to be read beside it.
    start, one = width + 1, np.float32(1.0)
    total = expected = np.float32(0.0)
    for r in range(len(near)):
        other = near[r]
        # Lenses cut by the border would average only part of the microimage.
        if other < 0 or not whole[other]:
            continue
        tx = centres[other, 0] - centres[lens, 0] - np.float32(middle[other, 0] - middle[lens, 0])
        ty = centres[other, 1] - centres[lens, 1] - np.float32(middle[other, 1] - middle[lens, 1])
        floor_x, floor_y = np.floor(tx), np.floor(ty)
        fx, fy = tx - floor_x, ty - floor_y
        w = weights[other]
        w01, w11 = w * fx * (one - fy), w * fx * fy
        w00, w10 = w * (one - fy) - w01, w * fy - w11
        total += w
        expected += (w * contrast[other]) * (w * contrast[other])
        _add_strip(
            strips, other * size + start + int(floor_y) * width + int(floor_x), width, count, w00, w01, w10, w11, shade
        )
    return total, expected


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _chord(centre_x, centre_y, y, radius, width):
    """First and last pixel of row `y` of the flat inside a circle."""
    half = np.sqrt(max(np.float32(0.0), radius * radius - (y - centre_y) * (y - centre_y)))
    return max(0, int(np.ceil(centre_x - half))), min(width - 1, int(np.floor(centre_x + half)))


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _mean_square(shade, wide, left, top, cx, cy, radius, width, height):
    """Mean square of what lies in a microimage."""
    energy = np.float32(0.0)
    count = 0
    for y in range(max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1):
        first, last = _chord(cx, cy, y, radius, width)
        at = (y - top) * wide - left
        row = shade[at + first : at + last + 1]
        for k in range(len(row)):
            energy += row[k] * row[k]
        count += len(row)
    return energy / np.float32(max(count, 1))


@njit(cache=True, nogil=True, error_model="numpy")
def _take_away(row, shade, share, out):
    for k in range(len(row)):
        out[k] = row[k] - share * shade[k]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _subtract_shading(
    image, centres, wanted, near, weights, contrast, radius, strips, middle, whole, half, width, fresh,
    everywhere, out,
):  # fmt: skip
    height, across = image.shape
    if fresh and everywhere:
        for y in prange(height):
            out[y] = image[y]
    elif fresh:
        reach = radius + np.float32(_BESIDE)
        for lens in prange(len(centres)):
            if wanted[lens]:
                left, right = int(centres[lens, 0] - reach), int(centres[lens, 0] + reach) + 2
                top, bottom = int(centres[lens, 1] - reach), int(centres[lens, 1] + reach) + 2
                for y in range(max(top, 0), min(bottom, height)):
                    for x in range(max(left, 0), min(right, across)):
                        out[y, x] = image[y, x]
    # Strips, `width` pixels a row, have a border of one pixel about what is in `shade`.
    count = ((width - 2) * width + _BUNCH - 1) // _BUNCH * _BUNCH
    for part in prange((len(centres) + _TOGETHER - 1) // _TOGETHER):
        shade = np.empty(count, np.float32)
        for lens in range(part * _TOGETHER, min((part + 1) * _TOGETHER, len(centres))):
            if not wanted[lens]:
                continue
            shade[:] = 0.0
            total, expected = _add_lenses(
                strips, middle, whole, width, centres, near[lens], lens, weights, contrast, shade
            )
            if total == 0:
                continue
            cx, cy = centres[lens, 0], centres[lens, 1]
            left, top = middle[lens, 0] - half + 1, middle[lens, 1] - half + 1
            energy = _mean_square(shade, width, left, top, cx, cy, radius, across, height) / (total * total)
            energy += np.float32(1e-9)
            share = max(np.float32(0.0), np.float32(1.0) - _SIGNIFICANT * expected / (total * total * energy))
            share *= MAX_SHADING_CONTRAST**2 / (MAX_SHADING_CONTRAST**2 + energy) / total
            if share <= 0:
                continue
            for y in range(max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1):
                first, last = _chord(cx, cy, y, radius, across)
                at = (y - top) * width - left
                _take_away(
                    image[y, first : last + 1], shade[at + first : at + last + 1], share, out[y, first : last + 1]
                )


def _steps_of_type(lattice: Lattice) -> NDArray[np.int64]:
    """(k, 2) index steps to the lenses nearby that share the shading of one of their type."""
    span = np.arange(-6, 7)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    # Three interleaved lens types lie at (i - j) mod 3; on other arrays this is any third of the lenses.
    same = (distance > 0) & (distance < _NEARBY * lattice.pitch) & ((steps[:, 0] - steps[:, 1]) % 3 == 0)
    return steps[same]


def remove_shading(
    gray: GrayFlat,
    lattice: Lattice,
    means: NDArray[np.float32],
    contrast: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    others: GrayFlat | None = None,
    everywhere: bool = True,
) -> GrayFlat:
    """`gray` without the pattern that the lenses around each lens, of its own type, have in common.

    The scene moves from lens to lens and averages out, shading stays (a shrinkage estimate after
    James and Stein 1961). A scene without any disparity stays too: only as much of a pattern is
    removed as shading can account for.

    Parameters
    ----------
    gray : GrayFlat
    lattice : Lattice
    means, contrast : (n,) float32
        Mean and standard deviation of every microimage.
    wanted : (n,) bool
        Lenses to take it from; the others stay as they are.
    others : GrayFlat, optional
        `gray` without the shading of some other lenses, which becomes the answer.
    everywhere : bool
        Pixels beyond the wanted lenses are those of `gray`; they may else be anything.
    """
    if others is not None and not wanted.any():
        return others
    weights = _SMOOTH**2 / (_SMOOTH**2 + contrast**2)
    # What all lenses show is read many times: as strips, in long loops. Their centres differ by less than a pixel.
    near = neighbour_rows(lattice, cached(lattice, "of its type", lambda: _steps_of_type(lattice)))
    read = None
    if not wanted.all():
        # For every step there is the opposite one.
        read = count_neighbours(wanted, near) > 0
    strips = extract_strips(gray, means, 1, read)
    out = allocate_pooled(gray.image.shape, np.float32) if others is None else others.image
    _subtract_shading(
        gray.image, gray.centres, wanted, near, weights.astype(np.float32), contrast,
        np.float32(gray.radius), strips.values, strips.centre_pixels, strips.complete, strips.half_width, strips.width,
        others is None, everywhere, out,
    )  # fmt: skip
    return dataclasses.replace(gray, image=out)
