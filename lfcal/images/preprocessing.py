"""Pictures in which the lattice is visible for any scene: normalised brightness, edge strength.

Brightness shows dark gaps and rims. Edges between microimages also show the lattice of flats whose
vignetting was already corrected.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from ..runtime.arrays import Array, Floats, Singles
from ..runtime.kernels import kernel

__all__ = [
    "edge_strength",
    "interpolate_linear",
    "is_mask",
    "luminance",
    "normalise_locally",
    "soften_mask",
    "sqrt_luminance",
]

# Weights of red, green and blue in luminance (ITU-R BT.601).
_LUMINANCE = np.array([[0.299, 0.587, 0.114]], np.float32)
# Added to local standard deviations, so that noise is not amplified [mean of the picture].
_FLOOR = np.float32(0.02)
# Largest normalised value [standard deviations].
_CLIP = np.float32(3)


def luminance(image: Array) -> Singles:
    """(h, w) float32 luminance of raw values (h, w) or (h, w, 3); negative ones become 0."""
    import cv2

    grey: Any
    if image.ndim == 2:
        grey = np.array(image, dtype=np.float32)
    elif image.dtype == np.uint8:
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    else:
        grey = cv2.transform(np.asarray(image, dtype=np.float32), _LUMINANCE)
    if image.dtype.kind != "u":
        np.maximum(grey, 0, out=grey)
    return grey


def sqrt_luminance(image: Array) -> Singles:
    """(h, w) float32 square root of the luminance of raw values (h, w) or (h, w, 3), of mean 1.

    Photon noise is equal in bright and dark parts of it.
    """
    grey = luminance(image)
    np.sqrt(grey, out=grey)
    mean = float(grey.mean())
    if mean > 0:
        grey *= np.float32(1 / mean)
    return grey


def is_mask(picture: Array) -> bool:
    """Whether a picture (h, w) or (h, w, 3) has at most two tones, such as drawn discs."""
    return len(np.unique(picture[:: max(1, len(picture) // 64)])) <= 2


def soften_mask(picture: Singles) -> Singles:
    """A picture (h, w), blurred by a pixel if it is a mask: fits to edges need a slope."""
    import cv2

    if is_mask(picture):
        return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0))
    return picture


def _writable(picture: Array) -> Singles:
    """The picture as one block that may be written to: others would compile the kernels anew."""
    return np.require(picture, np.float32, ["C", "W"])


@njit(error_model="numpy", forceinline=True)
def _mirror(at, length):
    """The pixel that stands at `at` where a line of `length` px is mirrored at both of its ends."""
    period = max(2 * length - 2, 1)
    at = at % period
    return min(at, period - at) if at >= length else at


@njit(error_model="numpy", forceinline=True)
def _gradient(above, here, below, left, middle, right):
    """Square root of the gradient at column `middle` of three lines."""
    two = np.float32(2)
    across = (
        above[right] - above[left] + below[right] - below[left] + two * (here[right] - here[left])
    )
    down = (
        below[left]
        - above[left]
        + below[right]
        - above[right]
        + two * (below[middle] - above[middle])
    )
    return np.sqrt(np.sqrt(across * across + down * down))


@kernel(share=lambda picture, out: len(out))
def _edge_strength(begin, end, picture, out):
    height, width = picture.shape
    for y in range(begin, end):
        above = picture[_mirror(y - 1, height)]
        here = picture[y]
        below = picture[_mirror(y + 1, height)]
        line = out[y]
        # Signed indices may be negative and count from the end, which prevents vector loops.
        for left in range(np.uint64(max(width - 2, 0))):
            middle = left + np.uint64(1)
            line[middle] = _gradient(above, here, below, left, middle, left + np.uint64(2))
        for x in (0, width - 1):
            line[x] = _gradient(above, here, below, _mirror(x - 1, width), x, _mirror(x + 1, width))


def edge_strength(picture: Singles) -> Singles:
    """(h, w) float32 square root of the gradient (Sobel) of a picture of 2 x 2 px or more."""
    out = np.empty_like(picture)
    _edge_strength(_writable(picture), out)
    return out


@kernel(
    error_model="numpy",
    share=lambda picture, half, together, floor, clip, out: -(-len(out) // together),
)
def _normalise(begin, end, picture, half, together, floor, clip, out):
    height, width = out.shape
    side = 2 * half + 1
    share = 1.0 / (side * side)
    # Sums over the columns of a window, with those beyond both sides.
    sums, squares = np.empty((2, width + 2 * half))
    totals, of_squares = np.empty((2, width))
    for part in range(begin, end):
        inner = sums[half : half + width]
        inner_squares = squares[half : half + width]
        inner[:] = 0
        inner_squares[:] = 0
        first = part * together
        for y in range(first, min(first + together, height)):
            # The sums of the first window, then a row is added and one subtracted.
            if y == first:
                for row in range(y - half, y + half + 1):
                    pixels = picture[_mirror(row, height)]
                    for x in range(width):
                        value = np.float64(pixels[x])
                        inner[x] += value
                        inner_squares[x] += value * value
            else:
                added = picture[_mirror(y + half, height)]
                left = picture[_mirror(y - half - 1, height)]
                for x in range(width):
                    new = np.float64(added[x])
                    old = np.float64(left[x])
                    inner[x] = inner[x] + new - old
                    inner_squares[x] = inner_squares[x] + new * new - old * old
            for beyond in range(half):
                for x in (half - 1 - beyond, half + width + beyond):
                    inside = half + _mirror(x - half, width)
                    sums[x] = sums[inside]
                    squares[x] = squares[inside]
            total = sums[:side].sum()
            square = squares[:side].sum()
            for x in range(width):
                totals[x] = total
                of_squares[x] = square
                if x + 1 < width:
                    total += sums[x + side] - sums[x]
                    square += squares[x + side] - squares[x]
            for x in range(width):
                mean = np.float32(totals[x] * share)
                variance = max(np.float32(of_squares[x] * share) - mean * mean, np.float32(0))
                value = (picture[y, x] - mean) / (np.sqrt(variance) + floor)
                out[y, x] = min(max(value, -clip), clip)


def normalise_locally(picture: Singles, window: float) -> Singles:
    """(picture - local mean) / local standard deviation, clipped, for a picture (h, w).

    `window` is the side of the square of mean and deviation [px]; the picture is mirrored at its
    borders.
    """
    half = max(3, int(window) | 1) // 2
    out = np.empty_like(picture)
    _normalise(_writable(picture), half, max(64, 4 * half), _FLOOR, _CLIP, out)
    return out


@kernel
def _interpolate(picture, positions, out):
    height, width = picture.shape
    for k in range(len(out)):
        # In this order, NaN becomes 0.
        x = min(max(0.0, positions[k, 0]), width - 1.0)
        y = min(max(0.0, positions[k, 1]), height - 1.0)
        left = min(int(x), width - 2)
        top = min(int(y), height - 2)
        right = x - left
        down = y - top
        above = (1 - right) * picture[top, left] + right * picture[top, left + 1]
        below = (1 - right) * picture[top + 1, left] + right * picture[top + 1, left + 1]
        out[k] = (1 - down) * above + down * below


def interpolate_linear(picture: Singles, positions: Floats) -> Floats:
    """(...,) bilinear interpolation of a picture at positions (..., 2) [px]; nearest outside."""
    out = np.empty(positions.shape[:-1])
    places = np.require(positions, np.float64, ["C", "W"]).reshape(-1, 2)
    _interpolate(_writable(picture), places, out.reshape(-1))
    return out
