"""Pictures in which the lattice is visible for any scene: normalised brightness, edge strength.

Brightness shows dark gaps and rims. Edges between microimages also show the lattice of flats whose
vignetting was already corrected.
"""

from __future__ import annotations

from typing import Any

import numpy as np

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


@kernel(share=lambda padded, out: len(out))
def _edge_strength(begin, end, padded, out):
    two = np.float32(2)
    for y in range(begin, end):
        above = padded[y]
        here = padded[y + 1]
        below = padded[y + 2]
        line = out[y]
        # Signed indices may be negative and count from the end, which prevents vector loops.
        for x in range(np.uint64(len(line))):
            right = x + np.uint64(2)
            middle = x + np.uint64(1)
            across = (
                above[right] - above[x] + below[right] - below[x] + two * (here[right] - here[x])
            )
            down = (
                below[x]
                - above[x]
                + below[right]
                - above[right]
                + two * (below[middle] - above[middle])
            )
            line[x] = np.sqrt(np.sqrt(across * across + down * down))


def edge_strength(picture: Singles) -> Singles:
    """(h, w) float32 square root of the gradient (Sobel) of a picture of 2 x 2 px or more."""
    out = np.empty_like(picture)
    _edge_strength(_mirrored(picture, 1), out)
    return out


def _mirrored(picture: Singles, margin: int) -> Singles:
    import cv2

    return np.asarray(
        cv2.copyMakeBorder(picture, margin, margin, margin, margin, cv2.BORDER_REFLECT_101)
    )


@kernel(
    error_model="numpy",
    share=lambda padded, side, together, floor, clip, out: -(-len(out) // together),
)
def _normalise(begin, end, padded, side, together, floor, clip, out):
    height, width = out.shape
    share = 1.0 / (side * side)
    half = side // 2
    for part in range(begin, end):
        sums = np.zeros(padded.shape[1])
        squares = np.zeros(padded.shape[1])
        first = part * together
        for y in range(first, min(first + together, height)):
            # The sums of the first window, then a row is added and one subtracted.
            for row in range(first if y == first else y + side - 1, y + side):
                for x in range(len(sums)):
                    value = np.float64(padded[row, x])
                    sums[x] += value
                    squares[x] += value * value
            if y > first:
                for x in range(len(sums)):
                    value = np.float64(padded[y - 1, x])
                    sums[x] -= value
                    squares[x] -= value * value
            total = sums[:side].sum()
            square = squares[:side].sum()
            for x in range(width):
                mean = np.float32(total * share)
                variance = max(np.float32(square * share) - mean * mean, np.float32(0))
                value = (padded[y + half, x + half] - mean) / (np.sqrt(variance) + floor)
                out[y, x] = min(max(value, -clip), clip)
                if x + 1 < width:
                    total += sums[x + side] - sums[x]
                    square += squares[x + side] - squares[x]


def normalise_locally(picture: Singles, window: float) -> Singles:
    """(picture - local mean) / local standard deviation, clipped, for a picture (h, w).

    `window` is the side of the square of mean and deviation [px]; the picture is mirrored at its
    borders.
    """
    half = max(3, int(window) | 1) // 2
    out = np.empty_like(picture)
    _normalise(_mirrored(picture, half), 2 * half + 1, max(64, 4 * half), _FLOOR, _CLIP, out)
    return out


def interpolate_linear(picture: Singles, positions: Floats) -> Floats:
    """(...,) bilinear interpolation of a picture at positions (..., 2) [px]; nearest outside."""
    height, width = picture.shape
    x = positions[..., 0].clip(0, width - 1)
    y = positions[..., 1].clip(0, height - 1)
    left = np.minimum(x.astype(np.intp), width - 2)
    top = np.minimum(y.astype(np.intp), height - 2)
    right = x - left
    down = y - top
    # Indices of one axis are read twice as fast.
    pixels = picture.ravel()
    first = top * width + left
    second = first + width
    above = (1 - right) * pixels.take(first) + right * pixels.take(first + 1)
    below = (1 - right) * pixels.take(second) + right * pixels.take(second + 1)
    return np.asarray((1 - down) * above + down * below)
