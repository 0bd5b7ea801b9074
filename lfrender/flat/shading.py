"""Remove the shading that nearby microimages have in common, found as their weighted average.

Residual vignetting, or vignetting correction of a flat whose black level was not subtracted, makes neighbouring
microimages alike without any shift, so that smooth lenses match at patch size 0. The scene moves from lens to lens and
averages out. The average is removed as far as it exceeds that of unrelated pictures (shrinkage after James and Stein
1961) and is no stronger than shading can be: a scene without disparity stays.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import kernel

from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached
from .gray_flat import GrayFlat
from .lens_graph import count_neighbours, neighbour_rows
from .microimages import extract_strips
from .settings import KERNEL, SHADING, ShadingSettings

__all__ = ["remove_shading"]


class _StripTable(NamedTuple):
    """Fields of `Strips` of one part, as kernels take them."""

    values: NDArray[np.float32]
    middle: NDArray[np.int32]
    complete: NDArray[np.bool_]
    half: int
    width: int


# NumPy's error model: Python's checks every division, which no vector loop can.
@njit(fastmath=FAST, error_model="numpy")
def _add_strip(strip, aside, down, count, w00, w01, w10, w11, shade):
    """Add a strip, interpolated between pixels, to the first `count` values of `shade`."""
    a00, a01 = strip[aside : aside + count], strip[aside + 1 : aside + 1 + count]
    a10, a11 = strip[aside + down : aside + down + count], strip[aside + down + 1 : aside + down + 1 + count]
    for k in range(count):
        shade[k] += w00 * a00[k] + w01 * a01[k] + w10 * a10[k] + w11 * a11[k]


@njit(fastmath=FAST, error_model="numpy")
def _add_lenses(strips, centres, near, lens, weights, contrast, shade):
    """Add the microimages of the lenses `near`, minus their means, to `shade` at the pixels of a lens.

    Returns the sum of the weights, and the energy that the sum would have if the pictures were unrelated.
    """
    middle, width = strips.middle, strips.width
    size, count = width * width, len(shade)
    # From the second row and its second pixel on: the others are there for interpolation.
    start, one = width + 1, np.float32(1.0)
    total = expected = np.float32(0.0)
    for r in range(len(near)):
        other = near[r]
        # Lenses cut by the border of the flat hold only part of the microimage.
        if other < 0 or not strips.complete[other]:
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
        aside = other * size + start + int(floor_y) * width + int(floor_x)
        _add_strip(strips.values, aside, width, count, w00, w01, w10, w11, shade)
    return total, expected


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _chord(centre_x, centre_y, y, radius, width):
    """First and last pixel of row `y` of the flat inside a circle."""
    half = np.sqrt(max(np.float32(0.0), radius * radius - (y - centre_y) * (y - centre_y)))
    return max(0, int(np.ceil(centre_x - half))), min(width - 1, int(np.floor(centre_x + half)))


@njit(fastmath=FAST, error_model="numpy")
def _mean_square(shade, wide, left, top, cx, cy, radius, width, height):
    """Mean square of `shade` within a microimage."""
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


@njit(error_model="numpy")
def _subtract_row(row, shade, share, out):
    for k in range(len(row)):
        out[k] = row[k] - share * shade[k]


@kernel(share=lambda image, _: len(image))
def _copy_image(begin, end, image, out):
    for y in range(begin, end):
        out[y] = image[y]


@kernel(error_model="numpy", share=lambda _, centres, *__: len(centres))
def _subtract_shading(
    begin, end, image, centres, wanted, near, weights, contrast, radius, largest, significance, strips, out
):  # fmt: skip
    """Subtract the common pattern from the `wanted` lenses; `near` (n, k) are rows of the lenses that share theirs."""
    height, across = image.shape
    middle, half, width = strips.middle, strips.half, strips.width
    # Strips, `width` pixels a row, have a border of one pixel about what is in `shade`.
    count = ((width - 2) * width + KERNEL.bunch - 1) // KERNEL.bunch * KERNEL.bunch
    shade = np.empty(count, np.float32)
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        shade[:] = 0.0
        total, expected = _add_lenses(strips, centres, near[lens], lens, weights, contrast, shade)
        if total == 0:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        left, top = middle[lens, 0] - half + 1, middle[lens, 1] - half + 1
        energy = _mean_square(shade, width, left, top, cx, cy, radius, across, height) / (total * total)
        energy += np.float32(1e-9)
        share = max(np.float32(0.0), np.float32(1.0) - significance * expected / (total * total * energy))
        share *= largest * largest / (largest * largest + energy) / total
        if share <= 0:
            continue
        for y in range(max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1):
            first, last = _chord(cx, cy, y, radius, across)
            at = (y - top) * width - left
            row, into = image[y, first : last + 1], out[y, first : last + 1]
            _subtract_row(row, shade[at + first : at + last + 1], share, into)


def _steps_to_same_type(lattice: Lattice, nearby: float) -> NDArray[np.int64]:
    """(k, 2) index steps to the lenses nearby that have the same type."""
    span = np.arange(-6, 7)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    # Three interleaved lens types lie at (i - j) mod 3; on other arrays this is any third of the lenses.
    same = (distance > 0) & (distance < nearby * lattice.pitch) & ((steps[:, 0] - steps[:, 1]) % 3 == 0)
    return steps[same]


def remove_shading(
    gray: GrayFlat,
    lattice: Lattice,
    means: NDArray[np.float32],
    contrast: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    others: GrayFlat | None = None,
    settings: ShadingSettings = SHADING,
) -> GrayFlat:
    """`gray` without the pattern that the lenses around each lens, of its own type, have in common.

    Parameters
    ----------
    gray : GrayFlat
    lattice : Lattice
    means, contrast : (n,) float32
        Mean and standard deviation of every microimage.
    wanted : (n,) bool
        Lenses to remove it from; the others keep it.
    others : GrayFlat, optional
        `gray` without the shading of other lenses; it is changed and returned.
    settings : ShadingSettings
    """
    if others is not None and not wanted.any():
        return others
    weights = (settings.smooth**2 / (settings.smooth**2 + contrast**2)).astype(np.float32)
    key = ("steps to the same type", settings.nearby)
    near = neighbour_rows(lattice, cached(lattice, key, lambda: _steps_to_same_type(lattice, settings.nearby)))
    # The lenses to be read; for every step there is the opposite one.
    read = None if wanted.all() else count_neighbours(wanted, near) > 0
    strips = extract_strips(gray, means, 1, read)
    table = _StripTable(strips.values, strips.centre_pixels, strips.complete, strips.half_width, strips.width)
    radius = np.float32(gray.radius)
    if others is None:
        out = allocate_pooled(gray.image.shape, np.float32)
        _copy_image(gray.image, out)
    else:
        out = others.image
    _subtract_shading(
        gray.image, gray.centres, wanted, near, weights, contrast, radius, np.float32(settings.largest_contrast),
        np.float32(settings.significance), table, out,
    )  # fmt: skip
    return dataclasses.replace(gray, image=out)
