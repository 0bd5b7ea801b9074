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

from .fastmath import FAST
from .neighbours import neighbour_rows
from .radiance import GrayFlat

__all__ = ["SHADING", "flatten_shading"]

# Contrast (white = 1) that shading may well have: stronger patterns in common are more likely the scene's.
SHADING = np.float32(0.02)
# Contrast below which lenses are equally smooth: a few grey levels of 8 bits.
_SMOOTH = 0.01
# Lenses up to this many pitches away share the shading; nearer than one pitch there are none.
_NEARBY = 4.2
# An average counts as common as far as its energy exceeds this many times that of unrelated pictures.
_SIGNIFICANT = np.float32(2.0)
# Vector loops take so many values at a time: rows of microimages are read to a whole number of these, and what lies
# beyond their end is not looked at.
_BUNCH = 8


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _subtract_shading(image, centres, wanted, rows, weights, means, contrast, radius, out):
    height, width = image.shape
    side = int(2 * radius) + 3
    wide = (side + _BUNCH - 1) // _BUNCH * _BUNCH
    for lens in prange(len(centres)):
        if not wanted[lens]:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        top, bottom = max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius)))
        left, right = max(0, int(np.ceil(cx - radius))), min(width - 1, int(np.floor(cx + radius)))
        shade = np.zeros((side, wide), np.float32)
        total = expected = np.float32(0.0)
        for r in range(rows.shape[1]):
            other = rows[lens, r]
            if other < 0:
                continue
            tx, ty = centres[other, 0] - cx, centres[other, 1] - cy
            x0, y0 = int(np.floor(tx)), int(np.floor(ty))
            # Lenses cut by the border would average only part of the microimage.
            if top + y0 < 0 or left + x0 < 0 or bottom + y0 > height - 2 or right + x0 > width - 2:
                continue
            fx, fy = np.float32(tx - x0), np.float32(ty - y0)
            w, mean = weights[other], means[other]
            w00, w01 = w * (1 - fx) * (1 - fy), w * fx * (1 - fy)
            w10, w11 = w * (1 - fx) * fy, w * fx * fy
            total += w
            expected += (w * contrast[other]) ** 2
            offset = w * mean
            n = wide if left + x0 + wide < width else right - left + 1
            for y in range(top, bottom + 1):
                upper = image[y + y0, left + x0 : left + x0 + n + 1]
                lower = image[y + y0 + 1, left + x0 : left + x0 + n + 1]
                into = shade[y - top]
                for k in range(n):
                    into[k] += w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1] - offset
        if total == 0:
            continue
        energy = np.float32(1e-9)
        count = 0
        for y in range(top, bottom + 1):
            half = np.sqrt(max(np.float32(0.0), radius * radius - (y - cy) * (y - cy)))
            for x in range(max(left, int(np.ceil(cx - half))), min(right, int(np.floor(cx + half))) + 1):
                energy += (shade[y - top, x - left] / total) ** 2
                count += 1
        energy /= max(count, 1)
        share = max(np.float32(0.0), 1 - _SIGNIFICANT * expected / (total * total * energy))
        share *= SHADING**2 / (SHADING**2 + energy) / total
        if share <= 0:
            continue
        for y in range(top, bottom + 1):
            half = np.sqrt(max(np.float32(0.0), radius * radius - (y - cy) * (y - cy)))
            for x in range(max(left, int(np.ceil(cx - half))), min(right, int(np.floor(cx + half))) + 1):
                out[y, x] = image[y, x] - share * shade[y - top, x - left]


def flatten_shading(
    gray: GrayFlat,
    lattice: Lattice,
    means: NDArray[np.float32],
    contrast: NDArray[np.float32],
    wanted: NDArray[np.bool_],
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
    """
    span = np.arange(-6, 7)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    # Three interleaved lens types lie at (i - j) mod 3; on other arrays this is any third of the lenses.
    same = (distance > 0) & (distance < _NEARBY * lattice.pitch) & ((steps[:, 0] - steps[:, 1]) % 3 == 0)
    weights = _SMOOTH**2 / (_SMOOTH**2 + contrast**2)
    out = gray.image.copy()
    _subtract_shading(
        gray.image, gray.centres, wanted, neighbour_rows(lattice, steps[same]), weights.astype(np.float32), means,
        contrast, np.float32(gray.radius), out,
    )  # fmt: skip
    return dataclasses.replace(gray, image=out)
