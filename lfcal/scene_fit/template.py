"""Steps of single microimages in scenes: each is compared with the average microimage of the whole flat.

The average microimage is a picture of one cell of the lattice, not a radial profile: rims and gaps follow the outline
of the cell. It is made the same under a half turn about its centre, so what a wrong centre would add to it cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..detection.folding import VECTOR_LENGTH, compute_cell_bins
from ..lattice.cell import cell_circumradius, cell_row_bounds, row_interval
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..runtime.fastmath import FAST

__all__ = ["LensEquations", "Template", "build_lens_equations", "build_template"]

# Bins of the average cell per pixel, and the most that are worth their memory.
_BINS_PER_PX = 3.0
_MOST_BINS = 210
_CHUNKS = 16
# Lenses that make an average hardly noisier than all of them would.
_TEMPLATE_LENSES = 1500
# Bins are smoothed over so many pixels, about the width of an edge.
_SMOOTH = 0.5
# A lens with this many times the usual contrast says no more than one with less.
_MOST_CONTRAST = 2.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _places(picture, cx, cy, lens, sides, inverse, stride, bins, place, values):
    """Bins and values of the pixels of a cell, and their number; up to `VECTOR_LENGTH` more may be overwritten."""
    height, width = picture.shape
    number = np.uint64(0)
    for y in range(int(np.ceil(cy + sides[6, 0])) + lens % stride, int(np.floor(cy + sides[6, 1])) + 1, stride):
        dy = y - cy
        low, high = row_interval(dy, sides)
        first, last = int(np.ceil(cx + low)), int(np.floor(cx + high))
        first += (lens // stride - first) % stride
        if first > last:
            continue
        dx = first - cx
        count = (last - first) // stride + 1
        u = dx * inverse[0, 0] + dy * inverse[1, 0] + 0.5 / bins
        v = dx * inverse[0, 1] + dy * inverse[1, 1] + 0.5 / bins
        compute_cell_bins(u, v, inverse[0, 0] * stride, inverse[0, 1] * stride, bins, number, count, place)
        pixels = picture[y]
        # What lies beyond the last row is not to be read.
        if stride == 1 and (y + 1 < height or first + count + VECTOR_LENGTH <= width):
            for start in range(0, count, VECTOR_LENGTH):
                for lane in range(VECTOR_LENGTH):
                    at = np.uint64(start) + np.uint64(lane)
                    values[number + at] = pixels[np.uint64(first) + at]
        else:
            for k in range(np.uint64(count)):
                values[number + k] = pixels[np.uint64(first) + k * np.uint64(stride)]
        number += np.uint64(count)
    return number


@njit(cache=True, nogil=True, parallel=True)
def _fold(picture, centres, sides, room, inverse, stride, bins, chunks, sums):
    """Add up pixels, their squares and their number in the bins of the cell, for each of the chunks of lenses."""
    lenses = centres.shape[0]
    one = np.float32(1)
    for chunk in prange(chunks):
        cells = sums[chunk]
        place, values = np.empty(room, np.uint32), np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            number = _places(picture, cx, cy, lens, sides, inverse, stride, bins, place, values)
            for k in range(number):
                value, n = values[k], np.uint64(place[k])
                # Four that are read and written together are one step for the processor.
                a, b, c, d = cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3]
                a, b, c, d = a + value, b + value * value, c + one, d + one
                cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3] = a, b, c, d


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _match(values, level, weight, number):
    """Sums from which the contrast and the offset of a lens follow."""
    zero = np.float32(0)
    one = sum_level = square = value = product = zero
    for k in range(number):
        w = weight[k]
        wl = w * level[k]
        one += w
        sum_level += wl
        square += wl * level[k]
        value += w * values[k]
        product += wl * values[k]
    return one, sum_level, square, value, product


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _pull(values, level, weight, slope_x, slope_y, number, contrast, offset, cutoff):
    """Sums that the step of a lens follows from."""
    one, zero = np.float32(1), np.float32(0)
    xx = xy = yy = bx = by = far = told = zero
    for k in range(number):
        w = weight[k]
        residual = values[k] - offset - contrast * level[k]
        near = max(one - residual * residual * w * cutoff, zero)
        near *= near
        told += near
        w *= near
        far += w * residual * residual
        wx, wy = w * slope_x[k], w * slope_y[k]
        xx += wx * slope_x[k]
        xy += wx * slope_y[k]
        yy += wy * slope_y[k]
        bx -= wx * residual
        by -= wy * residual
    return xx, xy, yy, bx, by, far, told


@njit(cache=True, nogil=True, parallel=True)
def _accumulate(
    picture, centres, sides, room, inverse, stride, bins, chunks, maps, cutoff, most, normal, right, noise,
):  # fmt: skip
    lenses = centres.shape[0]
    for chunk in prange(chunks):
        place, values = np.empty(room, np.uint32), np.empty(room, np.float32)
        level, weight = np.empty(room, np.float32), np.empty(room, np.float32)
        slope_x, slope_y = np.empty(room, np.float32), np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            number = _places(picture, cx, cy, lens, sides, inverse, stride, bins, place, values)
            for k in range(number):
                at = np.uint64(place[k])
                level[k], weight[k] = maps[at, 0], maps[at, 1]
                slope_x[k], slope_y[k] = maps[at, 2], maps[at, 3]
            one, mean, square, value, product = _match(values, level, weight, number)
            contrast, offset = np.float32(1), np.float32(0)
            determinant = one * square - mean * mean
            if determinant > 1e-9 * one * square:
                contrast = np.float32(min(max((one * product - mean * value) / determinant, 0.0), most))
                offset = np.float32((value - contrast * mean) / one)
            xx, xy, yy, bx, by, far, told = _pull(
                values, level, weight, slope_x, slope_y, number, contrast, offset, cutoff
            )
            normal[lens, 0, 0] = contrast * contrast * xx
            normal[lens, 0, 1] = contrast * contrast * xy
            normal[lens, 1, 0] = contrast * contrast * xy
            normal[lens, 1, 1] = contrast * contrast * yy
            right[lens, 0] = contrast * bx
            right[lens, 1] = contrast * by
            noise[lens] = far / max(told, 1e-9)


@dataclass(frozen=True)
class Template:
    """Average microimage over one cell, the centre of the lens at `[0, 0]`, periodic.

    Parameters
    ----------
    maps : (bins, bins, 4) float32
        Level, inverse variance of a pixel, and slopes of the level in x and y [1/px]; column along `a1`, row along
        `a2`, `[j, i]` at `i / bins, j / bins` of the cell.
    """

    maps: NDArray[np.float32]


@dataclass(frozen=True)
class LensEquations:
    """Least squares of each lens by itself: `normal @ step = right`.

    Parameters
    ----------
    normal, right : (n, 2, 2), (n, 2) float64
    noise : (n,) float64
        Variance of a pixel of the lens about the average microimage, over that of all lenses.
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    noise: NDArray[np.float64]


