"""Restore the detail of a picture: each place by the filter of its patch size and its power above the noise.

Lenses blur light. Values that are encoded for display (`spectra.is_encoded`) are squared before they are filtered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import kernel

from ..runtime.buffers import allocate_pooled
from .filters import DetailFilters
from .settings import AVERAGING, RESTORE, SMOOTHING, SPECTRA, RestoreSettings

__all__ = ["off_edges", "restore_detail", "smooth_picture", "spread_clipped"]

# Rows that are restored together.
_STRIP = 128


class _Lookup(NamedTuple):
    """What kernels look up, by power of the detail (p) and patch size (n), as `DetailFilters`."""

    gains: NDArray[np.float32]  # (p, n, 4)
    noise: NDArray[np.float32]  # (3, n) of the bands but the finest, in the light of white
    per_fine: NDArray[np.float32]  # (n,) power of detail for each unit of power of the second band
    per_coarse: NDArray[np.float32]  # (n,) likewise, of the coarser ones together
    per_level: np.float32  # [1 / px]
    weakest: np.float32
    per_power: np.float32
    overshoot: np.float32
    darkest: np.float32
    white: np.float32
    encoded: bool


def restore_detail(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    patch_size: NDArray[np.float32],
    filters: DetailFilters,
    white: float,
    encoded: bool,
    pitch: float,
    inner: NDArray[np.float32],
    settings: RestoreSettings = RESTORE,
) -> NDArray[np.float32]:
    """A picture as sharp as noise and depth edges allow, and less noisy. A part with `HALO` gets the whole's bits.

    Parameters
    ----------
    image : (h, w, C) float32
    valid : (h, w) bool
        Pixels that were seen; beside others nothing is restored.
    patch_size : (h, w) float32 [px]
        Of each pixel.
    filters : DetailFilters
    white : float
        Value of white.
    encoded : bool
        Values are about the square root of light.
    pitch : float [px]
    inner : (h, w) float32
        1 where detail is restored, 0 where it is left as it is.

    Returns
    -------
    (h, w, C) float32
    """
    single, (fine, *coarse) = np.float32, filters.power.T
    lookup = _Lookup(
        filters.gains, np.ascontiguousarray(filters.noise.T), 1 / fine, 1 / sum(coarse),
        single(filters.per_ratio / pitch), single(filters.weakest), single(filters.per_octave),
        single(settings.overshoot), single(SPECTRA.darkest), single(white), encoded,
    )  # fmt: skip
    allowed = off_edges(valid, patch_size, pitch, settings) * inner
    steps, bands = np.array((*SMOOTHING, *AVERAGING)), len(SMOOTHING)
    out = allocate_pooled(image.shape, np.float32)
    bright = spread_clipped(image, white, settings)
    _restore_rows(image, patch_size, allowed, bright, lookup, steps, bands, out)
    return out


def off_edges(
    valid: NDArray[np.bool_], patch_size: NDArray[np.float32], pitch: float, settings: RestoreSettings
) -> NDArray[np.float32]:
    """(h, w) 1 on one surface, 0 beside depth edges and places that were not seen."""
    import cv2

    side = 2 * settings.beside_edge + 1
    around = np.ones((side, side), np.uint8)
    spread = cv2.dilate(patch_size, around) - cv2.erode(patch_size, around)
    level = (spread <= settings.edge * pitch).astype(np.float32)
    soft = np.empty_like(level)
    _smooth(level, 1, soft)
    reach = 2 * sum(SMOOTHING) + 1
    return soft * cv2.erode(valid.view(np.uint8), np.ones((reach, reach), np.uint8))


def spread_clipped(image: NDArray[np.float32], white: float, settings: RestoreSettings = RESTORE) -> NDArray[np.uint8]:
    """(h, w, C) 255 about values as bright as white, which are clipped: lenses blurred more light than they show."""
    import cv2

    bright = cv2.convertScaleAbs(image, alpha=255 / white)
    if bright.max() == 255:
        side = 2 * settings.beside_clipped + 1
        bright = cv2.dilate(bright, np.ones((side, side), np.uint8))
    return np.asarray(bright, np.uint8).reshape(image.shape)


def smooth_picture(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture (h, w, C) averaged with its neighbours, with the weights 1, 2, 1 along each axis."""
    planes = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)
    out = np.empty_like(planes)
    for one, smoothed in zip(planes, out, strict=True):
        _smooth(one, 1, smoothed)
    return np.ascontiguousarray(out.transpose(1, 2, 0))


