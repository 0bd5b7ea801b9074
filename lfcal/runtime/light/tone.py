"""From sensor values to those of a display: brightness, white balance and tone curve.

A sensor counts light, a display expects values that are encoded by the curve of sRGB (IEC
61966-2-1). Gains are factors on light: encoded values are decoded first, and encoded again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..arrays import ENOUGH_PIXELS, Array, Floats, white_of

__all__ = [
    "Exposure",
    "Gains",
    "WhiteBalance",
    "apply_tone",
    "balance_of",
    "decode_srgb",
    "encode_srgb",
    "exposure_gain",
    "grey_world",
    "is_encoded",
    "linear_light",
    "to_eight_bits",
]

#: Brightness of a picture [EV], or by its content.
Exposure = float | Literal["auto"]
#: A gain of all channels, or of each.
Gains = float | Sequence[float] | Floats
#: Gains of red, green and blue; found; or all 1.
WhiteBalance = tuple[float, float, float] | Literal["auto", "none"]

# Part of white that the brightest places of a picture get, by their share of the pixels [%].
_BRIGHT = 0.9
_BRIGHTEST = 99.5
# Largest gain that a picture gets by its content: beyond it there is nothing but noise.
_MOST_GAIN = 1000.0
# Shares of white between which pixels tell the colour of the light: darker ones hold mostly noise,
# of brighter ones a channel may be clipped.
_TELLING = (0.01, 0.98)
# Largest gain of a channel by grey world: a scene of one colour would become noise in another.
_MOST_BALANCE = 4.0
# Curve of sRGB: slope and end of its straight part, in light; offset and exponent of the rest.
_SLOPE = 12.92
_STRAIGHT = 0.0031308
_OFFSET = 0.055
_EXPONENT = 2.4


def is_encoded(dtype: DTypeLike, stated: bool | None = None) -> bool:
    """Whether values are encoded for a display, not in proportion to light.

    As it is `stated` (`Calibration.encoded`), else those of 8 bits are.
    """
    if stated is None:
        return np.dtype(dtype) == np.uint8
    return stated


def encode_srgb(light: Array) -> Array:
    """Values of sRGB for light from 0 to 1; negative light is 0, brighter light stays brighter."""
    light = np.maximum(light, 0)
    curved = (1 + _OFFSET) * np.power(light, 1 / _EXPONENT) - _OFFSET
    return np.where(light <= _STRAIGHT, _SLOPE * light, curved)


def decode_srgb(values: Array) -> Array:
    """Light for values of sRGB from 0 to 1, the inverse of `encode_srgb`."""
    values = np.maximum(values, 0)
    curved = np.power((values + _OFFSET) / (1 + _OFFSET), _EXPONENT)
    return np.where(values <= _SLOPE * _STRAIGHT, values / _SLOPE, curved)


def _full(pixels: Array, white: float | None) -> float:
    """The value of white; that of 8 bits is 255, whatever the camera says."""
    if pixels.dtype == np.uint8:
        white = None
    return white_of(pixels, white)


def linear_light(pixels: Array, white: float | None = None, encoded: bool | None = None) -> Floats:
    """Light of pixels, with white as 1; arguments as of `apply_tone`."""
    share = np.nan_to_num(np.asarray(pixels, np.float64)) / _full(pixels, white)
    if is_encoded(pixels.dtype, encoded):
        return decode_srgb(share)
    return share


def _sample(pixels: Array, white: float | None, encoded: bool) -> Floats:
    """Light of about a million pixels of a picture."""
    step = max(1, int(np.sqrt(pixels.size / ENOUGH_PIXELS)))
    return linear_light(pixels[::step, ::step], white, encoded)


def exposure_gain(
    pixels: Array,
    white: float | None = None,
    exposure: Exposure | None = "auto",
    encoded: bool | None = None,
    balance: Gains = 1.0,
) -> float:
    """The gain on light by which a picture is brightened: `2 ** exposure`.

    With `"auto"` it follows from the content: a dim picture is brightened until 99.5 % of its
    values have less than 0.9 of the light of white, a thousand times at most; bright ones are left
    as they are. None does so for linear pictures alone: those that are `encoded` (as `is_encoded`
    tells) are made for displays already. `balance` are gains that are applied too.
    """
    encoded = is_encoded(pixels.dtype, encoded)
    if exposure is None:
        exposure = 0.0 if encoded else "auto"
    if exposure != "auto":
        return float(2**exposure)
    light = _sample(pixels, white, encoded) * np.asarray(balance)
    bright = float(np.percentile(light, _BRIGHTEST)) / _BRIGHT
    return float(np.clip(1 / max(bright, 1e-12), 1, _MOST_GAIN))


def grey_world(
    pixels: Array, white: float | None = None, encoded: bool | None = None
) -> tuple[float, float, float]:
    """Gains of red, green and blue after which a picture (h, w, 3) is grey on the average.

    Pixels that are dark or may be clipped are left out. The least gain is 1, so that what is
    clipped stays white.
    """
    light = _sample(pixels, white, is_encoded(pixels.dtype, encoded)).reshape(-1, 3)
    telling = (light.min(1) > _TELLING[0]) & (light.max(1) < _TELLING[1])
    if not telling.any():
        return 1.0, 1.0, 1.0
    return balance_of(light[telling].mean(0))


def balance_of(colour: Floats) -> tuple[float, float, float]:
    """Gains that make this colour (3,) of the light grey; the least is 1, the largest 4."""
    gains = colour.max() / np.maximum(colour, 1e-12)
    red, green, blue = np.minimum(gains, _MOST_BALANCE).tolist()
    return red, green, blue


def apply_tone(
    pixels: Array,
    dtype: DTypeLike,
    srgb: bool,
    *,
    white: float | None = None,
    gain: Gains = 1.0,
    encoded: bool | None = None,
    top: float | None = None,
) -> Array:
    """Pixels times a gain of their light, as sRGB or in proportion to light.

    Parameters
    ----------
    pixels : (h, w) or (h, w, C) uint8, uint16 or float
    dtype : data-type
        Of the result: uint8, uint16 or float32. Light of linear integers of the same type keeps its
        scale, with white at `white`; otherwise white becomes the largest value, or 1 of floats.
        Integers are clipped at white.
    srgb : bool
        Whether the result is encoded by the curve of sRGB.
    white : float, optional
        White of integers of 16 bits.
    gain : float or (C,) array
        Of all channels, or of each.
    encoded : bool, optional
        Whether `pixels` are; see `is_encoded`.
    top : float, optional
        White of the result, if it is not to be chosen as above.
    """
    dtype = np.dtype(dtype)
    encoded = is_encoded(pixels.dtype, encoded)
    gains = np.unique(gain) if np.ptp(gain) == 0 else np.asarray(gain)
    full = _full(pixels, white)
    if top is None:
        top = white_of(np.empty(0, dtype))
        if not srgb and pixels.dtype == dtype:
            top = full
    if (gains == 1).all() and encoded == srgb and pixels.dtype == dtype and top == full:
        return pixels
    if pixels.dtype.kind == "f":
        return _tone(pixels, dtype, encoded, srgb, full, top, gains)
    values = np.arange(np.iinfo(pixels.dtype).max + 1, dtype=pixels.dtype)
    if gains.size == 1:
        return _tone(values, dtype, encoded, srgb, full, top, gains)[pixels]
    layers = [_tone(values, dtype, encoded, srgb, full, top, one) for one in gains]
    return np.stack([layer[pixels[..., k]] for k, layer in enumerate(layers)], -1)


def _tone(
    pixels: Array,
    dtype: np.dtype,
    encoded: bool,
    srgb: bool,
    full: float,
    top: float,
    gains: Gains,
) -> Array:
    """What `apply_tone` does to each value; `full` is white before, `top` white after it."""
    share = np.nan_to_num(pixels) / full
    if pixels.dtype.kind == "f":
        share = share.astype(np.float32, copy=False)
    light = decode_srgb(share) if encoded else share
    light = light * np.asarray(gains, light.dtype)
    shown = encode_srgb(light) if srgb else light
    if dtype.kind == "f":
        return shown.astype(dtype)
    return np.rint(np.clip(shown, 0, 1) * top).astype(dtype)


def to_eight_bits(
    pixels: Array,
    white: float | None = None,
    gain: Gains = 1.0,
    encoded: bool | None = None,
) -> NDArray[np.uint8]:
    """Pixels times a gain of their light as uint8 for a display; arguments as of `apply_tone`."""
    return np.asarray(
        apply_tone(pixels, np.uint8, True, white=white, gain=gain, encoded=encoded), np.uint8
    )
