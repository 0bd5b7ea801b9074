"""Restore the detail of a picture: each place by the filter of its patch size and its power above the noise.

Lenses blur light. What is encoded for display, as all pixels of 8 bits are, is squared before it is filtered.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from ..runtime.buffers import allocate_scratch
from .filters import DetailFilters
from .settings import AVERAGING, RESTORE, SMOOTHING, RestoreSettings

__all__ = ["convolve", "off_edges", "restore_detail", "smooth_picture"]

_SOFT_EDGE = (1, 0.25)
# Bands whose power is measured; the finest is mostly noise.
_MEASURED = len(SMOOTHING) - 1


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
    height, width, channels = image.shape
    values = image.reshape(height, -1)
    layers = allocate_scratch("bands", (len(SMOOTHING) + 1, height, width * channels), np.float32)
    _to_light(values, np.float32(1 / white), encoded, layers[0])
    for k, (step, side) in enumerate(SMOOTHING):
        _smooth(layers[k], channels, step, np.float32(side), layers[k + 1])
    power = allocate_scratch("band power", (_MEASURED, height, width), np.float32)
    _band_power(layers, channels, np.float32(1 / channels), power)
    spare = allocate_scratch("smoothed power", power.shape, np.float32)
    for step, side in AVERAGING:
        for one, smoothed in zip(power, spare, strict=True):
            _smooth(one, 1, step, np.float32(side), smoothed)
        power, spare = spare, power
    allowed = off_edges(valid, patch_size, pitch, settings) * inner
    numbers = np.array(
        [
            filters.per_ratio / pitch, filters.weakest, filters.per_octave, settings.overshoot,
            settings.darkest, white, encoded,
        ],
        np.float32,
    )  # fmt: skip
    coarse = filters.power[:, 1:].sum(1)
    expected = np.column_stack([filters.noise, 1 / filters.power[:, 0], 1 / coarse]).astype(np.float32)
    out = np.empty_like(values)
    _add_bands(values, layers, power, patch_size, allowed, filters.gains, expected, numbers, out)
    return out.reshape(image.shape)


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
    _smooth(level, 1, _SOFT_EDGE[0], np.float32(_SOFT_EDGE[1]), soft)
    reach = 2 * sum(step for step, _ in SMOOTHING) + 1
    return soft * cv2.erode(valid.view(np.uint8), np.ones((reach, reach), np.uint8))


def smooth_picture(image: NDArray[np.float32], side: float) -> NDArray[np.float32]:
    """A picture (h, w, C) averaged with its neighbours, which have the weight `side` along each axis."""
    rows = np.ascontiguousarray(image, np.float32).reshape(len(image), -1)
    out = np.empty_like(rows)
    _smooth(rows, image.shape[2], 1, np.float32(side), out)
    return out.reshape(image.shape)


def convolve(image: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture (h, w, C) convolved with a symmetric kernel of odd sides; beyond its border it goes on."""
    half, (height, width, channels) = len(kernel) // 2, image.shape
    wide = np.pad(image, ((half, half), (half, half), (0, 0)), "edge").reshape(height + 2 * half, -1)
    out = np.empty((height, width * channels), np.float32)
    _convolve(wide, np.ascontiguousarray(kernel), channels, out)
    return out.reshape(image.shape)


# Without fastmath: a part of a picture gets the same bits as the whole, whatever pixels a vector loop takes together.
@njit(cache=True, nogil=True, share=lambda image, *_: len(image))
def _smooth(begin, end, image, channels, step, side, out):
    """Average `image` (h, w * channels) with three taps along each axis, the outer ones `step` away."""
    height, wide = image.shape
    middle, far = np.float32(1) - side - side, step * channels
    line = np.empty(wide, np.float32)
    for y in range(begin, end):
        above, here, below, into = image[max(y - step, 0)], image[y], image[min(y + step, height - 1)], out[y]
        for k in range(wide):
            line[k] = middle * here[k] + side * (above[k] + below[k])
        inside = max(wide - 2 * far, 0)
        before, own, after, target = line[:inside], line[far:], line[2 * far :], into[far:]
        for k in range(inside):
            target[k] = middle * own[k] + side * (before[k] + after[k])
        for end_k in range(min(2 * far, wide)):
            k = end_k if end_k < far or inside == 0 else wide - 2 * far + end_k
            c = k % channels
            left, right = max(k - far, c), min(k + far, wide - channels + c)
            into[k] = middle * line[k] + side * (line[left] + line[right])


