"""Steps of single microimages in scenes: each is compared with the average microimage of the whole flat.

The average microimage is a picture of one cell of the lattice, not a radial profile: rims and gaps follow the outline
of the cell. It is made the same under a half turn about its centre, so what a wrong centre would add to it cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .lattice import Lattice

__all__ = ["LensSteps", "Template", "average_cell", "lens_steps"]

# Bins of the average cell per pixel, and the most that are worth their memory.
_BINS_PER_PX = 3.0
_MOST_BINS = 210
_CHUNKS = 16
# Lenses that make an average hardly noisier than all of them would.
_TEMPLATE_LENSES = 3000
# Bins are smoothed over so many pixels, about the width of an edge.
_SMOOTH = 0.5
# Residuals beyond this many standard deviations have no say (Tukey's biweight).
_OUTLIER = 4.685
# A lens with this many times the usual contrast says no more than one with less.
_MOST_CONTRAST = 2.0


@njit(cache=True, nogil=True, parallel=True)
def _fold(picture, centres, faces, inner, reach, inverse, stride, bins, chunks, sums):
    lenses = centres.shape[0]
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            for y in range(int(np.ceil(cy - reach)) + lens % stride, int(np.floor(cy + reach)) + 1, stride):
                dy = y - cy
                half = np.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(int(np.ceil(cx - half)) + lens // stride % stride, int(np.floor(cx + half)) + 1, stride):
                    dx = x - cx
                    if dx * dx + dy * dy > inner * inner:
                        inside = True
                        for face in range(faces.shape[0]):
                            if dx * faces[face, 0] + dy * faces[face, 1] > 0.5:
                                inside = False
                                break
                        if not inside:
                            continue
                    column = int(np.floor((dx * inverse[0, 0] + dy * inverse[1, 0]) * bins + 0.5)) % bins
                    row = int(np.floor((dx * inverse[0, 1] + dy * inverse[1, 1]) * bins + 0.5)) % bins
                    value = picture[y, x]
                    sums[chunk, row, column, 0] += value
                    sums[chunk, row, column, 1] += value * value
                    sums[chunk, row, column, 2] += 1


@njit(cache=True, nogil=True, parallel=True)
def _accumulate(picture, centres, faces, inner, reach, inverse, stride, maps, cutoff, most, normal, right):
    bins = maps.shape[0]
    for lens in prange(centres.shape[0]):
        cx, cy = centres[lens, 0], centres[lens, 1]
        s = np.zeros(5)
        contrast, offset = 1.0, 0.0
        xx = xy = yy = bx = by = 0.0
        for turn in range(2):
            for y in range(int(np.ceil(cy - reach)) + lens % stride, int(np.floor(cy + reach)) + 1, stride):
                dy = y - cy
                half = np.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(int(np.ceil(cx - half)) + lens // stride % stride, int(np.floor(cx + half)) + 1, stride):
                    dx = x - cx
                    if dx * dx + dy * dy > inner * inner:
                        inside = True
                        for face in range(faces.shape[0]):
                            if dx * faces[face, 0] + dy * faces[face, 1] > 0.5:
                                inside = False
                                break
                        if not inside:
                            continue
                    column = int(np.floor((dx * inverse[0, 0] + dy * inverse[1, 0]) * bins + 0.5)) % bins
                    row = int(np.floor((dx * inverse[0, 1] + dy * inverse[1, 1]) * bins + 0.5)) % bins
                    level, w = maps[row, column, 0], maps[row, column, 1]
                    value = picture[y, x]
                    if turn == 0:
                        s[0] += w
                        s[1] += w * level
                        s[2] += w * level * level
                        s[3] += w * value
                        s[4] += w * level * value
                        continue
                    residual = value - offset - contrast * level
                    far = residual * residual * w / (cutoff * cutoff)
                    if far >= 1:
                        continue
                    w *= (1 - far) * (1 - far)
                    gx, gy = -contrast * maps[row, column, 2], -contrast * maps[row, column, 3]
                    xx += w * gx * gx
                    xy += w * gx * gy
                    yy += w * gy * gy
                    bx += w * gx * residual
                    by += w * gy * residual
            determinant = s[0] * s[2] - s[1] * s[1]
            if turn == 0 and determinant > 1e-9 * s[0] * s[2]:
                contrast = min(max((s[0] * s[4] - s[1] * s[3]) / determinant, 0.0), most)
                offset = (s[3] - contrast * s[1]) / s[0]
        normal[lens, 0, 0] = xx
        normal[lens, 0, 1] = xy
        normal[lens, 1, 0] = xy
        normal[lens, 1, 1] = yy
        right[lens, 0] = bx
        right[lens, 1] = by


@dataclass(frozen=True)
class Template:
    """Average microimage over one cell, the centre of the lens at `[0, 0]`, periodic.

    Parameters
    ----------
    maps : (bins, bins, 4) float64
        Level, inverse variance of a pixel, and slopes of the level in x and y [1/px]; column along `a1`, row along
        `a2`, `[j, i]` at `i / bins, j / bins` of the cell.
    """

    maps: NDArray[np.float64]


@dataclass(frozen=True)
class LensSteps:
    """Least squares of each lens by itself: `normal @ step = right`.

    Parameters
    ----------
    normal, right : (n, 2, 2), (n, 2) float64
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]


