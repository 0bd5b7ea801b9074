"""Vignetting-corrected pictures of the flat that matching and drawing read from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.fastmath import FAST, square

from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached
from ..runtime.intrinsics import prefetch

__all__ = [
    "GrayFlat",
    "correction_table",
    "downsample",
    "downsample_lattice",
    "has_uneven_lenses",
    "make_gray_flat",
    "white_level",
]  # fmt: skip

# A gain above this would lift more noise than picture at the rim of a microimage.
_MAX_GAIN = 4.0
# Light that departs from one radial profile for all lenses by less than this share is as even as eyes can tell.
_EVEN = 0.01
# Where a lens delivers less than this share of its light, the correction is as uncertain as weak texture.
_TRUSTED_LIGHT = 0.9
# However dim, no microimage is trusted over less than this share of the pitch, if it is as large, or than these px:
# nothing would be left to compare.
_LEAST_TRUSTED, _LEAST_RADIUS = 0.3, 1.5

# Interpolation and smoothing read so far beyond [px]. Within this share of the way to a neighbour pixels belong to a
# lens alone, even as coordinates are rounded, and at the third number where a distortion changes the way.
_BEYOND, _UNSHARED, _UNSHARED_BENT = 3.0, 0.4995, 0.49
# Bytes of no more rows than this are summed as such.
_MOST_TOGETHER = 64
# Values in a line of memory; rows of boxes are asked for so many rows ahead.
_LINE, _AHEAD = 16, 2
# Cameras with no more pixels than this keep what corrects them [px].
_MOST_KEPT = 1 << 25
# A pixel made of several at the rim mixes light from beyond it [px].
_MIXED = 0.5
# Lenses that cover less than this share of a flat are made smaller one by one.
_MOST_BOXES = 0.5


@dataclass(frozen=True)
class GrayFlat:
    """Brightness of the flat, vignetting-corrected, 1 at white, with the lens centres in its own pixels.

    Parameters
    ----------
    image : (H, W) float32
        Brightness; pixels of a microimage are corrected for its vignetting.
    centres : (n, 2) float32 [px of `image`]
        Lens centres, in the order of `lattice.centres()`.
    radius : float [px of `image`]
        Radius up to which a microimage is trusted.
    pitch : float [px of `image`]
    lens_type : (n,) int8, optional
        Types of the lenses, where they are focused at different depths.
    """

    image: NDArray[np.float32]
    centres: NDArray[np.float32]
    radius: float
    pitch: float
    lens_type: NDArray[np.int8] | None = None


def correction_table(calibration: Calibration) -> tuple[NDArray[np.float32], float]:
    """Gain that undoes the vignetting, over the squared distance from the lens centre.

    Returns
    -------
    gains : (k,) float32
        Gain at squared radii `0, step, 2*step, ...`.
    step : float [px^2]
    """
    reach = (0.75 * calibration.lattice.pitch) ** 2
    squared = np.linspace(0.0, reach, 512)
    if calibration.vignetting is None:
        return np.ones(len(squared), np.float32), float(squared[1])
    light = calibration.vignetting.at(np.sqrt(squared))
    return (1.0 / np.maximum(light, 1.0 / _MAX_GAIN)).astype(np.float32), float(squared[1])


def has_uneven_lenses(calibration: Calibration) -> bool:
    """Whether lenses differ in their light, so that its radial profile alone would not make a flat even."""
    known = calibration.gain_map
    if known is None:
        return False
    uneven = max(np.abs(known.shading).max(), np.abs(known.level[1:]).max(initial=0.0))
    return bool(known.lens_gain.size or known.cut.size or uneven > _EVEN)


def white_level(flat: NDArray, calibration: Calibration) -> float:
    """Value of the brightest pixel that flats of the camera can have, or pictures drawn from them: 1 for floats."""
    if flat.dtype.kind not in "ui":
        return 1.0
    highest = float(np.iinfo(flat.dtype).max)
    return highest if calibration.white_level is None else min(highest, calibration.white_level)


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _mean_channels(rows, channels, scale, gain, out):
    """Mean over the channels of rows of pixels that lie one after the other, times the `gain` where there is one."""
    height, width = out.shape
    weight = np.float32(scale / channels)
    for y in prange(height):
        row, into = rows[y], out[y]
        # The compiler has vector instructions for steps that it knows.
        if channels == 3:
            for x in range(width):
                into[x] = weight * (np.float32(row[3 * x]) + np.float32(row[3 * x + 1]) + np.float32(row[3 * x + 2]))
        elif channels == 1:
            for x in range(width):
                into[x] = weight * np.float32(row[x])
        else:
            for x in range(width):
                total = np.float32(0.0)
                for k in range(channels):
                    total += np.float32(row[channels * x + k])
                into[x] = total * weight
        if gain.size > 0:
            for x in range(width):
                into[x] *= gain[y, x]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _mean_blocks(rows, channels, factor, scale, gain, like, out):
    """Mean over the channels of `factor` x `factor` pixels each, times the `gain` where there is one.

    Rows are summed as numbers of the type of `like`.
    """
    height, width = out.shape
    together = channels * factor
    weight = np.float32(scale / (together * factor))
    for y in prange(height):
        line = np.empty(width * together, like.dtype)
        for k in range(len(line)):
            line[k] = rows[y * factor, k]
        for v in range(1, factor):
            row = rows[y * factor + v]
            for k in range(len(line)):
                line[k] += row[k]
        into = out[y]
        # As above.
        if together == 6:
            for x in range(width):
                a, b, c = line[6 * x], line[6 * x + 1], line[6 * x + 2]
                into[x] = weight * np.float32(a + b + c + line[6 * x + 3] + line[6 * x + 4] + line[6 * x + 5])
        else:
            for x in range(width):
                total = np.float32(0.0)
                for k in range(x * together, (x + 1) * together):
                    total += np.float32(line[np.uint64(k)])
                into[x] = weight * total
        if gain.size > 0:
            for x in range(width):
                into[x] *= gain[y, x]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _correct_lenses(centres, radius, around, share, gains, step, image):
    """Multiply pixels within `radius` of a lens centre, and nearer to it than to the lenses `around`, by their gain.

    `share` is that of the way to a neighbour that belongs to a lens, below one half: no two may share a pixel.
    """
    height, width = image.shape
    last = np.int32(len(gains) - 1)
    inverse = np.float32(1 / step)
    # Whole numbers are slow to convert inside a vector loop.
    steps = np.arange(2 * int(radius) + 3).astype(np.float32)
    # A lens has the pixels left or right of each half-way line x = room + tilt * y to a neighbour.
    room, tilt = np.empty(len(around), np.float32), np.empty(len(around), np.float32)
    for n in range(len(around)):
        # Lines along x are tilted by a thousandth of a pixel at most.
        ex = around[n, 0] if abs(around[n, 0]) > 1e-4 else np.float32(1e-4)
        room[n] = share * (square(around[n, 0]) + square(around[n, 1])) / ex
        tilt[n] = -around[n, 1] / ex
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0], centres[lens, 1]
        for y in range(max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1):
            dy = np.float32(y) - cy
            dy2 = dy * dy
            high = np.sqrt(max(np.float32(0.0), radius * radius - dy2))
            low = -high
            for n in range(len(around)):
                if around[n, 0] > -1e-4:
                    high = min(high, room[n] + tilt[n] * dy)
                else:
                    low = max(low, room[n] + tilt[n] * dy)
            left, right = max(0, int(np.ceil(cx + low))), min(width - 1, int(np.floor(cx + high)))
            if left > right:
                continue
            row = image[y, left : right + 1]
            first = np.float32(left) - cx
            for k in range(len(row)):
                dx = first + steps[k]
                row[k] *= gains[min(np.int32((dx * dx + dy2) * inverse), last)]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _fill_unlit(centres, radius, light, image):
    """Give pixels whose `light` is NaN the mean of the others within `radius` of their lens.

    Left dark, where microimages are cut would look like texture that moves with the lens.
    """
    height, width = image.shape
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0], centres[lens, 1]
        top, bottom = max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius)))
        left, right = max(0, int(np.ceil(cx - radius))), min(width - 1, int(np.floor(cx + radius)))
        total = 0.0
        lit = unlit = 0
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                if square(x - cx) + square(y - cy) > radius * radius:
                    continue
                if np.isnan(light[y, x]):
                    unlit += 1
                else:
                    total += image[y, x]
                    lit += 1
        if lit == 0 or unlit == 0:
            continue
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                if square(x - cx) + square(y - cy) <= radius * radius and np.isnan(light[y, x]):
                    image[y, x] = total / lit


def make_gray_flat(
    flat: NDArray, calibration: Calibration, factor: int = 1, light: NDArray[np.float32] | None = None
) -> GrayFlat:
    """Brightness of `flat` (H, W, C), corrected for vignetting where microimages are trusted, and a little beyond.

    Each pixel is the mean of `factor` x `factor` of the flat. `light` is the gain of its pixels where the flat is part
    of a larger one, to which the gain map of the camera belongs.
    """
    lattice = downsample_lattice(calibration.lattice, factor)
    image = allocate_pooled(lattice.image_size[::-1], np.float32)
    rows = np.ascontiguousarray(flat).reshape(len(flat), -1)
    radius = trusted_radius(calibration)
    uneven = has_uneven_lenses(calibration)
    gain = np.empty((0, 0), np.float32)
    if calibration.vignetting is not None and not uneven:
        gain = _remembered_if_small(calibration, ("gain", factor), lambda: _gain_image(calibration, lattice, factor))
    if factor == 1:
        _mean_channels(rows, flat.shape[2], 1.0 / white_level(flat, calibration), gain, image)
    else:
        # Sums of so few bytes fit into two.
        short = rows.dtype == np.uint8 and factor <= _MOST_TOGETHER
        like = np.empty(0, np.uint16 if short else np.float32)
        _mean_blocks(rows, flat.shape[2], factor, 1.0 / white_level(flat, calibration), gain, like, image)
        radius = radius / factor - _MIXED
    centres = lattice.centres().astype(np.float32)
    if uneven:
        if light is None:
            light = _remembered_if_small(calibration, ("light", factor), lambda: _blocks(calibration.gain(), factor))
        else:
            light = _blocks(light, factor)
        np.divide(image, light, out=image, where=np.isfinite(light))
        # Microimages of this radius share no pixel.
        apart = np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min() / 2
        _fill_unlit(centres, np.float32(min(radius + _BEYOND, apart)), light, image)
    types = calibration.lens_types
    kinds = None if types is None else types.of(calibration.lattice.indices())
    return GrayFlat(image, centres, radius, lattice.pitch, kinds)


def downsample_lattice(lattice: Lattice, factor: int) -> Lattice:
    """The lattice of a flat of which `factor` x `factor` pixels each have become one, the same object every time."""
    return (
        lattice if factor == 1 else cached(lattice, ("downsample_lattice", factor), lambda: lattice.downscaled(factor))
    )


def _remembered_if_small(
    calibration: Calibration, key: tuple[str, int], make: Callable[[], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """An image as large as the flat, kept with the camera unless that takes much memory."""
    width, height = calibration.image_size
    return cached(calibration, key, make) if width * height <= _MOST_KEPT else make()


def _gain_image(calibration: Calibration, lattice: Lattice, factor: int) -> NDArray[np.float32]:
    """(H, W) gain of every pixel of the flat as it is analysed, 1 where no microimage is trusted."""
    image = np.ones(lattice.image_size[::-1], np.float32)
    radius = trusted_radius(calibration)
    radius = radius if factor == 1 else radius / factor - _MIXED
    gains, step = correction_table(calibration)
    around = lattice.steps @ lattice.basis
    share = _UNSHARED if lattice.distortion is None else _UNSHARED_BENT
    _correct_lenses(
        lattice.centres().astype(np.float32), np.float32(radius + _BEYOND), around.astype(np.float32),
        np.float32(share), gains, step / factor**2, image,
    )  # fmt: skip
    return image


def _blocks(light: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over `factor` x `factor` pixels, NaN where one of them is."""
    height, width = (n // factor for n in light.shape)
    whole = light[: height * factor, : width * factor]
    return np.ascontiguousarray(whole.reshape(height, factor, width, factor).mean((1, 3)))


def trusted_radius(calibration: Calibration) -> float:
    """Radius [px] inside which microimages can be compared: off the rim, and where shading needs little correction."""
    lattice = calibration.lattice
    # Interpolation reads one pixel further.
    radius = max(lattice.radius - 1.0, _LEAST_RADIUS)
    if calibration.vignetting is not None:
        distance = np.arange(0.0, lattice.radius, 0.25)
        dim = distance[calibration.vignetting.at(distance) < _TRUSTED_LIGHT]
        if dim.size:
            radius = min(radius, max(float(dim[0]), _LEAST_TRUSTED * lattice.pitch))
    return radius


@njit(cache=True, nogil=True, error_model="numpy")
def _shrink_row(image, top, first, factor, line, into):
    """Means of `factor` x `factor` pixels each, from row `top` and column `first` on; `line` is memory to work in."""
    for k in range(len(line)):
        line[k] = image[top, first + k]
    for r in range(top + 1, top + factor):
        row = image[r, first : first + len(line)]
        for k in range(len(line)):
            line[k] += row[k]
    weight = np.float32(1 / factor**2)
    # The compiler has vector instructions for steps that it knows.
    if factor == 2:
        for u in range(np.uint64(len(into))):
            into[u] = weight * (line[2 * u] + line[2 * u + 1])
    elif factor == 3:
        for u in range(np.uint64(len(into))):
            into[u] = weight * (line[3 * u] + line[3 * u + 1] + line[3 * u + 2])
    else:
        for u in range(len(into)):
            total = np.float32(0.0)
            for k in range(u * factor, (u + 1) * factor):
                total += line[np.uint64(k)]
            into[u] = weight * total


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _shrink_boxes(image, centres, half, factor, out):
    """Fill the pixels of `out` no farther than `half` from a centre, each way: means of `factor` x `factor` others."""
    height, width = out.shape
    pixels, down = image.reshape(-1), image.shape[1]
    for lens in prange(len(centres)):
        x, y = int(np.rint(centres[lens, 0])), int(np.rint(centres[lens, 1]))
        left, right = max(0, x - half), min(width - 1, x + half)
        columns = max(right + 1 - left, 0)
        line = np.empty(columns * factor, np.float32)
        for v in range(max(0, y - half), min(height - 1, y + half) + 1):
            # Rows of a box lie too far apart for the processor to guess which is read next.
            for r in range((v + _AHEAD) * factor, (v + _AHEAD + 1) * factor):
                for k in range(0, len(line) + _LINE, _LINE):
                    prefetch(pixels, np.uint64(r * down + left * factor + k))
            _shrink_row(image, v * factor, left * factor, factor, line, out[v, left : left + columns])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _shrink_all(image, factor, out):
    for v in prange(len(out)):
        _shrink_row(image, v * factor, 0, factor, np.empty(out.shape[1] * factor, np.float32), out[v])


def downsample(gray: GrayFlat, factor: int, wanted: NDArray[np.bool_] | None = None) -> GrayFlat:
    """`gray` at a whole fraction of its resolution: each pixel is the mean of `factor` x `factor`.

    Only pixels about the lenses `wanted` (n,), all by default, need be set.
    """
    if factor == 1:
        return gray
    centres = gray.centres if wanted is None else gray.centres[wanted]
    if len(centres) * gray.pitch**2 > _MOST_BOXES * gray.image.size:
        return cached(gray, ("downsample_lattice", factor), lambda: _shrunk_flat(gray, factor))
    height, width = (n // factor for n in gray.image.shape)
    small = _of_blocks(gray, factor, allocate_pooled((height, width), np.float32))
    middle = small.centres if wanted is None else small.centres[wanted]
    _shrink_boxes(gray.image, middle, int(np.ceil(small.radius + _BEYOND)), factor, small.image)
    return small


def _shrunk_flat(gray: GrayFlat, factor: int) -> GrayFlat:
    height, width = (n // factor for n in gray.image.shape)
    image = np.empty((height, width), np.float32)
    _shrink_all(gray.image, factor, image)
    return _of_blocks(gray, factor, image)


def _of_blocks(gray: GrayFlat, factor: int, image: NDArray[np.float32]) -> GrayFlat:
    centres = ((gray.centres + 0.5) / factor - 0.5).astype(np.float32)
    return GrayFlat(image, centres, gray.radius / factor - _MIXED, gray.pitch / factor, gray.lens_type)
