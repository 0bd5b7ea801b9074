"""Texture of every microimage: statistics of its brightness, the noise of the flat, and which lenses can be matched.

A lens has texture if the contrast of its middle exceeds noise and rounding. Clear texture also exceeds the contrast
that the fixed-pattern shading of microimages can have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import kernel

from ..runtime.cache import cached
from ..runtime.quantiles import quantile
from .gray_flat import GrayFlat
from .lens_graph import dilate_mask, neighbour_rows
from .microimages import copy_box
from .settings import BUNCH, TEXTURE, TextureSettings
from .shading import remove_shading

__all__ = [
    "LensStatistics", "Texture", "classify_texture", "estimate_noise",
    "find_noise_only", "find_texture", "measure_statistics", "sample_statistics",
]  # fmt: skip


@dataclass(frozen=True)
class LensStatistics:
    """Brightness inside each microimage, white = 1.

    Parameters
    ----------
    mean, contrast : (n,) float32
        Mean and standard deviation.
    central_contrast : (n,) float32
        Standard deviation in the middle, within 0.36 pitches of the centre.
    roughness : (n,) float32
        RMS of what neither a plane nor a straight edge explains: noise, rounding, and the finest detail.
    """

    mean: NDArray[np.float32]
    contrast: NDArray[np.float32]
    central_contrast: NDArray[np.float32]
    roughness: NDArray[np.float32]

    def select(self, rows: NDArray[np.int64]) -> LensStatistics:
        """Those of some lenses."""
        return LensStatistics(self.mean[rows], self.contrast[rows], self.central_contrast[rows], self.roughness[rows])


@dataclass(frozen=True)
class Texture:
    """Texture of all lenses.

    Parameters
    ----------
    flat : GrayFlat
        The flat that is matched, without common shading if that was removed.
    statistics : LensStatistics
        Of that flat.
    noise : float
        Standard deviation of a pixel, white = 1.
    clear, faint : (n,) bool
        Lenses with texture, and lenses whose contrast may be noise or shading: only a match can confirm it.
    """

    flat: GrayFlat
    statistics: LensStatistics
    noise: float
    clear: NDArray[np.bool_]
    faint: NDArray[np.bool_]

    def select(self, rows: NDArray[np.int64]) -> Texture:
        """That of some lenses."""
        lens_type = None if self.flat.lens_type is None else self.flat.lens_type[rows]
        flat = replace(self.flat, centres=self.flat.centres[rows], lens_type=lens_type)
        return Texture(flat, self.statistics.select(rows), self.noise, self.clear[rows], self.faint[rows])


# Inlined before any optimisation: else sums would be in another order when compiled than when loaded from the cache.
# Positions are unsigned: signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_pixels(box, columns, lines, start, above, below, count, ex, ey, low, high, last, r2, middle2, near):
    """Number, sum and sum of squares of the pixels in a circle, minus `near`; sum of squares of a checkerboard filter;
    number, sum and sum of squares in the smaller circle.

    The filter does not respond to planes and straight edges (Immerkaer 1996). `box` holds the row above and that below
    each row of pixels `above` and `below` values farther; circles are about (ex, ey) in `columns` and `lines`.
    """
    zero, unit, two, four = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(4.0)
    a, b, c, one = np.uint64(start), np.uint64(start + above), np.uint64(start + below), np.uint64(1)
    number = total = squares = rough = inner_number = inner_total = inner_squares = zero
    for k in range(np.uint64(count)):
        x, y = columns[k] - ex, lines[k] - ey
        away = x * x + y * y
        inside = (away <= r2) & (columns[k] >= low) & (columns[k] <= high) & (lines[k] <= last)
        value = box[a + k] - near if inside else zero
        bend = (
            box[b + k - one] + box[b + k + one] + box[c + k - one] + box[c + k + one]
            - two * (box[b + k] + box[c + k] + box[a + k - one] + box[a + k + one]) + four * box[a + k]
        )  # fmt: skip
        bend = bend if inside else zero
        counts = unit if inside else zero
        number += counts
        total += value
        squares += value * value
        rough += bend * bend
        within = away <= middle2
        value, counts = value if within else zero, counts if within else zero
        inner_number += counts
        inner_total += value
        inner_squares += value * value
    return number, total, squares, rough, inner_number, inner_total, inner_squares


@njit(error_model="numpy")
def _mean_and_deviation(number, total, squares):
    inverse = np.float32(1.0) / max(number, np.float32(1.0))
    mean = total * inverse
    return mean, np.sqrt(max(squares * inverse - mean * mean, np.float32(0.0)))


@kernel(error_model="numpy", share=lambda _, centres, *__: len(centres))
def _measure(begin, end, image, centres, wanted, radius, middle, row_step, out):
    """Mean, contrast, contrast of the middle and roughness of the `wanted` lenses, into `out` (4, n)."""
    height, width = image.shape
    pixels = image.reshape(-1)
    # A copy holds the rows that are read one after the other, and then those above, and below, if they are others: so
    # one long loop handles them all.
    wide, tall = 2 * int(np.ceil(radius)) + 3, (2 * int(np.ceil(radius)) + 1 + row_step) // row_step
    size = (tall * wide + BUNCH - 1) // BUNCH * BUNCH
    start = wide + 1 if row_step == 1 else 1
    above, below = (-wide, wide) if row_step == 1 else (tall * wide, (tall + 1) * wide)
    if row_step > 2:
        below = 2 * tall * wide
    columns, lines = np.full(size, np.inf, np.float32), np.full(size, np.inf, np.float32)
    for k in range(tall * wide):
        columns[k], lines[k] = k % wide, k // wide * row_step
    box = np.zeros(min(row_step, 3) * (tall + 1) * wide + 3 * wide + 2 * BUNCH, np.float32)
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        top, bottom = max(1, int(np.ceil(cy - radius))), min(height - 2, int(np.floor(cy + radius)))
        left = int(np.ceil(cx - radius))
        count = (bottom - top) // row_step + 1
        if row_step == 1:
            copy_box(pixels, width, left - 1, top - 1, count + 2, wide, box, 0, 1)
        else:
            copy_box(pixels, width, left - 1, top, count, wide, box, 0, row_step)
            copy_box(pixels, width, left - 1, top - 1, count + 1, wide, box, tall * wide, row_step)
            if row_step > 2:
                copy_box(pixels, width, left - 1, top + 1, count, wide, box, 2 * tall * wide, row_step)
        count = max((count * wide + BUNCH - 1) // BUNCH * BUNCH, 0)
        near = pixels[min(max(int(cy), 0), height - 1) * width + min(max(int(cx), 0), width - 1)]
        number, total, squares, rough, inner, inner_total, inner_squares = _sum_pixels(
            box, columns, lines, start, above, below, count, cx - np.float32(left), cy - np.float32(top),
            np.float32(1 - left), np.float32(width - 2 - left), np.float32(bottom - top), radius * radius,
            middle * middle, near,
        )  # fmt: skip
        mean, out[1, lens] = _mean_and_deviation(number, total, squares)
        out[0, lens] = near + mean
        out[2, lens] = _mean_and_deviation(inner, inner_total, inner_squares)[1]
        out[3, lens] = np.sqrt(rough / (np.float32(36) * max(number, np.float32(1.0))))


def measure_statistics(
    gray: GrayFlat,
    known: LensStatistics | None = None,
    wanted: NDArray[np.bool_] | None = None,
    row_step: int = 1,
    settings: TextureSettings = TEXTURE,
) -> LensStatistics:
    """Brightness inside each microimage.

    Lenses that are not `wanted` (n,) keep their `known` values. Only every `row_step`-th row of pixels is read.
    """
    out = np.zeros((4, len(gray.centres)), np.float32)
    if known is not None:
        out[:] = known.mean, known.contrast, known.central_contrast, known.roughness
    wanted = np.ones(len(gray.centres), bool) if wanted is None else wanted
    middle = np.float32(min(gray.radius, settings.middle * gray.pitch))
    _measure(gray.image, gray.centres, wanted, np.float32(gray.radius), middle, row_step, out)
    np.maximum(out[3], np.float32(gray.rounding), out=out[3])
    return LensStatistics(*out)


def sample_statistics(gray: GrayFlat) -> LensStatistics:
    """`measure_statistics` from every second row, or fewer, of large enough microimages."""
    # 260 pixels are enough to tell whether a lens has texture.
    step = int(np.clip(np.pi * gray.radius**2 / 260, 2, 4))
    return measure_statistics(gray, row_step=step if gray.radius >= 6 else 1)


def find_noise_only(plain: LensStatistics, noise: float, settings: TextureSettings = TEXTURE) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose contrast their own noise explains."""
    # More contrast than the finest detail has, by the least that counts as faint texture.
    beyond = plain.contrast**2 > (1 + settings.faint**2) * plain.roughness**2
    return ~(_has_any(plain, noise, settings) & beyond) & ~_is_clear(plain, noise, settings)


