"""The patch size that every pixel of a microimage shows, among those that the surface has nearby.

Each pixel is compared with the pixels that other lenses would show it at (multi-view stereo with the microimage as the
reference view), and semi-global matching (Hirschmueller 2008) inside the microimage regularises the choice. In the
first round the better part of the views counts, since some are occluded; in the second round, those views that
the first one finds occluded are left out (view selection, Schoenberger et al. 2016).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...flat.microimages import copy_box
from .candidates import list_candidates, list_depths
from .comparison import allow_mismatch, compare_depth
from .geometry import LensArray, PointGrid
from .microimage import OWN, PixelCosts, box_stride, make_microimage
from .regularisation import aggregate

__all__ = ["measure_pixel_depths"]


@njit(error_model="numpy")
def _copy_microimage(pixels, width, x, y, left, top, size, stride, work):
    """Fill the brightness and the place of the pixels of a box."""
    copy_box(pixels, width, left, top, size, stride, work.light)
    for row in range(size):
        for column in range(stride):
            work.x[row * stride + column] = left + column - x
            work.y[row * stride + column] = top + row - y


# [pitch] the part about the middle of a microimage that its own place and no other lens shows, each way.
_MIDDLE = 0.3


@njit(error_model="numpy")
def _is_blank(light, size, stride, pitch, c):
    """Whether no patch in the middle of a microimage has contrast that is seen."""
    half, reach, fifth = size // 2, int(_MIDDLE * pitch), np.float32(0.2)
    for row in range(half - reach, half + reach + 1):
        for p in range(row * stride + half - reach, row * stride + half + reach + 1):
            a, b, d, e, f = light[p - stride], light[p - 1], light[p], light[p + 1], light[p + stride]
            mean = fifth * (a + b + d + e + f)
            a, b, d, e, f = a - mean, b - mean, d - mean, e - mean, f - mean
            noise2 = c.noise2 + c.noise_share2 * mean * mean
            if fifth * (a * a + b * b + d * d + e * e + f * f) > c.seen2 * noise2:
                return False
    return True


@njit(error_model="numpy")
def _measure_lens(lens, pixels, shape, lenses, surface, grid, levels, before, c, size, work, out):
    """Fill `out` with the patch sizes of the pixels of one lens; returns the share of them that leave the surface."""
    x, y = lenses.centres[lens, 0], lenses.centres[lens, 1]
    half, stride = size // 2, box_stride(size)
    left, top = int(x + 0.5) - half, int(y + 0.5) - half
    _copy_microimage(pixels, shape[1], x, y, left, top, size, stride, work)
    number = 0 if _is_blank(work.light, size, stride, lenses.pitch, c) else list_depths(
        surface, grid, x, y, lenses, c.reach, work)  # fmt: skip
    if number == 0:
        return 0.0
    choice = list_candidates(x, y, left, top, size, stride, number, surface, grid, levels, lenses, before, c.leave,
                             c.least_jump, shape, work)  # fmt: skip
    if choice:
        allow_mismatch(work.light, stride, size * stride, c, work.allowed)
        share, known = 1.0 if before.size > 1 else c.visible_share, before.reshape(-1)
        for k in range(number):
            compare_depth(pixels, shape, lens, k, share, left, top, size, stride, lenses, known, c, work)
        aggregate(size, stride, number, lenses.gap, c, work)
    among, cost, present, total, value = work.among, work.cost, work.present, work.total, work.value
    every, moved = 0, 0
    for row in range(size):
        for column in range(work.left[row], work.right[row]):
            p, best = row * stride + column, 0
            for k in range(1, number):
                if among[p] == 1 or not choice:
                    best = k if cost[k, p] < cost[best, p] else best
                else:
                    best = k if total[k, p] < total[best, p] else best
            out[top + row, left + column] = value[best, p]
            every, moved = every + 1, moved + (present[best, p] != OWN)
    return moved / max(every, 1)


@kernel(error_model="numpy", share=lambda image, lenses, *_: len(lenses.centres))
def measure_pixel_depths(begin, end, image, lenses: LensArray, surface, grid: PointGrid, levels, wanted, before,
                         c: PixelCosts, out, moved):  # fmt: skip
    """Fill `out` (H, W) with the patch size [px] that each pixel of the microimages shows, and `moved` (n,) with the
    share of the pixels of each lens that leave the surface.

    Parameters
    ----------
    image : (H, W) float32
        Grey flat; white = 1.
    lenses : LensArray
    surface : (rows, columns) float32 [px]
    grid : PointGrid
    levels : (rows, columns) uint64
        As `mark_levels`.
    wanted : (n,) bool
        Lenses that are measured; `out` is left alone at others, and where the middle of a microimage is blank.
    before : (H, W) float32
        Result of the first round; (1, 1) in that.
    c : PixelCosts
    """
    size = 2 * (int(lenses.radius) + 2) + 1
    work = make_microimage(size)
    pixels = image.reshape(-1)
    for lens in range(begin, end):
        if wanted[lens]:
            moved[lens] = _measure_lens(lens, pixels, image.shape, lenses, surface, grid, levels, before, c, size,
                                        work, out)  # fmt: skip
