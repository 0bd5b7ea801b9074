"""Which lenses carry texture: their contrast against the noise and the shading that could fake it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST

from ..runtime.cache import cached
from .gray_flat import GrayFlat
from .lens_graph import dilate_mask, neighbour_rows
from .microimages import copy_box
from .shading import remove_shading

__all__ = [
    "FIXED_PATTERN_CONTRAST",
    "LensStatistics",
    "Texture",
    "classify_borderline_texture",
    "classify_texture",
    "estimate_noise",
    "find_noise_only",
    "find_texture",
    "measure_statistics",
    "sample_statistics",
]

# Contrast that fixed-pattern shading inside microimages may fake, in shares of their brightness.
FIXED_PATTERN_CONTRAST = 0.02
# A lens clearly carries texture when its contrast exceeds the noise this many times, faintly at the second number.
_CLEAR, _FAINT = 2.5, 0.5
# The depth at the centre of a lens is not told by texture at its rim: within this share of the pitch there must
# be some, at least this much of the brightness: less is lost in the rounding of 8 bits.
_MIDDLE, _LEAST_CONTRAST = 0.36, 0.01

# Shading hardly adds as much contrast as this factor, or takes it away.
_BESIDE = 1.5
# So many microimages are no rougher than the noise makes them.
_LEAST_ROUGH = 0.02
# Vector loops take so many values at a time, and so many lenses share the memory that they are cut out to.
_BUNCH, _TOGETHER = 32, 32
# Microimages of this radius [px] have rows to spare; so many pixels tell whether there is texture, in rows that lie no
# farther apart than the last number.
_LEAST_ROWS, _TELLING, _FARTHEST_ROWS = 6.0, 260, 4


@dataclass(frozen=True)
class LensStatistics:
    """Brightness inside each microimage, white = 1.

    Parameters
    ----------
    mean, contrast : (n,) float32
        Mean and standard deviation.
    middle : (n,) float32
        Standard deviation within 0.36 pitches of the centre.
    roughness : (n,) float32
        RMS of what neither a plane nor a straight edge explains: noise, and the finest detail.
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
    """What there is to match.

    Parameters
    ----------
    flat : GrayFlat
        Without the shading that microimages have in common.
    statistics : LensStatistics
        Of that.
    noise : float
        Standard deviation of a pixel, white = 1.
    clear, faint : (n,) bool
        Lenses with texture, and lenses where only a match can tell it from noise.
    """

    flat: GrayFlat
    statistics: LensStatistics
    noise: float
    clear: NDArray[np.bool_]
    faint: NDArray[np.bool_]

    def select(self, rows: NDArray[np.int64]) -> Texture:
        """That of some lenses."""
        kinds = None if self.flat.lens_type is None else self.flat.lens_type[rows]
        flat = replace(self.flat, centres=self.flat.centres[rows], lens_type=kinds)
        return Texture(flat, self.statistics.select(rows), self.noise, self.clear[rows], self.faint[rows])


