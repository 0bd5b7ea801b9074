"""Restore the detail of a picture: each place by the filter of its patch size and its power above the noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from ..runtime.buffers import allocate_scratch
from .filters import DetailFilters
from .settings import AVERAGING, RESTORE, SMOOTHING, RestoreSettings

__all__ = ["off_edges", "restore_detail"]

_SOFT_EDGE = (1, 0.25)
# Bands whose power is measured; the finest is mostly noise.
_MEASURED = len(SMOOTHING) - 1


def restore_detail(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    patch_size: NDArray[np.float32],
    filters: DetailFilters,
    white: float,
    pitch: float,
    inner: NDArray[np.float32],
    settings: RestoreSettings = RESTORE,
) -> NDArray[np.float32]:
    """A picture as sharp as noise, seams and depth edges allow. A part with `HALO` around it gets the whole's bits.

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
    pitch : float [px]
    inner : (h, w) float32
        1 where detail is restored, 0 where it is left as it is.

    Returns
    -------
    (h, w, C) float32
    """
    height, width, channels = image.shape
    layers = allocate_scratch("bands", (len(SMOOTHING) + 1, height, width * channels), np.float32)
    layers[0] = image.reshape(height, -1)
    for k, (step, side) in enumerate(SMOOTHING):
        _smooth(layers[k], channels, step, np.float32(side), layers[k + 1])
    power = allocate_scratch("band power", (height, width * _MEASURED), np.float32)
    _band_power(layers, channels, np.float32(1 / (white * white * channels)), power)
    spare = allocate_scratch("smoothed power", power.shape, np.float32)
    for step, side in AVERAGING:
        _smooth(power, _MEASURED, step, np.float32(side), spare)
        power, spare = spare, power
    allowed = off_edges(valid, patch_size, pitch, settings) * inner
    numbers = np.array(
        [
            filters.per_ratio / pitch, filters.weakest, filters.per_octave, settings.contrast**2, settings.noise_guard,
        ],
        np.float32,
    )  # fmt: skip
    out = np.empty_like(layers[0])
    per_power = 1 / np.maximum(np.column_stack([filters.power[:, :2] / settings.extra, filters.power.sum(1)]), 1e-20)
    expected = np.column_stack([filters.noise[:, :2], filters.noise.sum(1), per_power]).astype(np.float32)
    _add_bands(layers, power, patch_size, allowed, filters.gains, expected, numbers, out)
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


@njit(cache=True, nogil=True, share=lambda layers, channels, unit, out: len(out))
def _band_power(begin, end, layers, channels, unit, out):
    """Mean square over the channels of each band but the finest, times `unit`."""
    bands = len(layers) - 2
    width = out.shape[1] // bands
    for y in range(begin, end):
        into = out[y]
        for k in range(bands):
            upper, lower = layers[k + 1, y], layers[k + 2, y]
            for x in range(width):
                total = np.float32(0)
                for c in range(x * channels, (x + 1) * channels):
                    difference = upper[c] - lower[c]
                    total += difference * difference
                into[x * bands + k] = total * unit


@njit(cache=True, nogil=True, error_model="numpy", share=lambda layers, power, *_: len(power))
def _add_bands(begin, end, layers, power, patch_size, allowed, gains, expected, numbers, out):
    """Add to each pixel the bands with the gains of its patch size and power."""
    width = patch_size.shape[1]
    channels = layers.shape[2] // width
    steps, levels = gains.shape[0], gains.shape[1] // 2
    per_level, weakest, per_power, floor, guard = numbers
    zero, one, tiny, half = np.float32(0), np.float32(1), np.float32(1e-20), np.float32(0.5)
    factors, strengths, kinds = np.zeros(width, np.float32), np.empty(width, np.float32), np.empty(width, np.int64)
    # The bits of a number above zero grow with its logarithm.
    logarithms, per_bit = strengths.view(np.int32), per_power / np.float32(1 << 23)
    for y in range(begin, end):
        sizes, off_edge, measured, into = patch_size[y], allowed[y], power[y], out[y]
        g0, g1, g2, g3, g4 = layers[0, y], layers[1, y], layers[2, y], layers[3, y], layers[4, y]
        for x in range(width):
            factors[x] = zero
            v1, v2 = measured[3 * x], measured[3 * x + 1]
            seen = v1 + v2 + measured[3 * x + 2]
            if seen <= floor:
                continue
            s = sizes[x]
            n = int(min(abs(s) * per_level, np.float32(levels - 1)) + half) + (levels if s > 0 else 0)
            grain = expected[n, 2]
            sure = one - (guard * grain + floor) / seen
            # A fine band that is weaker than the coarse ones predict: there is no such detail.
            least = min(max(v1, expected[n, 0]) * expected[n, 3], max(v2, expected[n, 1]) * expected[n, 4])
            strength = min((seen - grain - floor) * expected[n, 5], least)
            if sure > 0 and strength > 0:
                factors[x] = off_edge[x] * sure
            strengths[x], kinds[x] = max(strength, tiny), n
        for x in range(width):
            factor = factors[x]
            if factor > 0:
                row = np.float32(logarithms[x]) * per_bit - weakest
                gain = gains[int(min(max(row, zero), np.float32(steps - 1)) + half), kinds[x]]
                a, b, c, d = factor * gain[0], factor * gain[1], factor * gain[2], factor * gain[3]
                for k in range(x * channels, (x + 1) * channels):
                    u0, u1, u2, u3, u4 = g0[k], g1[k], g2[k], g3[k], g4[k]
                    into[k] = u0 + a * (u0 - u1) + b * (u1 - u2) + c * (u2 - u3) + d * (u3 - u4)
            else:
                for k in range(x * channels, (x + 1) * channels):
                    into[k] = g0[k]