# Without fastmath: a part of a picture gets the same bits as the whole, whatever pixels a vector loop takes together.
@kernel(share=lambda image, *_: len(image))
def _smooth(begin, end, image, step, out):
    """Average `image` (h, w) with the weights 1, 2, 1 along each axis, the outer ones `step` away."""
    line = np.empty(image.shape[1] + 2 * step, np.float32)
    for y in range(begin, end):
        above, below = max(y - step, 0), min(y + step, len(image) - 1)
        _smooth_row(image[above], image[y], image[below], step, line, out[y])


@njit
def _smooth_row(above, here, below, step, line, out):
    """A row of `_smooth`; `line` is scratch."""
    width, quarter, two = len(here), np.float32(0.25), np.float32(2)
    before, own, after = line[:width], line[step : step + width], line[2 * step :]
    for x in range(width):
        own[x] = quarter * (two * here[x] + above[x] + below[x])
    for k in range(step):
        line[k], line[step + width + k] = own[0], own[width - 1]
    for x in range(width):
        out[x] = quarter * (two * own[x] + before[x] + after[x])


@kernel(error_model="numpy", share=lambda image, *_: (len(image) + _STRIP - 1) // _STRIP)
def _restore_rows(begin, end, image, patch_size, allowed, bright, lookup, steps, bands, out):
    """Restore strips of rows. Of each smoothing only the last rows are kept, which stay in the processor's cache."""
    height, width, channels = image.shape
    halo = steps.sum()
    kept = halo + 2
    layers = np.zeros((bands + 1, channels, kept, width), np.float32)
    powers = np.zeros((len(steps) - bands + 1, bands - 1, kept, width), np.float32)
    scratch, kinds = np.empty(width + 2 * steps.max(), np.float32), np.empty(width, np.uint32)
    lines = np.empty((10, width), np.float32)
    for strip in range(begin, end):
        top, bottom = strip * _STRIP, min((strip + 1) * _STRIP, height)
        first = max(top - halo, 0)
        for newest in range(first, bottom + halo):
            if newest < height:
                _to_light(image[newest], lookup, newest % kept, layers[0])
            # Each smoothing lags behind the one before it by its step.
            y = newest
            for k in range(bands):
                y -= steps[k]
                if first <= y < height:
                    _smooth_planes(layers[k], y, first, height, steps[k], scratch, layers[k + 1])
            if first <= y < height:
                _find_power(layers, y % kept, powers[0])
            for k in range(bands, len(steps)):
                y -= steps[k]
                if first <= y < height:
                    seen, smoothed = powers[k - bands], powers[k - bands + 1]
                    _smooth_planes(seen, y, first, height, steps[k], scratch, smoothed)
            if top <= y < bottom:
                above, at, below = max(y - 1, 0) % kept, y % kept, min(y + 1, height - 1) % kept
                share = allowed[y]
                _find_factors(layers[-1], powers[-1], at, patch_size[y], share, lookup, kinds, lines)
                for c in range(channels):
                    _add_row(layers, c, at, lines)
                    _store_row(layers[0, c], above, at, below, share, bright[y], lookup, image[y], c, lines, out[y])


@njit
def _smooth_planes(planes, y, first, height, step, scratch, out):
    """Row `y` of `out` (n, kept, w), those of `planes` smoothed, which hold rows from `first` on."""
    kept = planes.shape[1]
    above, at, below = max(y - step, first) % kept, y % kept, min(y + step, height - 1) % kept
    for n in range(len(planes)):
        _smooth_row(planes[n, above], planes[n, at], planes[n, below], step, scratch, out[n, at])


@njit(error_model="numpy")
def _to_light(image, lookup, at, out):
    """Row `at` of the planes (C, kept, w): a row of the picture (w, C) with white as one, squared if it is encoded."""
    unit, encoded = np.float32(1) / lookup.white, lookup.encoded
    for c in range(len(out)):
        into = out[c, at]
        for x in range(len(image)):
            value = image[x, c] * unit
            into[x] = value * value if encoded else value


@njit(error_model="numpy")
def _find_power(layers, at, out):
    """Row `at` of `out` (bands, kept, w): mean square over the channels of each band but the finest."""
    unit = np.float32(1) / np.float32(layers.shape[1])
    for band in range(len(out)):
        into = out[band, at]
        for x in range(len(into)):
            into[x] = 0
        for c in range(layers.shape[1]):
            upper, lower = layers[band + 1, c, at], layers[band + 2, c, at]
            for x in range(len(into)):
                difference = upper[x] - lower[x]
                into[x] += difference * difference * unit


@njit(error_model="numpy")
def _find_factors(coarsest, power, at, sizes, share, lookup, kinds, lines):
    """Lines 0 to 3: what is added of each band, from row `at` of the coarsest layer and the power.

    `kinds` and the other lines are scratch.
    """
    gains, width, per_level, weakest = lookup.gains, len(sizes), lookup.per_level, lookup.weakest
    steps, levels = gains.shape[0], gains.shape[1] // 2
    zero, one, tiny, half = np.float32(0), np.float32(1), np.float32(1e-20), np.float32(0.5)
    above_zero = half + np.float32(levels)
    last_level, last_step, channels = np.float32(levels - 1), np.float32(steps - 1), len(coarsest)
    f0, f1, f2, f3, light, strength, part = lines[0], lines[1], lines[2], lines[3], lines[4], lines[5], lines[6]
    light[:] = zero
    for c in range(channels):
        row = coarsest[c, at]
        for x in range(width):
            light[x] += row[x]
    for x in range(width):
        light[x] = max(light[x] / np.float32(channels), lookup.darkest)
    for x in range(width):
        s = sizes[x]
        kinds[x] = np.uint32(min(abs(s) * per_level, last_level) + (above_zero if s > 0 else half))
    for band in range(3):
        seen, rest, above, noise = power[band, at], lines[1 + band], lines[7 + band], lookup.noise[band]
        for x in range(width):
            above[x] = max(seen[x] - light[x] * noise[kinds[x]], zero)
        for x in range(width):
            rest[x] = above[x] / max(seen[x], tiny) - one
    fine, middle, coarse, per_fine, per_coarse = lines[7], lines[8], lines[9], lookup.per_fine, lookup.per_coarse
    for x in range(width):
        fine[x] *= per_fine[kinds[x]]
    for x in range(width):
        strength[x] = max(fine[x], (middle[x] + coarse[x]) * per_coarse[kinds[x]])
    # Less of it where fine detail is weaker than the coarse predicts; there noise alone is taken away.
    for x in range(width):
        part[x] = share[x] * fine[x] / max(strength[x], tiny)
    for x in range(width):
        strength[x] = max(strength[x] / light[x], tiny)
    # The bits of a number above zero grow with its logarithm.
    logarithm, per_bit = strength.view(np.int32), lookup.per_power / np.float32(1 << 23)
    for x in range(width):
        row = np.float32(logarithm[x]) * per_bit - weakest
        gain = gains[np.uint32(min(max(row, zero), last_step) + half), kinds[x]]
        taken, rest = part[x], share[x] - part[x]
        noise = rest * f1[x]
        f0[x], f1[x] = taken * gain[0] + noise, taken * gain[1] + noise
        f2[x], f3[x] = taken * gain[2] + rest * f2[x], taken * gain[3] + rest * f3[x]


@njit
def _add_row(layers, c, at, lines):
    """Line 4: row `at` of a channel with the bands added."""
    light, own = lines[4], layers[0, c, at]
    for x in range(len(light)):
        light[x] = own[x]
    for band in range(4):
        factor, upper, lower = lines[band], layers[band, c, at], layers[band + 1, c, at]
        for x in range(len(light)):
            light[x] += factor[x] * (upper[x] - lower[x])


@njit
def _store_row(plane, row_above, row, row_below, share, bright, lookup, image, c, lines, out):
    """Line 4 as values, in the range of their neighbours in three rows of `plane` but for the overshoot."""
    overshoot, white, encoded, zero = lookup.overshoot, lookup.white, lookup.encoded, np.float32(0)
    above, here, below, width = plane[row_above], plane[row], plane[row_below], plane.shape[1]
    light, low, high, least, most = lines[4], lines[5], lines[6], lines[7], lines[8]
    for x in range(width):
        low[x] = min(here[x], min(above[x], below[x]))
        high[x] = max(here[x], max(above[x], below[x]))
    low1, low2, high1, high2, into_low, into_high = low[1:], low[2:], high[1:], high[2:], least[1:], most[1:]
    for x in range(width - 2):
        into_low[x] = min(low[x], min(low1[x], low2[x]))
    for x in range(width - 2):
        into_high[x] = max(high[x], max(high1[x], high2[x]))
    for x, other in ((0, min(1, width - 1)), (width - 1, max(width - 2, 0))):
        least[x], most[x] = min(low[x], low[other]), max(high[x], high[other])
    if encoded:
        for x in range(width):
            light[x] = np.sqrt(max(light[x], zero))
        for x in range(width):
            least[x], most[x] = np.sqrt(least[x]), np.sqrt(most[x])
    for x in range(width):
        beyond = overshoot * (most[x] - least[x]) if bright[x, c] < 255 else zero
        light[x] = min(max(light[x], least[x] - beyond), most[x] + beyond) * white
    for x in range(width):
        out[x, c] = light[x] if share[x] > zero else image[x, c]