# Drawn into its caller before anything is optimised: later, that is done once where Numba compiles and twice where it
# loads, and sums would be ordered differently. Places are unsigned: signed ones are looked at for being counted from
# the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(box, columns, lines, start, above, below, count, ex, ey, low, high, last, r2, middle2, near):
    """Number, sum and sum of squares of the pixels in a circle, less `near`, the same in a smaller one, and the sum of
    squares of their answers to a checkerboard mask.

    The mask is blind to planes and straight slopes (Immerkaer 1996). `box` holds the row above and that below each row
    of pixels `above` and `below` values farther; circles are about (ex, ey) in `columns` and `lines`.
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


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(number, total, squares):
    """Mean and standard deviation from sums."""
    inverse = np.float32(1.0) / max(number, np.float32(1.0))
    mean = total * inverse
    return mean, np.sqrt(max(squares * inverse - mean * mean, np.float32(0.0)))


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _lens_statistics(image, centres, wanted, radius, middle, row_step, out):
    height, width = image.shape
    pixels = image.reshape(-1)
    # Rows that are read follow each other, and then those above, and below, if they are others: so one long loop takes
    # them all.
    wide, tall = 2 * int(np.ceil(radius)) + 3, (2 * int(np.ceil(radius)) + 1 + row_step) // row_step
    size = (tall * wide + _BUNCH - 1) // _BUNCH * _BUNCH
    start = wide + 1 if row_step == 1 else 1
    above, below = (-wide, wide) if row_step == 1 else (tall * wide, (tall + 1) * wide)
    if row_step > 2:
        below = 2 * tall * wide
    columns, lines = np.full(size, np.inf, np.float32), np.full(size, np.inf, np.float32)
    for k in range(tall * wide):
        columns[k], lines[k] = k % wide, k // wide * row_step
    for part in prange((len(centres) + _TOGETHER - 1) // _TOGETHER):
        box = np.zeros(min(row_step, 3) * (tall + 1) * wide + 3 * wide + 2 * _BUNCH, np.float32)
        for lens in range(part * _TOGETHER, min((part + 1) * _TOGETHER, len(centres))):
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
            count = max((count * wide + _BUNCH - 1) // _BUNCH * _BUNCH, 0)
            near = pixels[min(max(int(cy), 0), height - 1) * width + min(max(int(cx), 0), width - 1)]
            number, total, squares, rough, inner, inner_total, inner_squares = _sums(
                box, columns, lines, start, above, below, count, cx - np.float32(left), cy - np.float32(top),
                np.float32(1 - left), np.float32(width - 2 - left), np.float32(bottom - top), radius * radius,
                middle * middle, near,
            )  # fmt: skip
            mean, out[1, lens] = _spread(number, total, squares)
            out[0, lens] = near + mean
            out[2, lens] = _spread(inner, inner_total, inner_squares)[1]
            out[3, lens] = np.sqrt(rough / (np.float32(36) * max(number, np.float32(1.0))))


def measure_statistics(
    gray: GrayFlat,
    known: LensStatistics | None = None,
    wanted: NDArray[np.bool_] | None = None,
    row_step: int = 1,
) -> LensStatistics:
    """Brightness inside each microimage.

    Lenses that are not `wanted` (n,) keep what is `known` of them. Only every `row_step`-th row of pixels is read.
    """
    out = np.zeros((4, len(gray.centres)), np.float32)
    if known is not None:
        out[:] = known.mean, known.contrast, known.central_contrast, known.roughness
    wanted = np.ones(len(gray.centres), bool) if wanted is None else wanted
    _lens_statistics(
        gray.image, gray.centres, wanted, np.float32(gray.radius), np.float32(min(gray.radius, _MIDDLE * gray.pitch)),
        row_step, out,
    )  # fmt: skip
    return LensStatistics(*out)


def sample_statistics(gray: GrayFlat) -> LensStatistics:
    """`measure_statistics` from every other row of large enough microimages, or fewer: who carries texture at all."""
    step = int(np.clip(np.pi * gray.radius**2 / _TELLING, 2, _FARTHEST_ROWS))
    return measure_statistics(gray, row_step=step if gray.radius >= _LEAST_ROWS else 1)


def find_noise_only(plain: LensStatistics, noise: float) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels are explained by their own noise."""
    return ~(_some(plain, noise) & _beyond_noise(plain)) & ~_clear(plain, noise)


