"""Which lenses carry texture: their contrast against the noise and the shading that could fake it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from .fastmath import FAST
from .neighbours import neighbour_rows
from .radiance import GrayFlat
from .shading import flatten_shading

__all__ = [
    "FIXED_SHADING",
    "LensStatistics",
    "Texture",
    "blank_lenses",
    "find_texture",
    "lens_statistics",
    "noise_of",
    "quick_statistics",
    "untouched_texture",
]

# Contrast that fixed-pattern shading inside microimages may fake, in shares of their brightness.
FIXED_SHADING = 0.02
# A lens clearly carries texture when its contrast exceeds the noise this many times, faintly at the second number.
_CLEAR, _FAINT = 2.5, 0.5
# The depth at the centre of a lens is not told by texture at its rim: within this share of the pitch there must
# be some, at least this much of the brightness: less is lost in the rounding of 8 bits.
_MIDDLE, _LEAST_CONTRAST = 0.36, 0.01

# So many microimages are no rougher than the noise makes them.
_LEAST_ROUGH = 0.02
# Microimages of this radius [px] have rows to spare.
_LEAST_ROWS = 6.0


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
    middle: NDArray[np.float32]
    roughness: NDArray[np.float32]

    def of(self, rows: NDArray[np.int32]) -> LensStatistics:
        """Those of some lenses."""
        return LensStatistics(self.mean[rows], self.contrast[rows], self.middle[rows], self.roughness[rows])


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


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _chord(centre_x, centre_y, y, radius, width):
    """First and last pixel of row `y` inside a circle."""
    half = np.sqrt(max(np.float32(0.0), radius * radius - (y - centre_y) * (y - centre_y)))
    return max(1, int(np.ceil(centre_x - half))), min(width - 2, int(np.floor(centre_x + half)))


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _moments(image, cx, cy, radius, middle, row_step):
    """Count, mean and standard deviation of the pixels in a circle, taken from a value near their mean."""
    height, width = image.shape
    total = squares = np.float32(0.0)
    count = 0
    for y in range(max(1, int(np.ceil(cy - radius))), min(height - 2, int(np.floor(cy + radius))) + 1, row_step):
        left, right = _chord(cx, cy, y, radius, width)
        row = image[y, left : right + 1]
        for k in range(right - left + 1):
            value = row[k] - middle
            total += value
            squares += value * value
        count += max(right - left + 1, 0)
    mean = total / max(count, 1)
    return count, middle + mean, np.sqrt(max(np.float32(0.0), squares / max(count, 1) - mean * mean))


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _moments_and_roughness(image, cx, cy, radius, middle, row_step):
    """Mean and standard deviation of the pixels in a circle, and their RMS answer to a checkerboard mask.

    The mask is blind to planes and straight slopes (Immerkaer 1996).
    """
    height, width = image.shape
    two, four = np.float32(2.0), np.float32(4.0)
    total = squares = rough = np.float32(0.0)
    count = 0
    for y in range(max(1, int(np.ceil(cy - radius))), min(height - 2, int(np.floor(cy + radius))) + 1, row_step):
        left, right = _chord(cx, cy, y, radius, width)
        n = right - left + 1
        if n <= 0:
            continue
        # One view for each offset: an index like k + 1 may wrap round, which no vector loop can.
        above, row, below = image[y - 1, left - 1 :], image[y, left - 1 :], image[y + 1, left - 1 :]
        above0, above1, above2 = above[:n], above[1 : n + 1], above[2 : n + 2]
        row0, row1, row2 = row[:n], row[1 : n + 1], row[2 : n + 2]
        below0, below1, below2 = below[:n], below[1 : n + 1], below[2 : n + 2]
        for k in range(n):
            value = row1[k] - middle
            total += value
            squares += value * value
            bend = (
                above0[k] + above2[k] + below0[k] + below2[k]
                - two * (above1[k] + below1[k] + row0[k] + row2[k]) + four * row1[k]
            )  # fmt: skip
            rough += bend * bend
        count += n
    inverse = np.float32(1.0) / np.float32(max(count, 1))
    mean = total * inverse
    deviation = np.sqrt(max(np.float32(0.0), squares * inverse - mean * mean))
    return middle + mean, deviation, np.sqrt(rough * inverse * np.float32(1 / 36))


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _lens_statistics(image, centres, wanted, radius, middle, noise_too, row_step, out):
    height, width = image.shape
    for lens in prange(len(centres)):
        if not wanted[lens]:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        near = image[min(max(int(cy), 0), height - 1), min(max(int(cx), 0), width - 1)]
        if not noise_too:
            _, out[0, lens], out[1, lens] = _moments(image, cx, cy, radius, near, row_step)
            continue
        out[0, lens], out[1, lens], out[3, lens] = _moments_and_roughness(image, cx, cy, radius, near, row_step)
        _, _, out[2, lens] = _moments(image, cx, cy, middle, near, row_step)


def lens_statistics(
    gray: GrayFlat,
    noise_too: bool = True,
    known: LensStatistics | None = None,
    wanted: NDArray[np.bool_] | None = None,
    row_step: int = 1,
) -> LensStatistics:
    """Brightness inside each microimage; without `noise_too`, `middle` and `roughness` are left 0.

    Lenses that are not `wanted` (n,) keep what is `known` of them. Only every `row_step`-th row of pixels is read.
    """
    out = np.zeros((4, len(gray.centres)), np.float32)
    if known is not None:
        out[:] = known.mean, known.contrast, known.middle, known.roughness
    wanted = np.ones(len(gray.centres), bool) if wanted is None else wanted
    _lens_statistics(
        gray.image, gray.centres, wanted, np.float32(gray.radius), np.float32(min(gray.radius, _MIDDLE * gray.pitch)),
        noise_too, row_step, out,
    )  # fmt: skip
    return LensStatistics(*out)


def quick_statistics(gray: GrayFlat) -> LensStatistics:
    """`lens_statistics` from every other row of large enough microimages: who carries texture at all."""
    return lens_statistics(gray, row_step=2 if gray.radius >= _LEAST_ROWS else 1)


def blank_lenses(plain: LensStatistics, noise: float) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels are explained by their own noise."""
    return ~(_some(plain, noise) & _beyond_noise(plain)) & ~_clear(plain, noise)


