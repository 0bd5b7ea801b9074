"""How sharp a flat is: what interpolation takes from it, and over which width its lenses have averaged already."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.fastmath import FAST, square

from ..runtime.buffers import scratch
from .grey_flat import trusted_radius

__all__ = ["lens_blur", "packed_to_read", "ready_to_read"]

# Bilinear reading at any place averages the flat with a triangle of this variance [px^2], at whole pixels with nothing;
# over all places the mean is 1/6. A second difference with half of that as its factor gives it back.
_GIVEN_BACK = 1 / 12
# Distances at which brightness is compared [px]: near ones tell blur, far ones the grain of the scene.
_LAGS = np.array([1, 2, 3, 4, 6, 8])
# Lenses that are compared, and parts of their range of depth that are looked at on their own.
_LENSES, _PARTS = 240, 4
# Widths of blur and grains of scenes that are tried [px].
_WIDTHS, _GRAINS = np.geomspace(1.0, 12.0, 36), np.geomspace(0.7, 45.0, 24)
# With fewer distances than this, blur and grain cannot be told apart.
_LEAST_LAGS = 3


def ready_to_read(pixels: NDArray) -> NDArray:
    """The flat as bilinear reading wants it: what interpolation blurs is given back before.

    Between pixels bilinear interpolation averages, at pixels it does not. Where many lenses and places share in
    a picture, their mean has the sharpness of the flat itself.

    Parameters
    ----------
    pixels : (H, W, C) uint8, uint16 or float32

    Returns
    -------
    array of the same shape and type
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    out = np.empty_like(rows)
    if rows.dtype.kind == "f":
        _give_back(rows, pixels.shape[2], out)
    elif rows.dtype == np.uint8:
        _give_back_bytes(rows, pixels.shape[2], out)
    else:
        _give_back_whole(rows, pixels.shape[2], np.float32(np.iinfo(rows.dtype).max), out)
    return out.reshape(pixels.shape)


# Exact rules of rounding: a part of a flat gets what the whole has there, whatever pixels a vector loop takes together.
@njit(cache=True, nogil=True, parallel=True)
def _give_back(flat, channels, out):
    height, width = flat.shape
    middle, side = np.float32(1 + 4 * _GIVEN_BACK), np.float32(_GIVEN_BACK)
    for y in prange(height):
        above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
        into = out[y]
        n = width - 2 * channels
        before, own, after = here[: max(n, 0)], here[channels:], here[2 * channels :]
        up, down, target = above[channels:], below[channels:], into[channels:]
        for k in range(n):
            target[k] = middle * own[k] - side * ((before[k] + after[k]) + (up[k] + down[k]))
        for end in range(min(2 * channels, width)):
            k = end if end < channels else width - 2 * channels + end
            left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
            into[k] = middle * here[k] - side * ((left + right) + (above[k] + below[k]))


@njit(cache=True, nogil=True)
def _whole_given_back(flat, y, channels, highest, into):
    """A row as of `_give_back`, rounded: sixteen twelfths of a pixel less one twelfth of each beside it, plus a half.

    Twelve times the answer is a whole number that single precision holds exactly, and a twelfth is rounded up there, so
    that cutting off after the product is the division of whole numbers; vectors hold more of these than of integers.
    """
    height, width = flat.shape
    sixteen, six, zero, twelfth = np.float32(16), np.float32(6), np.float32(0), np.float32(1 / 12)
    above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
    n = width - 2 * channels
    before, own, after = here[: max(n, 0)], here[channels:], here[2 * channels :]
    up, down, target = above[channels:], below[channels:], into[channels:]
    for k in range(n):
        sides = (np.float32(before[k]) + np.float32(after[k])) + (np.float32(up[k]) + np.float32(down[k]))
        target[k] = min(max(np.float32(own[k]) * sixteen - sides + six, zero) * twelfth, highest)
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
        sides = (np.float32(left) + np.float32(right)) + (np.float32(above[k]) + np.float32(below[k]))
        into[k] = min(max(np.float32(here[k]) * sixteen - sides + six, zero) * twelfth, highest)


@njit(cache=True, nogil=True, parallel=True)
def _give_back_whole(flat, channels, highest, out):
    for y in prange(len(flat)):
        _whole_given_back(flat, y, channels, highest, out[y])


