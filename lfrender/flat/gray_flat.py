"""Gray flat: brightness of a flat, corrected for vignetting, which matching and rendering read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import kernel

from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached
from .settings import GRAY

__all__ = [
    "GrayFlat", "correction_cell", "correction_tables", "downsample", "downsample_lattice", "has_uneven_lenses",
    "make_gray_flat", "trusted_radius", "white_level",
]  # fmt: skip


@dataclass(frozen=True)
class GrayFlat:
    """Brightness of a flat, corrected for vignetting, 1 at white, with the lens centres in its own pixels.

    Parameters
    ----------
    image : (H, W) float32
        Brightness; corrected for vignetting at the pixels of microimages.
    centres : (n, 2) float32 [px of `image`]
        Lens centres, in the order of `lattice.centres()`.
    radius : float [px of `image`]
        Radius up to which a microimage is trusted.
    pitch : float [px of `image`]
    lens_type : (n,) int8, optional
        Types of the lenses, if they are focused at different depths.
    rounding : float [white]
        Standard deviation that rounding to the integers of the flat leaves at least, 0 for floats.
    """

    image: NDArray[np.float32]
    centres: NDArray[np.float32]
    radius: float
    pitch: float
    lens_type: NDArray[np.int8] | None = None
    rounding: float = 0.0


def correction_tables(calibration: Calibration) -> tuple[NDArray[np.float32], float]:
    """Factors that undo the vignetting, over the squared distance from the lens centre.

    Returns
    -------
    factors : (t, k) float32
        At squared distances `0, step, 2*step, ...`, for each type of lens if the gain map has several profiles.
    step : float [px^2]
    """
    reach = (GRAY.table_reach * calibration.lattice.pitch) ** 2
    squared = np.linspace(0.0, reach, GRAY.table_size)
    if calibration.vignetting is None:
        return np.ones((1, len(squared)), np.float32), float(squared[1])
    radii = np.sqrt(squared)
    light = calibration.vignetting.at(radii)[None]
    gain = calibration.gain_map
    if gain is not None and gain.type_light.size:
        light = light * np.array([np.interp(radii / gain.step, np.arange(len(one)), one) for one in gain.type_light])
    return (1.0 / np.maximum(light, 1.0 / GRAY.largest_gain)).astype(np.float32), float(squared[1])


def correction_cell(calibration: Calibration) -> NDArray[np.int8]:
    """(m, m) which of `correction_tables` is that of lens `(i, j)`: `cell[i % m, j % m]`."""
    gain = calibration.gain_map
    # Writable in any case: for read-only arrays, kernels are compiled anew.
    return np.zeros((1, 1), np.int8) if gain is None or not gain.type_cell.size else gain.type_cell.copy()


def has_uneven_lenses(calibration: Calibration, types: bool = False) -> bool:
    """Whether lenses differ in their light, so that one radial profile would not make a flat even.

    One for each type of lens does not count, unless `types` is set.
    """
    known = calibration.gain_map
    if known is None:
        return False
    uneven = max(np.abs(known.shading).max(), np.abs(known.level[1:]).max(initial=0.0))
    typed = types and known.type_light.size > 0
    return bool(known.lens_gain.size or known.cut.size or uneven > GRAY.uneven or typed)


def white_level(flat: NDArray, calibration: Calibration) -> float:
    """Value of the brightest pixel that flats of the camera, or pictures rendered from them, can have.

    1 for floats, less where they are dim (`match_exposure`).
    """
    if flat.dtype.kind not in "ui":
        return min(1.0, calibration.white_level or 1.0)
    highest = float(np.iinfo(flat.dtype).max)
    return highest if calibration.white_level is None else min(highest, calibration.white_level)


@kernel(share=lambda rows, channels, scale, gain, out: len(out), fastmath=FAST)
def _average_channels(begin, end, rows, channels, scale, gain, out):
    """Mean over the channels of rows of interleaved pixels, times `scale` and, unless that is empty, `gain` (h, w)."""
    width = out.shape[1]
    weight = np.float32(scale / channels)
    for y in range(begin, end):
        row, into = rows[y], out[y]
        # The compiler uses vector instructions for strides it knows.
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


@kernel(share=lambda rows, channels, factor, scale, gain, like, out: len(out), fastmath=FAST)
def _average_blocks(begin, end, rows, channels, factor, scale, gain, like, out):
    """`_average_channels` over blocks of `factor` x `factor` pixels; rows are summed in the type of `like`."""
    width = out.shape[1]
    together = channels * factor
    weight = np.float32(scale / (together * factor))
    for y in range(begin, end):
        line = np.empty(width * together, like.dtype)
        for k in range(len(line)):
            line[k] = rows[y * factor, k]
        for v in range(1, factor):
            row = rows[y * factor + v]
            for k in range(len(line)):
                line[k] += row[k]
        into = out[y]
        # The compiler uses vector instructions for strides it knows.
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


@kernel(share=lambda centres, *_: len(centres), fastmath=FAST)
def _correct_lenses(begin, end, centres, tables, radius, around, share, gains, step, image):
    """Multiply the pixels within `radius` of a lens centre by their gain, from row `tables` (n,) of `gains` (t, k).

    A lens has the pixels nearer to it than `share`, below one half, of the way to each of the lenses `around`: no two
    share a pixel.
    """
    height, width = image.shape
    last = np.int32(gains.shape[1] - 1)
    inverse = np.float32(1 / step)
    # A table of floats: conversion of integers is slow inside a vector loop.
    steps = np.empty(2 * int(radius) + 3, np.float32)
    for k in range(len(steps)):
        steps[k] = k
    # A lens has the pixels left or right of each half-way line x = room + tilt * y to a neighbour.
    room, tilt = np.empty(len(around), np.float32), np.empty(len(around), np.float32)
    for n in range(len(around)):
        # Lines along x are tilted by a thousandth of a pixel at most.
        ex = around[n, 0] if abs(around[n, 0]) > 1e-4 else np.float32(1e-4)
        room[n] = share * (square(around[n, 0]) + square(around[n, 1])) / ex
        tilt[n] = -around[n, 1] / ex
    for lens in range(begin, end):
        cx, cy, gain = centres[lens, 0], centres[lens, 1], gains[tables[lens]]
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
                row[k] *= gain[min(np.int32((dx * dx + dy2) * inverse), last)]


@kernel(share=lambda centres, *_: len(centres), fastmath=FAST)
def _fill_unlit(begin, end, centres, radius, light, image):
    """Replace pixels whose `light` is NaN by the mean of the others within `radius` of their lens.

    Left dark, the cut of microimages would match like texture that moves with the lens.
    """
    height, width = image.shape
    for lens in range(begin, end):
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

    Each pixel is the mean of `factor` x `factor` of the flat. `light` (H, W) is the gain of its pixels; needed if the
    flat is part of a larger one, to which the gain map of the camera belongs.
    """
    lattice = downsample_lattice(calibration.lattice, factor)
    image = allocate_pooled(lattice.image_size[::-1], np.float32)
    rows = np.ascontiguousarray(flat).reshape(len(flat), -1)
    radius = trusted_radius(calibration)
    uneven = has_uneven_lenses(calibration)
    gain = np.empty((0, 0), np.float32)
    if calibration.vignetting is not None and not uneven:
        gain = _cache_if_small(calibration, ("gain", factor), lambda: _correction_image(calibration, lattice, factor))
    if factor == 1:
        _average_channels(rows, flat.shape[2], 1.0 / white_level(flat, calibration), gain, image)
    else:
        short = rows.dtype == np.uint8 and factor <= GRAY.most_byte_rows
        like = np.empty(0, np.uint16 if short else np.float32)
        _average_blocks(rows, flat.shape[2], factor, 1.0 / white_level(flat, calibration), gain, like, image)
        radius = radius / factor - GRAY.mixed
    centres = lattice.centres().astype(np.float32)
    if uneven:
        if light is None:
            light = _cache_if_small(calibration, ("light", factor), lambda: _average_light(calibration.gain(), factor))
        else:
            light = _average_light(light, factor)
        np.divide(image, light, out=image, where=np.isfinite(light))
        # Microimages of this radius share no pixel.
        apart = np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min() / 2
        _fill_unlit(centres, np.float32(min(radius + GRAY.margin, apart)), light, image)
    types = calibration.lens_types
    lens_type = None if types is None else types.of(calibration.lattice.indices())
    rounding = GRAY.rounding / (factor * white_level(flat, calibration)) if flat.dtype.kind in "ui" else 0.0
    return GrayFlat(image, centres, radius, lattice.pitch, lens_type, rounding)


