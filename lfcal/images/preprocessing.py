"""Pictures that show the lattice whatever the scene is: locally normalised brightness and edge strength.

Brightness shows dark gaps and rims. Edges where one microimage ends and the next begins also show the lattice of flats
whose gaps a camera has already corrected away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..runtime.kernels.jit import kernel
from .settings import PREPROCESSING

__all__ = ["edge_strength", "is_mask", "luminance", "normalise_locally", "soften_mask", "sqrt_luminance"]


def luminance(image: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 luminance of raw values (h, w) or (h, w, 3); negative ones (dark noise) count as 0."""
    import cv2

    grey: Any
    if image.ndim == 3:
        if image.dtype == np.uint8:
            grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
        else:
            grey = cv2.transform(np.asarray(image, dtype=np.float32), np.array([[0.299, 0.587, 0.114]], np.float32))
    else:
        grey = np.array(image, dtype=np.float32)
    if image.dtype.kind != "u":
        np.maximum(grey, 0, out=grey)
    return grey


def sqrt_luminance(image: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 square root of the luminance of raw values (h, w) or (h, w, 3), scaled to mean 1.

    Photon noise is then the same in light and shade. Negative values (dark noise) count as 0.
    """
    grey = luminance(image)
    np.sqrt(grey, out=grey)
    mean = float(grey.mean())
    if mean > 0:
        grey *= np.float32(1 / mean)
    return grey


def is_mask(picture: NDArray[Any]) -> bool:
    """Whether a picture (h, w) or (h, w, 3) has two tones only, as discs that were drawn, or cut off at a level."""
    return len(np.unique(picture[:: max(1, len(picture) // 64)])) <= 2


def soften_mask(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture (h, w), blurred by a pixel where it is a mask: fits to edges need a slope there."""
    import cv2

    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0)) if is_mask(picture) else picture


@njit
def _root_gradient(above, here, below, left, x, right):
    across = (above[right] - above[left]) + (below[right] - below[left])
    across += (here[right] - here[left]) + (here[right] - here[left])
    down = (below[left] - above[left]) + (below[right] - above[right])
    down += (below[x] - above[x]) + (below[x] - above[x])
    return np.sqrt(np.sqrt(across * across + down * down))


@kernel(share=lambda picture, *_: len(picture))
def _edge_strength(begin, end, picture, out):
    height, width = picture.shape
    # Unsigned indices: signed ones may count from the end, which prevents vector loops.
    one = np.uint64(1)
    for y in range(begin, end):
        above, here, below = picture[abs(y - 1)], picture[y], picture[y + 1 if y + 1 < height else height - 2]
        line = out[y]
        line[0] = _root_gradient(above, here, below, 1, 0, 1)
        for x in range(one, np.uint64(width) - one):
            line[x] = _root_gradient(above, here, below, x - one, x, x + one)
        line[width - 1] = _root_gradient(above, here, below, width - 2, width - 1, width - 2)


def edge_strength(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) float32 square root of the gradient magnitude (Sobel) of a `sqrt_luminance` picture, at least 2 x 2 px."""
    # The last bit of OpenCV's magnitude depends on the memory alignment of a picture.
    out = np.empty_like(picture)
    _edge_strength(picture, out)
    return out


@njit(inline="always")
def _mirrored(at, count):
    """Index into `count` values for one that may lie beyond them: mirrored, the ends not repeated."""
    last = count - 1
    while at < 0 or at > last:
        at = -at if at < 0 else 2 * last - at
        if last == 0:
            return 0
    return at


@njit(error_model="numpy")
def _add_row(row, squares, sums):
    for x in range(len(row)):
        value = np.float64(row[x])
        sums[x] += value
        squares[x] += value * value


@njit(error_model="numpy")
def _exchange_row(row, other, squares, sums):
    """Add a `row` to the column sums, and subtract an `other` one."""
    for x in range(len(row)):
        value, gone = np.float64(row[x]), np.float64(other[x])
        sums[x] += value - gone
        squares[x] += value * value - gone * gone


@njit(error_model="numpy", forceinline=True)
def _cumulate(sums, half, out):
    """Fill `out` (n + 2 half + 1,) with cumulative sums of `sums` (n,), its ends mirrored."""
    count, total = len(sums), 0.0
    out[0] = 0.0
    for x in range(half):
        total += sums[_mirrored(x - half, count)]
        out[x + 1] = total
    # Four at a time, as each addition to the total waits for the one before.
    after = out[half + 1 :]
    whole, one, two, three = np.uint64(count // 4 * 4), np.uint64(1), np.uint64(2), np.uint64(3)
    for x in range(np.uint64(0), whole, np.uint64(4)):
        pair = sums[x] + sums[x + one]
        after[x], after[x + one] = total + sums[x], total + pair
        after[x + two] = total + (pair + sums[x + two])
        total += pair + (sums[x + two] + sums[x + three])
        after[x + three] = total
    for x in range(whole, np.uint64(count)):
        total += sums[x]
        after[x] = total
    for x in range(half):
        total += sums[_mirrored(count + x, count)]
        out[half + count + x + 1] = total


@njit(error_model="numpy")
def _normalise_row(row, sums, squares, side, floor, clip, out):
    """Normalise a row, from cumulative sums over windows of `side` rows, and over their squares."""
    share = 1.0 / (side * side)
    # Unsigned indices, as above.
    later, later_squares = sums[side:], squares[side:]
    for x in range(np.uint64(len(row))):
        mean = np.float32((later[x] - sums[x]) * share)
        square = np.float32((later_squares[x] - squares[x]) * share)
        value = (row[x] - mean) / (np.sqrt(max(square - mean * mean, np.float32(0))) + floor)
        out[x] = min(max(value, -clip), clip)


@kernel(error_model="numpy", share=lambda picture, _, together, *__: -(-len(picture) // together))
def _normalise(begin, end, picture, half, together, floor, clip, out):
    """See `normalise_locally`; each thread takes `together` rows one after the other."""
    height, width = picture.shape
    side = 2 * half + 1
    for part in range(begin, end):
        sums, squares = np.zeros(width), np.zeros(width)
        running, running_squares = np.empty(width + side), np.empty(width + side)
        first = part * together
        for y in range(first - half, first + half + 1):
            _add_row(picture[_mirrored(y, height)], squares, sums)
        for y in range(first, min(first + together, height)):
            if y > first:
                more, less = _mirrored(y + half, height), _mirrored(y - half - 1, height)
                _exchange_row(picture[more], picture[less], squares, sums)
            _cumulate(sums, half, running)
            _cumulate(squares, half, running_squares)
            _normalise_row(picture[y], running, running_squares, side, floor, clip, out[y])


def normalise_locally(picture: NDArray[np.float32], window: float) -> NDArray[np.float32]:
    """(picture - local mean) / local standard deviation, clipped, for a picture (h, w).

    `window` is the side of the square of mean and deviation [px]; the picture is mirrored at its borders.
    """
    half = max(3, int(window) | 1) // 2
    out = np.empty_like(picture)
    floor, clip = np.float32(PREPROCESSING.noise_floor), np.float32(PREPROCESSING.clip)
    _normalise(picture, half, max(PREPROCESSING.rows, 4 * half), floor, clip, out)
    return out