@njit(cache=True, nogil=True)
def _bytes_given_back(flat, y, channels, line, into):
    """A row as of `_whole_given_back`, for bytes: a line between two loops keeps them to 16 bits: vectors hold more."""
    height, width = flat.shape
    above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
    n = max(width - 2 * channels, 0)
    before, own, after = here[:n], here[channels:], here[2 * channels :]
    up, down = above[channels:], below[channels:]
    middle = line[channels:]
    for k in range(n):
        middle[k] = np.int16(own[k]) * 16 + 6 - before[k] - after[k] - up[k] - down[k]
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
        line[k] = np.int16(here[k]) * 16 + 6 - left - right - above[k] - below[k]
    for k in range(width):
        # 5462 / 65536 is a twelfth, rounded up by less than counts below 4096.
        value = min(max(line[k], np.int16(0)), np.int16(12 * 255 + 11))
        into[k] = np.uint8((np.uint32(value) * np.uint32(5462)) >> np.uint32(16))


@njit(cache=True, nogil=True, parallel=True)
def _give_back_bytes(flat, channels, out):
    for y in prange(len(flat)):
        _bytes_given_back(flat, y, channels, np.empty(flat.shape[1], np.int16), out[y])


@njit(cache=True, nogil=True)
def _packed(row, channels, into):
    """Put the channels of each pixel of a row into one number, the first lowest."""
    kind = into.dtype.type
    if channels == 3:
        for x in range(len(into)):
            at = np.uint64(3) * np.uint64(x)
            pixel = kind(row[at]) | (kind(row[at + np.uint64(1)]) << kind(8 * row.itemsize))
            into[x] = pixel | (kind(row[at + np.uint64(2)]) << kind(16 * row.itemsize))
    else:
        for x in range(len(into)):
            pixel = kind(0)
            for c in range(channels):
                pixel |= kind(row[x * channels + c]) << kind(8 * row.itemsize * c)
            into[x] = pixel


@njit(cache=True, nogil=True, parallel=True)
def _give_back_packed(flat, channels, out):
    for y in prange(len(flat)):
        row = np.empty(flat.shape[1], np.uint8)
        _bytes_given_back(flat, y, channels, np.empty(flat.shape[1], np.int16), row)
        _packed(row, channels, out[y])


@njit(cache=True, nogil=True, parallel=True)
def _give_back_packed_shorts(flat, channels, highest, out):
    for y in prange(len(flat)):
        row = np.empty(flat.shape[1], np.uint16)
        _whole_given_back(flat, y, channels, highest, row)
        _packed(row, channels, out[y])


def packed_to_read(pixels: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint32 | np.uint64]:
    """(H, W) uint32, or uint64 of shorts: `ready_to_read` with the channels of each pixel (H, W, C) in one number, the
    first lowest; C is 4 at most. In `scratch` memory."""
    rows, channels = np.ascontiguousarray(pixels).reshape(len(pixels), -1), pixels.shape[2]
    if pixels.dtype == np.uint8:
        out = scratch("packed", pixels.shape[:2], np.uint32)
        _give_back_packed(rows, channels, out)
    else:
        out = scratch("packed shorts", pixels.shape[:2], np.uint64)
        _give_back_packed_shorts(rows, channels, np.float32(np.iinfo(pixels.dtype).max), out)
    return out


def lens_blur(
    pixels: NDArray | Callable[[tuple[int, int, int, int]], NDArray],
    calibration: Calibration,
    patch_size: NDArray[np.float32],
) -> float:
    """Width over which the microlenses have averaged the scene, in shares of the patch size.

    Brightness differs the more, the farther places lie apart: in a sharp picture of edges of all sizes its mean square
    difference grows as `1 - exp(-distance / grain)`, at once; blur makes it start with the square. Both are fitted.
    A scene that is smooth itself looks blurred; it has nothing that could alias either.

    Parameters
    ----------
    pixels : (H, W, C) array, or callable
        The latter gives the part `left, top, right, bottom` of them.
    calibration : Calibration
    patch_size : (n,) float32 [px]
        Of all lenses, NaN where unresolved.

    Returns
    -------
    float
        Side of the square that blurs as much, over `|s|`; 0 where nothing tells.
    """
    lenses = np.flatnonzero(np.abs(np.nan_to_num(patch_size)) > 1)
    radius = trusted_radius(calibration)
    lags = _LAGS[radius >= _LAGS]
    if len(lags) < _LEAST_LAGS or not len(lenses):
        return 0.0
    look = pixels if callable(pixels) else partial(_part, pixels)
    types = calibration.lens_types
    kinds = np.zeros(len(lenses), int) if types is None else types.of(calibration.lattice.indices()[lenses])
    # The sharpest type leads where it is in focus, and must not alias.
    return min(
        _blur_of(look, calibration, patch_size, lenses[kinds == kind], radius, lags) for kind in np.unique(kinds)
    )