def build_template(
    picture: NDArray[np.float32],
    lattice: Lattice,
    centres: NDArray[np.float64],
    faces: NDArray[np.float64],
    stride: int = 1,
) -> Template:
    """Average of `picture` (h, w) over whole cells at `centres` (n, 2) [px] with these `faces` (`cell_faces`)."""
    bins = _bins(lattice)
    sums = np.zeros((_CHUNKS, bins * bins, 4), np.float32)
    inverse = np.linalg.inv(lattice.basis)
    _fold(picture, centres, cell_row_bounds(faces), _room(faces, stride), inverse, stride, bins, _CHUNKS, sums)
    width = _SMOOTH * bins / lattice.pitch
    planes = sums.sum(0, dtype=np.float64).T[:3].reshape(3, bins, bins)
    total, square, count = (_turned(_smoothed(plane, width)) for plane in planes)
    count = np.maximum(count, 1e-9)
    level = total / count
    variance = np.maximum(square / count - level**2, 1e-4 * float(np.var(level)) + 1e-12)
    along = [(np.roll(level, -1, axis) - np.roll(level, 1, axis)) * (bins / 2) for axis in (1, 0)]
    slope = np.stack(along, axis=-1) @ inverse.T
    return Template(np.dstack([level, 1 / variance, slope]).astype(np.float32))


def _room(faces: NDArray[np.float64], stride: int) -> int:
    """Room for the pixels of a cell, and for what is worked on beyond them."""
    return (int(2 * cell_circumradius(faces)) // stride + 3) ** 2 + 2 * VECTOR_LENGTH


def _bins(lattice: Lattice) -> int:
    """Bins of the average cell along each lattice vector."""
    return int(min(_BINS_PER_PX * lattice.pitch, _MOST_BINS))


def _smoothed(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """A periodic square picture blurred by a Gaussian of standard deviation `width` [samples]."""
    count = len(values)
    passed = np.exp(-2 * (np.pi * width * np.fft.fftfreq(count)) ** 2)
    place = np.arange(count)
    # A product with so small a matrix takes a tenth of the time of Fourier transforms.
    blur = np.fft.ifft(passed).real[place[:, None] - place]
    return np.asarray(blur @ values @ blur.T)


def _turned(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of a periodic picture and the same turned by half a turn about `[0, 0]`."""
    return values + np.roll(values[::-1, ::-1], (1, 1), axis=(0, 1))


def build_lens_equations(
    picture: NDArray[np.float32],
    lattice: Lattice,
    centres: NDArray[np.float64],
    faces: NDArray[np.float64],
    stride: int = 1,
) -> LensEquations:
    """Gauss-Newton steps of the lenses at `centres` (n, 2) [px] of a straight `lattice`, every pixel of their cells.

    Each lens has a contrast of its own, so blank or dark ones say nothing, and an offset. Of large microimages every
    `stride`-th pixel each way is enough, as what the scene shows is alike in neighbouring pixels.
    """
    few = np.ascontiguousarray(centres[:: max(1, len(centres) // _TEMPLATE_LENSES)])
    template = build_template(picture, lattice, few, faces, stride)
    normal, right = np.zeros((len(centres), 2, 2)), np.zeros((len(centres), 2))
    noise = np.zeros(len(centres))
    inverse, bins = np.linalg.inv(lattice.basis), _bins(lattice)
    maps, cutoff = template.maps.reshape(bins * bins, -1), np.float32(1 / TUKEY_CUTOFF**2)
    _accumulate(
        picture,
        centres,
        cell_row_bounds(faces),
        _room(faces, stride),
        inverse,
        stride,
        bins,
        _CHUNKS,
        maps,
        cutoff,
        _MOST_CONTRAST,
        normal,
        right,
        noise,
    )
    return LensEquations(normal, right, noise)