def find_texture(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    blank: tuple[NDArray[np.bool_], float] | None = None,
    wanted: NDArray[np.bool_] | None = None,
    known_noise: float | None = None,
) -> Texture:
    """Remove the shading that microimages have in common and tell which lenses are left with texture.

    `plain` are the statistics of `gray`. Lenses that are `blank` are so without further ado; the number beside them is
    the noise of a larger flat of which this is a part, else inf. Lenses that are not `wanted` keep their shading.
    The noise may be known already.
    """
    white = np.zeros(len(plain.mean), bool)
    if blank is not None:
        # Lenses with texture are compared with those beside them.
        rows = neighbour_rows(lattice, lattice.steps)
        white = blank[0] & ((rows < 0) | blank[0][rows]).all(1)
    if wanted is not None:
        white = white | ~wanted
    flattened = flatten_shading(gray, lattice, plain.mean, plain.contrast, ~white)
    found = lens_statistics(flattened, known=plain, wanted=~white)
    if known_noise is None:
        noise = noise_of(found.roughness) if blank is None else min(noise_of(found.roughness), blank[1])
    else:
        noise = known_noise
    clear = _clear(found, noise)
    faint = _some(found, noise) & ~clear
    return Texture(flattened, found, noise, clear, faint if blank is None else faint & ~blank[0])


def untouched_texture(gray: GrayFlat, plain: LensStatistics, noise: float | None = None) -> Texture:
    """Which lenses carry texture if the shading is left in: quicker, and right where there is much texture."""
    noise = noise_of(plain.roughness) if noise is None else noise
    clear = _clear(plain, noise)
    return Texture(gray, plain, noise, clear, _some(plain, noise) & ~clear)


def noise_of(roughness: NDArray[np.float32]) -> float:
    """The least rough microimages show the noise alone; rounding and coding leave a grey level in any case."""
    at = _LEAST_ROUGH * (len(roughness) - 1)
    # As numpy's quantile, which takes six times as long.
    low, high = np.partition(roughness, [int(at), int(np.ceil(at))])[[int(at), int(np.ceil(at))]].astype(float)
    return max(low + (at - int(at)) * (high - low), 1 / 255)


def _some(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    return found.middle > np.maximum(_LEAST_CONTRAST * found.mean, np.float32(_FAINT * noise))


def _clear(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    return _some(found, noise) & (found.contrast > np.hypot(_CLEAR * noise, FIXED_SHADING * found.mean))


def _beyond_noise(found: LensStatistics) -> NDArray[np.bool_]:
    """Lenses with more contrast than their finest detail has, by the least that counts as faint texture."""
    return found.contrast**2 > (1 + _FAINT**2) * found.roughness**2
