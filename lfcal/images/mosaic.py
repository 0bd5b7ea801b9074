"""Colour filter mosaics: finding the mosaic of a flat, and removing it at full resolution.

Colours are not interpolated because that would blur the lattice. Instead, the four phases of the
2 x 2 mosaic are scaled to the same local mean. In coloured parts of a scene, a filter with zeros at
the three frequencies of the mosaic removes the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..runtime.arrays import ENOUGH_PIXELS, Array, Singles, evenly
from ..runtime.errors import FlatError
from ..runtime.image_formats import MOSAICS, Mosaic
from ..runtime.light.tone import balance_of, linear_light

__all__ = ["balance_mosaic", "check_mosaic", "equalise_mosaic", "find_mosaic", "remove_mosaic"]

# Share of white from which a pixel may be clipped, least share of the pixels below it, and light of
# a square over that of the brightest ones from which none of its pixels lies at a rim: with 0.3 the
# balance of microimages of 20 px is wrong by 3 %.
_UNCLIPPED = 0.98
_FEWEST = 0.01
_LIT = 0.8
# Blocks darker than this share of the brightest one show no colour.
_DARK = 0.02
# Radius about a frequency of the mosaic in which power is that of colours, which change slowly, and
# the radii between which it is compared [cycles per pixel].
_NEAR = 0.052
_BESIDE = (0.09, 0.26)
# Quantile of the blocks whose power counts: a quarter of a scene is coloured.
_COLOURED = 0.75
# Tails of the logarithm of red over blue [quantiles], and the least difference of their lengths
# that tells red from blue.
_TAILS = [0.02, 0.5, 0.98]
_LONGER = 0.01
# Least logarithm of red over blue at which the brighter of the two, if it is as bright as green,
# is red: sensors see less red and blue than green, and only warm light or a warm scene lifts one of
# them so far. True of 11 of 12 pictures in which the colours differ so much.
_WARM = 0.25


def check_mosaic(mosaic: str | None, flat: Array) -> None:
    """Raise ValueError if the name of a mosaic is wrong, FlatError if a flat does not have it."""
    if mosaic is None:
        return
    if mosaic not in MOSAICS:
        raise ValueError(f"mosaic must be one of {', '.join(MOSAICS)} or None, got {mosaic!r}")
    if flat.ndim == 3:
        raise FlatError(
            f"the flat is in colour, so it has no {mosaic} mosaic any more; give it without "
            "'mosaic'"
        )
    measured = find_mosaic(flat)
    if measured is not None and (measured[0] == "G") != (mosaic[0] == "G"):
        other = measured.translate(str.maketrans("RB", "BR"))
        raise FlatError(
            f"the filters are stated as {mosaic}, but green lies as in {measured} and {other}; "
            "give one of these"
        )


def find_mosaic(flat: Array) -> Mosaic | None:
    """The colour filters over the top left 2 x 2 pixels of a `flat` (h, w), None if it has none.

    Behind filters, neighbouring pixels differ by colours, which change slowly. So the spectrum has
    peaks about the frequencies of the mosaic; detail and noise have none there, and lattices of
    whole pixels have others as high. Red minus blue has the same sign along rows and columns if red
    and blue lie at the top left and bottom right, opposite signs if green does. Which of the two is
    red is a guess.
    """
    height, width = (n // 2 * 2 for n in flat.shape[:2])
    side = min(64, height, width) // 16 * 16
    if flat.ndim != 2 or side == 0:
        return None
    rows, columns = (
        np.unique(np.linspace(0, n - side, 12).astype(int) // 2 * 2) for n in (height, width)
    )
    blocks = np.array(
        [flat[y : y + side, x : x + side] for y in rows for x in columns], dtype=np.float32
    )
    means = blocks.mean((1, 2))
    blocks = blocks[means > _DARK * means.max()]
    if len(blocks) == 0:
        return None
    alike, opposite, diagonal = _peaks(blocks)
    # On 14 captures, 25 white images and 900 lattices of whole pixels without filters, sum and
    # difference differ by a factor of at most 1.7 if either is above 0.7, and diagonals are 1.0 at
    # most. With filters they are 9 to 700 and differ by a factor of 20 and more; about 1 at a
    # twentieth of the usual saturation or in JPEG files of quality 50.
    highest = max(alike, opposite)
    unlike = highest > 3 * min(alike, opposite)
    if not (unlike and highest > 1) and not diagonal > 1.5:
        return None
    # Means of the phases in small squares: (n, 4), from left to right and from top to bottom.
    squares = blocks.reshape(len(blocks), 8, -1, 2, 8, side // 16, 2).mean((2, 5))
    phases = np.moveaxis(squares, 2, 3).reshape(-1, 4).astype(np.float64)
    outer = phases[:, [0, 3]]
    inner = phases[:, [1, 2]]
    # If red and blue hardly differ, as on some white images, green is the brighter diagonal.
    green_inside = alike > opposite if unlike else inner.mean() > outer.mean()
    green, coloured = (inner, outer) if green_inside else (outer, inner)
    first, second = np.log(coloured.T + 1e-6)
    # Saturated objects are red more often than blue, whatever the white balance: the logarithm of
    # red over blue has the longer tail above its median (on 12 of 15 pictures). If no tail is
    # longer, as on white images, the brighter colour is red.
    low, middle, high = np.quantile(first - second, _TAILS)
    longer = high + low - 2 * middle
    as_bright = np.median(coloured, 0).max() >= np.median(green)
    by_brightness = abs(longer) <= _LONGER or (as_bright and abs(middle) > _WARM)
    red_first = bool((middle if by_brightness else longer) > 0)
    if green_inside:
        if red_first:
            return "RGGB"
        return "BGGR"
    if red_first:
        return "GRBG"
    return "GBRG"


def balance_mosaic(
    white: Array, mosaic: Mosaic, level: float | None, encoded: bool | None
) -> tuple[float, float, float] | None:
    """Gains of red, green and blue that make a white image (h, w) behind filters grey.

    They are the ratios of the summed light of squares of 2 x 2 pixels that are neither clipped nor
    at the rims of microimages. `level` is the white level of the sensor; `encoded` as in `is_encoded`.
    None if nearly everything is clipped. All are 1 where green is the darkest: a sensor sees less red
    or less blue by any lamp, so that the camera has balanced its colours already.
    """
    height, width = (n // 2 * 2 for n in white.shape)
    squares = white[:height, :width].reshape(height // 2, 2, width // 2, 2)
    phases = np.moveaxis(squares, (1, 3), (0, 1)).reshape(4, -1)
    light = linear_light(phases[:, evenly(phases.shape[1], ENOUGH_PIXELS)], level, encoded)
    unclipped = light.max(0) < _UNCLIPPED
    if unclipped.mean() < _FEWEST:
        return None
    mean = light.mean(0)
    bright = unclipped & (mean > _LIT * np.quantile(mean[unclipped], 0.95))
    sums = light[:, bright].mean(1)
    colours = [sums[[one == colour for one in mosaic]].mean() for colour in "RGB"]
    red, green, blue = colours
    if green < min(red, blue):
        return 1.0, 1.0, 1.0
    return balance_of(np.array(colours))


def _peaks(blocks: Singles) -> list[float]:
    """Mean power about the frequencies of a mosaic over the highest beside them (upper quartile).

    Three values: for the sum and the difference of the parts of `blocks` (n, side, side) that
    alternate from row to row and from column to column, and for the part that alternates along
    both.
    """
    side = blocks.shape[1]
    window = np.hanning(side + 1)[:side].astype(np.float32)
    spectrum = np.fft.fft2(
        (blocks - blocks.mean((1, 2), keepdims=True)) * (window * window[:, None])
    )
    rows, columns = (np.roll(spectrum, side // 2, axis) for axis in (1, 2))
    power = [
        np.abs(one) ** 2 for one in (rows + columns, rows - columns, np.roll(rows, side // 2, 2))
    ]
    distance = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side)))
    near = distance < _NEAR
    beside = (distance > _BESIDE[0]) & (distance < _BESIDE[1])
    highest = (
        np.array([one[:, beside].max(1) for one in power])
        + 1e-9 * (np.abs(spectrum) ** 2).mean((1, 2))
        + 1e-30
    )
    highest[:2] = highest[:2].max(0)
    peaks = [one[:, near].mean(1) for one in power] / highest
    return np.quantile(peaks, _COLOURED, axis=1).tolist()


def equalise_mosaic(flat: Array) -> Singles:
    """(h, w) float32 light of a mosaic `flat` (h, w), with its phases scaled to one local mean."""
    import cv2

    height, width = flat.shape
    # An odd size is extended by the row or column of the missing phase.
    light = np.pad(flat.astype(np.float32), ((0, height % 2), (0, width % 2)), "reflect")
    # An eighth of the flat, at least 65 px.
    window = max(64, min(height, width) // 8) // 2 | 1
    phases = [light[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    means: list[Any] = [cv2.blur(phase, (window, window)) for phase in phases]
    common: Any = np.mean(means, axis=0)
    floor = np.float32(1e-6 * float(common.mean()) + 1e-30)
    for phase, mean in zip(phases, means, strict=True):
        phase *= common / np.maximum(mean, floor)
    return np.ascontiguousarray(light[:height, :width])


def remove_mosaic(light: Singles) -> Array:
    """`light` (h, w) filtered with weights 1, 2, 1 along both axes, which removes a mosaic."""
    import cv2

    kernel = np.array([0.25, 0.5, 0.25], np.float32)
    return cv2.sepFilter2D(light, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
