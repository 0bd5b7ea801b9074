"""Texture of every microimage: statistics of its brightness, the noise of the flat, and which
lenses can be matched.

A lens has texture if the contrast of its middle exceeds noise and rounding. Clear texture also
exceeds the contrast that the fixed-pattern shading of microimages can have.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel

from .gray_flat import GrayFlat
from .lens_graph import dilate_mask
from .microimages import allocate_strips, row_of_disc
from .neighbours import neighbours_of
from .shading import remove_shading

__all__ = [
    "FIXED_PATTERN",
    "LensStatistics",
    "Texture",
    "classify_texture",
    "estimate_noise",
    "find_noise_only",
    "find_texture",
    "measure_statistics",
    "sample_statistics",
]

#: [brightness] contrast that fixed-pattern shading of a microimage may have.
FIXED_PATTERN = 0.02
# [noise] contrast from which on a lens may have texture; faint, until a match confirms it.
_FAINT = 0.5


@dataclass(frozen=True)
class LensStatistics:
    """Brightness inside each microimage, white = 1."""

    mean: NDArray[np.float32]  # (n,)
    contrast: NDArray[np.float32]  # (n,) standard deviation
    central_contrast: NDArray[np.float32]  # (n,) the same within 0.36 pitches of the centre
    # (n,) RMS of what neither a plane nor a straight edge explains: noise, rounding, and the finest
    # detail
    roughness: NDArray[np.float32]

    @cached_property
    def noise(self) -> float:
        """Noise of the flat [white]."""
        return estimate_noise(self.roughness)


@dataclass(frozen=True)
class Texture:
    """Texture of all lenses."""

    flat: GrayFlat  # that is matched, without common shading if that was removed
    statistics: LensStatistics  # of that flat
    noise: float  # standard deviation of a pixel, white = 1
    clear: NDArray[np.bool_]  # (n,) lenses with texture
    faint: NDArray[
        np.bool_
    ]  # (n,) lenses whose contrast may be noise or shading: only a match can confirm it


@njit(error_model="numpy")
def _mean_and_deviation(number, total, squares):
    inverse = np.float32(1.0) / max(number, np.float32(1.0))
    mean = total * inverse
    return mean, np.sqrt(max(squares * inverse - mean * mean, np.float32(0.0)))


@kernel(fastmath=FAST, error_model="numpy", share=lambda _, centres, *__: len(centres))
def _measure(begin, end, image, centres, wanted, radius, middle, row_step, out):
    """Fill `out` (4, n); roughness is the response to a checkerboard filter (Immerkaer 1996)."""
    height, width = image.shape
    line = image.reshape(-1)
    across = np.uint64(width)
    one = np.uint64(1)
    zero = np.float32(0)
    unit = np.float32(1)
    two = np.float32(2)
    four = np.float32(4)
    middle2 = middle * middle
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        # Squares of differences from a value of the lens lose no digits.
        near = image[min(max(int(cy), 0), height - 1), min(max(int(cx), 0), width - 1)]
        number = total = squares = rough = inner = inner_total = inner_squares = zero
        for y in range(
            max(1, int(np.ceil(cy - radius))),
            min(height - 2, int(np.floor(cy + radius))) + 1,
            row_step,
        ):
            dy = np.float32(y) - cy
            left, count = row_of_disc(dy, cx, radius, 1, width - 2)
            at = np.uint64(y * width + left)
            first = np.float32(left) - cx
            for k in range(np.uint64(count)):
                here = at + k
                above = here - across
                below = here + across
                value = line[here] - near
                bend = (
                    four * line[here]
                    - two * (line[here - one] + line[here + one] + line[above] + line[below])
                    + (
                        line[above - one]
                        + line[above + one]
                        + line[below - one]
                        + line[below + one]
                    )
                )
                total += value
                squares += value * value
                rough += bend * bend
                dx = first + np.float32(np.int32(k))
                within = unit if dx * dx + dy * dy <= middle2 else zero
                inner += within
                inner_total += within * value
                inner_squares += within * value * value
            number += np.float32(count)
        mean, out[1, lens] = _mean_and_deviation(number, total, squares)
        out[0, lens] = near + mean
        out[2, lens] = _mean_and_deviation(inner, inner_total, inner_squares)[1]
        out[3, lens] = np.sqrt(rough / (np.float32(36) * max(number, unit)))


def measure_statistics(
    gray: GrayFlat,
    known: LensStatistics | None = None,
    wanted: NDArray[np.bool_] | None = None,
    row_step: int = 1,
) -> LensStatistics:
    """Brightness inside each microimage, from every `row_step`-th row; lenses not `wanted` (n,)
    keep what is `known`.
    """
    out = np.zeros((4, len(gray.centres)), np.float32)
    if known is not None:
        out[:] = known.mean, known.contrast, known.central_contrast, known.roughness
    wanted = np.ones(len(gray.centres), bool) if wanted is None else wanted
    middle = np.float32(min(gray.radius, 0.36 * gray.pitch))
    _measure(gray.image, gray.centres, wanted, np.float32(gray.radius), middle, row_step, out)
    np.maximum(out[3], np.float32(gray.rounding), out=out[3])
    return LensStatistics(*out)


def sample_statistics(gray: GrayFlat) -> LensStatistics:
    """`measure_statistics` from every second row, or fewer, of large enough microimages."""
    # 260 pixels are enough to tell whether a lens has texture.
    step = int(np.clip(np.pi * gray.radius**2 / 260, 2, 4))
    return measure_statistics(gray, row_step=step if gray.radius >= 6 else 1)


def find_noise_only(plain: LensStatistics, noise: float) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose contrast their own noise explains."""
    # More contrast than the finest detail has, by the least that counts as faint texture.
    beyond = plain.contrast**2 > (1 + _FAINT**2) * plain.roughness**2
    return ~(_has_any(plain, noise) & beyond) & ~_is_clear(plain, noise)


