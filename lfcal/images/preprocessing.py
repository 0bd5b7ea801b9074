"""Pictures that show the lattice whatever the scene is: locally normalised brightness and edge
strength.

Brightness shows dark gaps and rims. Edges where one microimage ends and the next begins also show
the lattice of flats whose gaps a camera has already corrected away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def luminance(image: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 luminance of raw values (h, w) or (h, w, 3); negative ones (dark noise) count
    as 0.
    """
    import cv2

    grey: Any
    if image.ndim == 2:
        grey = np.array(image, dtype=np.float32)
    elif image.dtype == np.uint8:
        grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    else:
        grey = cv2.transform(
            np.asarray(image, dtype=np.float32), np.array([[0.299, 0.587, 0.114]], np.float32)
        )
    if image.dtype.kind != "u":
        np.maximum(grey, 0, out=grey)
    return grey


def sqrt_luminance(image: NDArray[Any]) -> NDArray[np.float32]:
    """(h, w) float32 square root of the luminance of raw values (h, w) or (h, w, 3), scaled to mean
    1.

    Photon noise is then the same in light and shade. Negative values (dark noise) count as 0.
    """
    grey = luminance(image)
    np.sqrt(grey, out=grey)
    mean = float(grey.mean())
    if mean > 0:
        grey *= np.float32(1 / mean)
    return grey


def is_mask(picture: NDArray[Any]) -> bool:
    """Whether a picture (h, w) or (h, w, 3) has two tones only, as discs that were drawn, or cut
    off at a level.
    """
    return len(np.unique(picture[:: max(1, len(picture) // 64)])) <= 2


def soften_mask(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture (h, w), blurred by a pixel where it is a mask: fits to edges need a slope there."""
    import cv2

    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.0)) if is_mask(picture) else picture


@kernel(share=lambda padded, out: len(out))
def _edge_strength(begin, end, padded, out):
    two = np.float32(2)
    for y in range(begin, end):
        above = padded[y]
        here = padded[y + 1]
        below = padded[y + 2]
        line = out[y]
        # Unsigned indices: signed ones may count from the end, which prevents vector loops.
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


def edge_strength(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) float32 square root of the gradient magnitude (Sobel) of a `sqrt_luminance` picture,
    at least 2 x 2 px.
    """
    out = np.empty_like(picture)
    _edge_strength(_mirrored(picture, 1), out)
    return out


def _mirrored(picture: NDArray[np.float32], margin: int) -> NDArray[np.float32]:
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
            # Sums over the rows of the window: all of the first one, then one more and one less.
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


def normalise_locally(picture: NDArray[np.float32], window: float) -> NDArray[np.float32]:
    """(picture - local mean) / local standard deviation, clipped, for a picture (h, w).

    `window` is the side of the square of mean and deviation [px]; the picture is mirrored at its
    borders.
    """
    half = max(3, int(window) | 1) // 2
    out = np.empty_like(picture)
    # A hundredth of the mean tone or two is added to the deviation, so that noise is not amplified.
    floor = np.float32(0.02)
    clip = np.float32(3)
    _normalise(_mirrored(picture, half), 2 * half + 1, max(64, 4 * half), floor, clip, out)
    return out


def interpolate_linear(
    picture: NDArray[np.float32], positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(...,) bilinear interpolation of a picture (h, w) at positions `positions` (..., 2) [px];
    nearest beyond it.
    """
    low = np.clip(np.floor(positions), 0, np.array(picture.shape[::-1]) - 2).astype(np.intp)
    (x, y), (right, down) = (
        np.moveaxis(low, -1, 0),
        np.moveaxis(np.clip(positions - low, 0, 1), -1, 0),
    )
    above = (1 - right) * picture[y, x] + right * picture[y, x + 1]
    below = (1 - right) * picture[y + 1, x] + right * picture[y + 1, x + 1]
    return np.asarray((1 - down) * above + down * below)