def _part(pixels: NDArray, part: tuple[int, int, int, int]) -> NDArray:
    return pixels[part[1] : part[3], part[0] : part[2]]


def _blur_of(
    look: Callable[[tuple[int, int, int, int]], NDArray],
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    lenses: NDArray[np.int64],
    radius: float,
    lags: NDArray[np.int64],
) -> float:
    """`lens_blur` of some lenses: the mean over parts of their range of depth, by their contrast."""
    lenses = lenses[:: max(1, len(lenses) // _LENSES)]
    lenses = lenses[np.argsort(np.abs(patch_size[lenses]), kind="stable")]
    found = np.zeros((len(lenses), len(lags)))
    size = np.array(calibration.image_size)
    for number, centre in enumerate(calibration.lattice.centres()[lenses]):
        low, high = np.floor(centre - radius).astype(int) - 1, np.ceil(centre + radius).astype(int) + 2
        low, high = np.maximum(low, 0), np.minimum(high, size)
        part = np.ascontiguousarray(look((*low.tolist(), *high.tolist())))
        _differences(part, (centre - low)[None], radius, lags, found[number : number + 1])
    models = _models(lags)
    total = weight = 0.0
    for part in np.array_split(np.arange(len(lenses)), min(_PARTS, len(lenses))):
        grown = found[part].sum(0)
        if not (grown > 0).all():
            continue
        misfit = np.log(models) - np.log(grown)
        spread = misfit.var(-1)
        width = _WIDTHS[np.unravel_index(np.argmin(spread), spread.shape)[0]]
        # A pixel averages over its own width in any case; that is counted where the picture is drawn.
        total += grown[-1] * (width**2 - 1) / float(np.median(np.abs(patch_size[lenses[part]]))) ** 2
        weight += grown[-1]
    return float(np.sqrt(total / weight)) if weight > 0 else 0.0


def _models(lags: NDArray[np.int64]) -> NDArray[np.float64]:
    """(widths, grains, lags) mean square difference of edges of one grain, averaged over a width."""
    width, grain = _WIDTHS[:, None, None], _GRAINS[:, None]

    def twice(x: NDArray[np.float64]) -> NDArray[np.float64]:
        # Two integrals of 1 - exp(-|x| / grain); their second difference is its mean over pairs from a width.
        return x * x / 2 - grain * np.abs(x) - grain**2 * np.exp(-np.abs(x) / grain)

    def averaged(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return (twice(x + width) - 2 * twice(x) + twice(x - width)) / width**2

    return averaged(lags.astype(np.float64)) - averaged(np.zeros(1))


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _differences(flat, centres, radius, lags, out):
    """Mean square difference along rows and columns at each of the `lags`, within a circle in each microimage."""
    height, width, channels = flat.shape
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0], centres[lens, 1]
        if cx < radius or cy < radius or cx > width - 1 - radius or cy > height - 1 - radius:
            continue
        limit = radius * radius
        for n in range(len(lags)):
            lag = lags[n]
            total = 0.0
            count = 0
            for y in range(int(np.ceil(cy - radius)), int(np.floor(cy + radius)) + 1):
                for x in range(int(np.ceil(cx - radius)), int(np.floor(cx + radius)) + 1):
                    if square(x - cx) + square(y - cy) > limit:
                        continue
                    if square(x + lag - cx) + square(y - cy) <= limit:
                        for k in range(channels):
                            total += square(np.float64(flat[y, x + lag, k]) - np.float64(flat[y, x, k]))
                        count += 1
                    if square(x - cx) + square(y + lag - cy) <= limit:
                        for k in range(channels):
                            total += square(np.float64(flat[y + lag, x, k]) - np.float64(flat[y, x, k]))
                        count += 1
            out[lens, n] = total / max(count, 1)