def find_texture(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    blank: NDArray[np.bool_] | None = None,
    wanted: NDArray[np.bool_] | None = None,
    known_noise: float | None = None,
) -> Texture:
    """Remove the common shading of microimages, of the `wanted` lenses (n,), and classify the
    texture that is left.

    `plain` are the statistics of `gray`; of lenses known to be `blank` (n,), only the shading
    beside lenses with texture is removed.
    """
    wanted = np.ones(len(plain.mean), bool) if wanted is None else wanted
    first = wanted if blank is None else wanted & ~blank
    strips = allocate_strips(gray, plain.mean, 1)
    flattened = remove_shading(gray, lattice, strips, plain.contrast, first)
    found = measure_statistics(flattened, known=plain, wanted=first)
    if blank is not None:
        # Lenses with texture are matched with those beside them.
        some = _has_any(found, found.noise if known_noise is None else known_noise)
        beside = wanted & ~first & dilate_mask(some & first, neighbours_of(lattice).all)
        flattened = remove_shading(gray, lattice, strips, plain.contrast, beside, flattened)
        found = measure_statistics(flattened, found, beside)
    noise = found.noise if known_noise is None else known_noise
    clear = _is_clear(found, noise)
    faint = _has_any(found, noise) & ~clear
    return Texture(flattened, found, noise, clear, faint if blank is None else faint & ~blank)


def classify_texture(gray: GrayFlat, plain: LensStatistics, noise: float) -> Texture:
    """Classify texture with the common shading left in: faster, and correct if there is much
    texture.
    """
    clear = _is_clear(plain, noise)
    return Texture(gray, plain, noise, clear, _has_any(plain, noise) & ~clear)


def estimate_noise(roughness: NDArray[np.float32]) -> float:
    """Noise of a flat [white] from the roughness (n,) of its lenses: that of the smoothest
    fiftieth, a grey level of 8 bits at least, for rounding and compression.
    """
    return max(float(np.quantile(roughness, 0.02)), 1 / 255)


def _has_any(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    # One per cent of the brightness at least: less is lost in the rounding of 8 bits.
    return found.central_contrast > np.maximum(0.01 * found.mean, np.float32(_FAINT * noise))


def _is_clear(found: LensStatistics, noise: float) -> NDArray[np.bool_]:
    # Above two and a half times the noise.
    return _has_any(found, noise) & (
        found.contrast > np.hypot(2.5 * noise, FIXED_PATTERN * found.mean)
    )