def find_texture(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None = None,
    wanted: NDArray[np.bool_] | None = None,
    known_noise: float | None = None,
    settings: TextureSettings = TEXTURE,
) -> Texture:
    """Remove the common shading of microimages and classify the texture that is left.

    Parameters
    ----------
    gray : GrayFlat
    lattice : Lattice
    plain : LensStatistics
        Of `gray`.
    blank : (n,) bool, optional
        Lenses known to have no texture; only their shading beside lenses with texture is removed.
    wanted : (n,) bool, optional
        Lenses whose shading is removed; all by default.
    known_noise : float, optional
    settings : TextureSettings
    """
    wanted = np.ones(len(plain.mean), bool) if wanted is None else wanted
    first = wanted if blank is None else wanted & ~blank
    flattened = remove_shading(gray, lattice, plain.mean, plain.contrast, first)
    found = measure_statistics(flattened, known=plain, wanted=first)
    if blank is not None:
        # Lenses with texture are matched with those beside them.
        some = _has_any(found, estimate_noise(found.roughness) if known_noise is None else known_noise, settings)
        beside = wanted & ~first & dilate_mask(some & first, neighbour_rows(lattice, lattice.steps))
        flattened = remove_shading(gray, lattice, plain.mean, plain.contrast, beside, flattened)
        found = measure_statistics(flattened, found, beside)
    noise = estimate_noise(found.roughness) if known_noise is None else known_noise
    clear = _is_clear(found, noise, settings)
    faint = _has_any(found, noise, settings) & ~clear
    return Texture(flattened, found, noise, clear, faint if blank is None else faint & ~blank)