def average_cell(
    picture: NDArray[np.float32],
    lattice: Lattice,
    centres: NDArray[np.float64],
    cell: tuple[NDArray[np.float64], float, float],
    stride: int = 1,
) -> Template:
    """Average of `picture` (h, w) over the cells at `centres` (n, 2) [px]; `cell` its faces, in- and circumradius."""
    from scipy.ndimage import gaussian_filter

    faces, inner, reach = cell
    bins = int(min(_BINS_PER_PX * lattice.pitch, _MOST_BINS))
    sums = np.zeros((_CHUNKS, bins, bins, 3))
    inverse = np.linalg.inv(lattice.basis)
    _fold(picture, centres, faces, inner, reach, inverse, stride, bins, _CHUNKS, sums)
    width = _SMOOTH * bins / lattice.pitch
    total, square, count = (_turned(gaussian_filter(v, width, mode="wrap")) for v in np.moveaxis(sums.sum(0), -1, 0))
    count = np.maximum(count, 1e-9)
    level = total / count
    variance = np.maximum(square / count - level**2, 1e-4 * float(np.var(level)) + 1e-12)
    along = [(np.roll(level, -1, axis) - np.roll(level, 1, axis)) * (bins / 2) for axis in (1, 0)]
    slope = np.stack(along, axis=-1) @ inverse.T
    return Template(np.ascontiguousarray(np.dstack([level, 1 / variance, slope])))


def _turned(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of a periodic picture and the same turned by half a turn about `[0, 0]`."""
    return values + np.roll(values[::-1, ::-1], (1, 1), axis=(0, 1))


def lens_steps(
    picture: NDArray[np.float32],
    lattice: Lattice,
    centres: NDArray[np.float64],
    cell: tuple[NDArray[np.float64], float, float],
    stride: int = 1,
) -> LensSteps:
    """Gauss-Newton steps of the lenses at `centres` (n, 2) [px] of a straight `lattice`, every pixel of their cells.

    Each lens has a contrast of its own, so blank or dark ones say nothing, and an offset. Of large microimages every
    `stride`-th pixel each way is enough, as what the scene shows is alike in neighbouring pixels.
    """
    faces, inner, reach = cell
    few = np.ascontiguousarray(centres[:: max(1, len(centres) // _TEMPLATE_LENSES)])
    template = average_cell(picture, lattice, few, cell, stride)
    normal, right = np.zeros((len(centres), 2, 2)), np.zeros((len(centres), 2))
    inverse = np.linalg.inv(lattice.basis)
    _accumulate(
        picture, centres, faces, inner, reach, inverse, stride, template.maps, _OUTLIER, _MOST_CONTRAST, normal, right
    )
    return LensSteps(normal, right)