@njit(cache=True, nogil=True, share=lambda image, kernel, channels, out: len(out))
def _convolve(begin, end, image, kernel, channels, out):
    """Sum of the rows of `image`, moved by as much and times as much as the kernel tells."""
    for y in range(begin, end):
        into = out[y]
        into[:] = 0
        for j in range(kernel.shape[0]):
            row = image[y + j]
            for i in range(kernel.shape[1]):
                weight, moved = kernel[j, i], row[i * channels :]
                if weight != 0:
                    for k in range(len(into)):
                        into[k] += weight * moved[k]


@njit(cache=True, nogil=True, share=lambda image, *_: len(image))
def _to_light(begin, end, image, unit, encoded, out):
    """`image` times `unit`, squared where it is `encoded`."""
    for y in range(begin, end):
        here, into = image[y], out[y]
        for k in range(len(here)):
            value = here[k] * unit
            into[k] = value * value if encoded else value


@njit(cache=True, nogil=True, share=lambda layers, channels, unit, out: out.shape[1])
def _band_power(begin, end, layers, channels, unit, out):
    """(bands, h, w) mean square over the channels of each band but the finest, times `unit`."""
    square = np.empty(layers.shape[2], np.float32)
    for y in range(begin, end):
        for band in range(len(out)):
            upper, lower, into = layers[band + 1, y], layers[band + 2, y], out[band, y]
            for k in range(len(square)):
                difference = upper[k] - lower[k]
                square[k] = difference * difference
            _sum_channels(square, channels, unit, into)


@njit(cache=True, nogil=True)
def _sum_channels(line, channels, unit, out):
    """`out` (w,) the sum over the channels of `line` (w * channels), times `unit`."""
    if channels == 3:
        for x in range(len(out)):
            out[x] = (line[3 * x] + line[3 * x + 1] + line[3 * x + 2]) * unit
    else:
        for x in range(len(out)):
            total = np.float32(0)
            for k in range(x * channels, (x + 1) * channels):
                total += line[k]
            out[x] = total * unit


@njit(cache=True, nogil=True)
def _repeat(values, channels, out):
    """`out` (w * channels) each of `values` (w,) for all channels."""
    if channels == 3:
        for x in range(len(values)):
            value = values[x]
            out[3 * x], out[3 * x + 1], out[3 * x + 2] = value, value, value
    else:
        for x in range(len(values)):
            for k in range(x * channels, (x + 1) * channels):
                out[k] = values[x]