def downsample_lattice(lattice: Lattice, factor: int) -> Lattice:
    """The lattice of a flat whose blocks of `factor` x `factor` pixels have become one; the same object every time."""
    return lattice if factor == 1 else cached(lattice, ("downsampled", factor), lambda: lattice.downscaled(factor))


def _cache_if_small(
    calibration: Calibration, key: tuple[str, int], make: Callable[[], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """An image as large as the flat, kept with the calibration unless that takes much memory."""
    width, height = calibration.image_size
    return cached(calibration, key, make) if width * height <= GRAY.most_cached else make()


def _correction_image(calibration: Calibration, lattice: Lattice, factor: int) -> NDArray[np.float32]:
    """(H, W) correction of every pixel of the downsampled flat, 1 where no microimage is trusted."""
    image = np.ones(lattice.image_size[::-1], np.float32)
    radius = trusted_radius(calibration)
    radius = radius if factor == 1 else radius / factor - GRAY.mixed
    gains, step = correction_tables(calibration)
    cell = correction_cell(calibration)
    i, j = lattice.indices().T % len(cell)
    around = lattice.steps @ lattice.basis
    share = GRAY.own_share if lattice.distortion is None else GRAY.own_share_distorted
    _correct_lenses(
        lattice.centres().astype(np.float32), cell[i, j], np.float32(radius + GRAY.margin), around.astype(np.float32),
        np.float32(share), gains, step / factor**2, image,
    )  # fmt: skip
    return image


def _average_light(light: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over `factor` x `factor` pixels, NaN if one of them is."""
    height, width = (n // factor for n in light.shape)
    whole = light[: height * factor, : width * factor]
    return np.ascontiguousarray(whole.reshape(height, factor, width, factor).mean((1, 3)))


def trusted_radius(calibration: Calibration) -> float:
    """Radius [px] within which microimages can be compared: off the rim, and with little vignetting."""
    lattice = calibration.lattice
    # Interpolation reads one pixel further.
    radius = max(lattice.radius - 1.0, GRAY.least_radius)
    if calibration.vignetting is not None:
        distance = np.arange(0.0, lattice.radius, 0.25)
        dim = distance[calibration.vignetting.at(distance) < GRAY.trusted_light]
        if dim.size:
            radius = min(radius, max(float(dim[0]), GRAY.least_trusted * lattice.pitch))
    return radius


@njit(error_model="numpy")
def _downsample_row(image, top, first, factor, line, into):
    """Means of blocks of `factor` x `factor` pixels, from row `top` and column `first` on; `line` is working memory."""
    for k in range(len(line)):
        line[k] = image[top, first + k]
    for r in range(top + 1, top + factor):
        row = image[r, first : first + len(line)]
        for k in range(len(line)):
            line[k] += row[k]
    weight = np.float32(1 / factor**2)
    # The compiler uses vector instructions for strides it knows.
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


@kernel(share=lambda image, centres, *_: len(centres), error_model="numpy")
def _downsample_boxes(begin, end, image, centres, half, factor, out):
    """Fill the pixels of `out` no farther than `half` from a centre, each way."""
    height, width = out.shape
    for lens in range(begin, end):
        x, y = int(np.rint(centres[lens, 0])), int(np.rint(centres[lens, 1]))
        left, right = max(0, x - half), min(width - 1, x + half)
        columns = max(right + 1 - left, 0)
        line = np.empty(columns * factor, np.float32)
        for v in range(max(0, y - half), min(height - 1, y + half) + 1):
            _downsample_row(image, v * factor, left * factor, factor, line, out[v, left : left + columns])


@kernel(share=lambda image, factor, out: len(out), error_model="numpy")
def _downsample_all(begin, end, image, factor, out):
    for v in range(begin, end):
        _downsample_row(image, v * factor, 0, factor, np.empty(out.shape[1] * factor, np.float32), out[v])


def downsample(gray: GrayFlat, factor: int, wanted: NDArray[np.bool_] | None = None) -> GrayFlat:
    """`gray` at a whole fraction of its resolution: each pixel is the mean of `factor` x `factor`.

    Only pixels about the lenses `wanted` (n,), all by default, are sure to be set.
    """
    if factor == 1:
        return gray
    shape = gray.image.shape[0] // factor, gray.image.shape[1] // factor

    def describe(image: NDArray[np.float32]) -> GrayFlat:
        centres = ((gray.centres + 0.5) / factor - 0.5).astype(np.float32)
        radius, pitch = gray.radius / factor - GRAY.mixed, gray.pitch / factor
        return GrayFlat(image, centres, radius, pitch, gray.lens_type, gray.rounding / factor)

    def make() -> GrayFlat:
        image = np.empty(shape, np.float32)
        _downsample_all(gray.image, factor, image)
        return describe(image)

    count = len(gray.centres) if wanted is None else int(np.count_nonzero(wanted))
    if count * gray.pitch**2 > GRAY.most_boxes * gray.image.size:
        return cached(gray, ("downsampled", factor), make)
    small = describe(allocate_pooled(shape, np.float32))
    middle = small.centres if wanted is None else small.centres[wanted]
    _downsample_boxes(gray.image, middle, int(np.ceil(small.radius + GRAY.margin)), factor, small.image)
    return small