def find_texture(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None = None,
    wanted: NDArray[np.bool_] | None = None,
    known_noise: float | None = None,
) -> Texture:
    """Remove the shading that microimages have in common and tell which lenses are left with texture.

    `plain` are the statistics of `gray`. Lenses that are `blank` are so without further ado. Lenses that are not
    `wanted` keep their shading. The noise may be known already.
    """
    wanted = np.ones(len(plain.mean), bool) if wanted is None else wanted
    first = wanted if blank is None else wanted & ~blank
    flattened = remove_shading(gray, lattice, plain.mean, plain.contrast, first)
    found = measure_statistics(flattened, known=plain, wanted=first)
    if blank is not None:
        # Lenses with texture are compared with those beside them.
        some = _some(found, estimate_noise(found.roughness) if known_noise is None else known_noise)
        beside = wanted & ~first & dilate_mask(some & first, neighbour_rows(lattice, lattice.steps))
        flattened = remove_shading(gray, lattice, plain.mean, plain.contrast, beside, flattened)
        found = measure_statistics(flattened, found, beside)
    noise = estimate_noise(found.roughness) if known_noise is None else known_noise
    clear = _clear(found, noise)
    faint = _some(found, noise) & ~clear
    return Texture(flattened, found, noise, clear, faint if blank is None else faint & ~blank)


def classify_texture(gray: GrayFlat, plain: LensStatistics, noise: float | None = None) -> Texture:
    """Which lenses carry texture if the shading is left in: quicker, and right where there is much texture."""
    noise = estimate_noise(plain.roughness) if noise is None else noise
    clear = _clear(plain, noise)
    return Texture(gray, plain, noise, clear, _some(plain, noise) & ~clear)


def classify_borderline_texture(
    gray: GrayFlat, lattice: Lattice, plain: LensStatistics, blank: NDArray[np.bool_], noise: float
) -> Texture:
    """As `find_texture`, but of shading is told only what lenses of which it may decide show without it."""
    unsure = _unsure(plain, noise) | (_some(plain, noise) & ~_clear(plain, noise) & ~blank)
    found = plain
    if unsure.any():
        flattened = remove_shading(gray, lattice, plain.mean, plain.contrast, unsure, everywhere=False)
        found = measure_statistics(flattened, plain, unsure)
    clear = _clear(found, noise)
    return Texture(gray, found, noise, clear, _some(found, noise) & ~clear & ~blank)


def estimate_noise(roughness: NDArray[np.float32]) -> float:
    """The least rough microimages show the noise alone; rounding and coding leave a grey level in any case."""
    return cached(roughness, "noise", lambda: _noise_of(roughness))


def _noise_of(roughness: NDArray[np.float32]) -> float:
    at = _LEAST_ROUGH * (len(roughness) - 1)
    # As numpy's quantile, which takes six times as long.
    low, high = np.partition(roughness, [int(at), int(np.ceil(at))])[[int(at), int(np.ceil(at))]].astype(float)
    return max(low + (at - int(at)) * (high - low), 1 / 255)


def _least_middle(found: LensStatistics, noise: float) -> NDArray[np.float32]:
    """(n,) contrast in the middle from which on a lens carries texture."""
    return np.maximum(_LEAST_CONTRAST * found.mean, np.float32(_FAINT * noise))


def _least_clear(found: LensStatistics, noise: float) -> NDArray:
    """(n,) contrast from which on that is clear."""
    return np.hypot(_CLEAR * noise, FIXED_PATTERN_CONTRAST * found.mean)


def _some(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    return found.central_contrast > _least_middle(found, noise)


def _clear(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    return _some(found, noise) & (found.contrast > _least_clear(found, noise))


def _unsure(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    """Lenses with about as much contrast as tells texture, or with about as much in the middle, and no less of the
    other."""
    limit, least = _least_clear(found, noise), _least_middle(found, noise)
    little = (found.contrast < _BESIDE * limit) | (found.central_contrast < _BESIDE * least)
    return np.asarray(little & (found.contrast * _BESIDE > limit) & (found.central_contrast * _BESIDE > least))


def _beyond_noise(found: LensStatistics) -> NDArray[np.bool_]:
    """Lenses with more contrast than their finest detail has, by the least that counts as faint texture."""
    return found.contrast**2 > (1 + _FAINT**2) * found.roughness**2
