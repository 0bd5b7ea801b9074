"""Colour filter mosaics: which one a flat has, and its light without it, at the resolution of the
sensor.

Colours are not interpolated, which would blur the lattice. The four phases of the 2 x 2 mosaic are
scaled to the same local mean instead; where the scene is coloured, a filter with zeros at the three
mosaic frequencies removes the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import MOSAICS, Mosaic

__all__ = ["check_mosaic", "equalise_mosaic", "find_mosaic", "remove_mosaic"]


def check_mosaic(mosaic: str | None, flat: NDArray[Any]) -> None:
    """ValueError where `mosaic` is no name of one, FlatError where the flat is in colour, or green
    lies elsewhere.
    """
    if mosaic is None:
        return
    if mosaic not in MOSAICS:
        raise ValueError(f"mosaic must be one of {', '.join(MOSAICS)} or None, got {mosaic!r}")
    if flat.ndim == 3:
        raise FlatError(
            f"the flat is in colour, so it has no {mosaic} mosaic any more; give it without 'mosaic'"
        )
    measured = find_mosaic(flat)
    if measured is not None and (measured[0] == "G") != (mosaic[0] == "G"):
        other = measured.translate(str.maketrans("RB", "BR"))
        raise FlatError(
            f"the filters are stated as {mosaic}, but green lies as in {measured} and {other}; give one of these"
        )


def find_mosaic(flat: NDArray[Any]) -> Mosaic | None:
    """The colour filters over the top left 2 x 2 pixels of a `flat`, None where there are none.

    Behind filters, differences between neighbouring pixels are those of colours: they follow the
    scene, so that the spectrum has peaks about the frequencies of the mosaic, which neither detail
    nor noise has, and lattices of whole pixels only among others as high. The difference of red and
    blue is then the same along rows and columns where these lie at the top left and bottom right,
    opposite where green does. Which of the two is red is a guess.
    """
    height = flat.shape[0] // 2 * 2
    width = flat.shape[1] // 2 * 2
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
    # Darker ones show no colour.
    blocks = blocks[means > 0.02 * means.max()]
    if len(blocks) == 0:
        return None
    alike, opposite, diagonal = _peaks(blocks)
    # On 14 captures, 25 white images and 900 lattices of whole pixels without filters sum and
    # difference are unlike by 1.7 where either is above 0.7, and diagonals have 1.0 at most; with
    # filters 9 to 700, by 20 and more; of a twentieth of the usual saturation, or in JPEG files of
    # quality 50, about 1.
    unlike = max(alike, opposite) > 3 * min(alike, opposite)
    if not (unlike and max(alike, opposite) > 1) and not diagonal > 1.5:
        return None
    # Means of the phases in small squares: (n, 4), from left to right and from top to bottom.
    squares = blocks.reshape(len(blocks), 8, -1, 2, 8, side // 16, 2).mean((2, 5))
    phases = np.moveaxis(squares, 2, 3).reshape(-1, 4).astype(np.float64)
    outer = phases[:, [0, 3]]
    inner = phases[:, [1, 2]]
    # Where red and blue are hardly unlike, as on some white images, green is the brighter diagonal.
    green_inside = alike > opposite if unlike else inner.mean() > outer.mean()
    first, second = np.log((outer if green_inside else inner).T + 1e-6)
    # Saturated things are red more often than blue, which no white balance changes: the logarithm
    # of red over blue has the longer tail above its median (on 12 of 15 pictures). Where it has
    # none, as on white images, the brighter is red.
    low, middle, high = np.quantile(first - second, [0.02, 0.5, 0.98])
    longer = high + low - 2 * middle
    red_first = bool((longer if abs(longer) > 0.01 else middle) > 0)
    if green_inside:
        return "RGGB" if red_first else "BGGR"
    return "GRBG" if red_first else "GBRG"


def _peaks(blocks: NDArray[np.float32]) -> list[float]:
    """Mean power about the frequencies of a mosaic over the highest beside them, in the upper
    quarter of the blocks.

    Of the sum and of the difference of what alternates from row to row and from column to column,
    and of what alternates from diagonal to diagonal.
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
    # Colours do not change from pixel to pixel.
    near = distance < 0.052
    beside = (distance > 0.09) & (distance < 0.26)
    highest = (
        np.array([one[:, beside].max(1) for one in power])
        + 1e-9 * (np.abs(spectrum) ** 2).mean((1, 2))
        + 1e-30
    )
    highest[:2] = highest[:2].max(0)
    # A quarter of a scene is coloured.
    return np.quantile([one[:, near].mean(1) for one in power] / highest, 0.75, axis=1).tolist()


def equalise_mosaic(flat: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 light of a mosaic `flat` (h, w), its four phases scaled to the same local
    mean.
    """
    import cv2

    height, width = flat.shape
    # Odd sizes get a row or column of the phase that they lack.
    light = np.pad(flat.astype(np.float32), ((0, height % 2), (0, width % 2)), "reflect")
    window = max(65, int(min(height, width) / 8)) // 2 | 1
    phases = [light[y::2, x::2] for y in (0, 1) for x in (0, 1)]
    means: list[Any] = [cv2.blur(phase, (window, window)) for phase in phases]
    common: Any = np.mean(means, axis=0)
    floor = np.float32(1e-6 * float(common.mean()) + 1e-30)
    for phase, mean in zip(phases, means, strict=True):
        phase *= common / np.maximum(mean, floor)
    return np.ascontiguousarray(light[:height, :width])


def remove_mosaic(light: NDArray[np.float32]) -> NDArray[Any]:
    """`light` (h, w) filtered with weights 1, 2, 1 along both axes, zero at the frequencies of a
    mosaic.
    """
    import cv2

    kernel = np.array([0.25, 0.5, 0.25], np.float32)
    return cv2.sepFilter2D(light, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