def classify_texture(
    gray: GrayFlat, plain: LensStatistics, noise: float | None = None, settings: TextureSettings = TEXTURE
) -> Texture:
    """Classify texture with the common shading left in: faster, and correct if there is much texture."""
    noise = estimate_noise(plain.roughness) if noise is None else noise
    clear = _is_clear(plain, noise, settings)
    return Texture(gray, plain, noise, clear, _has_any(plain, noise, settings) & ~clear)


def estimate_noise(roughness: NDArray[np.float32]) -> float:
    """Noise of a flat [white] from the roughness (n,) of its lenses: that of the smoothest fiftieth, a grey level of 8
    bits at least, for rounding and compression."""
    return cached(roughness, "noise", lambda: max(quantile(roughness, 0.02), 1 / 255))


def _least_central(found: LensStatistics, noise: float, settings: TextureSettings) -> NDArray[np.float32]:
    """(n,) contrast of the middle from which on a lens may have texture."""
    return np.maximum(settings.least_contrast * found.mean, np.float32(settings.faint * noise))


def _least_clear(found: LensStatistics, noise: float, settings: TextureSettings) -> NDArray:
    """(n,) contrast from which on texture is clear."""
    return np.hypot(settings.clear * noise, settings.fixed_pattern * found.mean)


def _has_any(found: LensStatistics, noise: float, settings: TextureSettings) -> NDArray[np.bool_]:
    return found.central_contrast > _least_central(found, noise, settings)


def _is_clear(found: LensStatistics, noise: float, settings: TextureSettings) -> NDArray[np.bool_]:
    return _has_any(found, noise, settings) & (found.contrast > _least_clear(found, noise, settings))