@njit(cache=True, nogil=True, error_model="numpy", share=lambda image, layers, power, *_: len(image))
def _add_bands(begin, end, image, layers, power, patch_size, allowed, gains, expected, numbers, out):
    """Add to each pixel the bands with the gains of its patch size and power, or what noise leaves of them.

    Values stay in the range of their neighbours in `image`, but for the overshoot.
    """
    height, width = patch_size.shape
    channels = layers.shape[2] // width
    wide = channels * width
    steps, levels = gains.shape[0], gains.shape[1] // 2
    per_level, weakest, per_power, overshoot, darkest, white = numbers[:6]
    zero, one, tiny, half = np.float32(0), np.float32(1), np.float32(1e-20), np.float32(0.5)
    per_channel, encoded = one / np.float32(channels), numbers[6] > 0
    added, strengths = np.zeros((3, width), np.float32), np.empty(width, np.float32)
    levels_at, shares = np.empty(width, np.int64), np.empty(width, np.float32)
    lights, line = np.empty(width, np.float32), np.empty(wide, np.float32)
    factors, repeated = np.zeros((4, width), np.float32), np.zeros((4, wide), np.float32)
    least, most = np.empty(wide, np.float32), np.empty(wide, np.float32)
    # The bits of a number above zero grow with its logarithm.
    logarithms, per_bit = strengths.view(np.int32), per_power / np.float32(1 << 23)
    for y in range(begin, end):
        sizes, share, into = patch_size[y], allowed[y], out[y]
        p1, p2, p3 = power[0, y], power[1, y], power[2, y]
        g0, g1, g2, g3, g4 = layers[0, y], layers[1, y], layers[2, y], layers[3, y], layers[4, y]
        _sum_channels(g4, channels, per_channel, lights)
        for x in range(width):
            light = max(lights[x], darkest)
            s = sizes[x]
            n = int(min(abs(s) * per_level, np.float32(levels - 1)) + half) + (levels if s > 0 else 0)
            told = expected[n]
            v1, v2, v3 = p1[x], p2[x], p3[x]
            s1, s2, s3 = v1 - light * told[0], v2 - light * told[1], v3 - light * told[2]
            s1, s2, s3 = max(s1, zero), max(s2, zero), max(s3, zero)
            fine = s1 * told[3]
            strength = max(fine, (s2 + s3) * told[4])
            # Less of it where fine detail is weaker than the coarse predicts; there noise alone is taken away.
            part = share[x] * fine / max(strength, tiny)
            rest = share[x] - part
            added[0, x], added[1, x] = rest * (s1 / max(v1, tiny) - one), rest * (s2 / max(v2, tiny) - one)
            added[2, x] = rest * (s3 / max(v3, tiny) - one)
            strengths[x], levels_at[x], shares[x] = max(strength / light, tiny), n, part
        for x in range(width):
            row = np.float32(logarithms[x]) * per_bit - weakest
            gain = gains[int(min(max(row, zero), np.float32(steps - 1)) + half), levels_at[x]]
            part = shares[x]
            factors[0, x], factors[1, x] = part * gain[0] + added[0, x], part * gain[1] + added[0, x]
            factors[2, x], factors[3, x] = part * gain[2] + added[1, x], part * gain[3] + added[2, x]
        for band in range(4):
            _repeat(factors[band], channels, repeated[band])
        fa, fb, fc, fd = repeated[0], repeated[1], repeated[2], repeated[3]
        for k in range(wide):
            u0, u1, u2, u3, u4 = g0[k], g1[k], g2[k], g3[k], g4[k]
            line[k] = max(u0 + fa[k] * (u0 - u1) + fb[k] * (u1 - u2) + fc[k] * (u2 - u3) + fd[k] * (u3 - u4), zero)
        if encoded:
            for k in range(wide):
                line[k] = np.sqrt(line[k])
        _find_range(image[max(y - 1, 0)], image[y], image[min(y + 1, height - 1)], channels, least, most)
        for k in range(wide):
            beyond = overshoot * (most[k] - least[k])
            into[k] = min(max(line[k] * white, least[k] - beyond), most[k] + beyond)
        for x in range(width):
            if share[x] == 0:
                for k in range(x * channels, (x + 1) * channels):
                    into[k] = image[y, k]


@njit(cache=True, nogil=True)
def _find_range(above, here, below, channels, least, most):
    """Least and most value of each channel among 3 x 3 pixels, of three rows."""
    wide = len(here)
    low, high = np.empty(wide, np.float32), np.empty(wide, np.float32)
    for k in range(wide):
        low[k] = min(here[k], min(above[k], below[k]))
        high[k] = max(here[k], max(above[k], below[k]))
    inside = max(wide - 2 * channels, 0)
    into_low, into_high = least[channels:], most[channels:]
    low1, low2, high1, high2 = low[channels:], low[2 * channels :], high[channels:], high[2 * channels :]
    for k in range(inside):
        into_low[k] = min(low[k], min(low1[k], low2[k]))
        into_high[k] = max(high[k], max(high1[k], high2[k]))
    for c in range(channels):
        last = wide - channels + c
        for k, other in ((c, min(c + channels, last)), (last, max(last - channels, c))):
            least[k], most[k] = min(low[k], low[other]), max(high[k], high[other])
