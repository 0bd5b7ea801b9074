"""Pictures in which microimages look alike whatever the scene shows: local brightness and local breaks.

Brightness against its surroundings carries dark gaps and rims. Breaks, the steep steps where one microimage ends and
the next begins, carry the lattice where a camera has already flattened the gaps away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

__all__ = ["breaks", "level_locally", "luminance", "tone"]

# Contrast below this share of the mean tone is taken for noise and not blown up.
_NOISE_FLOOR = 0.02
# Pixels further than this from their surroundings, in local standard deviations, tell no more than "far".
_CLIP = 3.0
# Types of raw values whose root is taken as they are, most flats; others are converted first.
_ROOTED = (np.uint8, np.uint16)


@njit(cache=True, nogil=True, parallel=True)
def _root(values, out):
    for y in prange(values.shape[0]):
        for x in range(values.shape[1]):
            out[y, x] = np.sqrt(np.float32(values[y, x]))


@njit(cache=True, nogil=True, parallel=True)
def _scale(values, factor):
    for y in prange(values.shape[0]):
        for x in range(values.shape[1]):
            values[y, x] *= factor


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
    np.maximum(grey, 0, out=grey)
    return grey


def tone(image: NDArray[Any]) -> NDArray[np.float32]:
    """Square root of the luminance, scaled to mean 1, which makes photon noise alike in light and shade.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array of finite numbers
        Raw values; negative ones (dark noise) count as 0.

    Returns
    -------
    (h, w) float32
        All zero where the image is all zero.
    """
    if image.ndim == 2 and image.dtype in _ROOTED:
        grey = np.empty(image.shape, np.float32)
        _root(image, grey)
    else:
        grey = luminance(image)
        np.sqrt(grey, out=grey)
    mean = float(grey.mean())
    if mean > 0:
        _scale(grey, np.float32(1 / mean))
    return grey


@njit(cache=True, nogil=True)
def _steep(above, here, below, left, x, right):
    across = (above[right] - above[left]) + (below[right] - below[left])
    across += (here[right] - here[left]) + (here[right] - here[left])
    down = (below[left] - above[left]) + (below[right] - above[right])
    down += (below[x] - above[x]) + (below[x] - above[x])
    return np.sqrt(np.sqrt(across * across + down * down))


@njit(cache=True, nogil=True, parallel=True)
def _steepness(picture, steepness):
    height, width = picture.shape
    for y in prange(height):
        above, here, below = picture[abs(y - 1)], picture[y], picture[y + 1 if y + 1 < height else height - 2]
        line = steepness[y]
        line[0] = _steep(above, here, below, 1, 0, 1)
        for x in range(1, width - 1):
            line[x] = _steep(above, here, below, x - 1, x, x + 1)
        line[width - 1] = _steep(above, here, below, width - 2, width - 1, width - 2)


def breaks(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) float32 square root of the gradient magnitude (Sobel) of a `tone` picture, at least 2 x 2 px."""
    # Not OpenCV's magnitude, whose last bit depends on where in memory a picture lies.
    steepness = np.empty_like(picture)
    _steepness(picture, steepness)
    return steepness


@njit(cache=True, nogil=True, parallel=True)
def _divide_by_spread(picture, mean, square, floor, clip):
    height, width = picture.shape
    for y in prange(height):
        for x in range(width):
            m = mean[y, x]
            value = (picture[y, x] - m) / (np.sqrt(max(square[y, x] - m * m, np.float32(0))) + floor)
            mean[y, x] = min(max(value, -clip), clip)


def level_locally(picture: NDArray[np.float32], window: float) -> NDArray[np.float32]:
    """Picture minus its local mean over its local standard deviation, clipped.

    Parameters
    ----------
    picture : (h, w) float32
    window : float [px]
        Side of the square over which mean and standard deviation are taken.
    """
    import cv2

    size = (max(3, int(window) | 1),) * 2
    mean: Any = cv2.blur(picture, size)
    square: Any = cv2.blur(np.square(picture), size)
    _divide_by_spread(picture, mean, square, np.float32(_NOISE_FLOOR), np.float32(_CLIP))
    return mean
