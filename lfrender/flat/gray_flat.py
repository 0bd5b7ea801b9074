"""Gray flat: brightness of a flat, corrected for vignetting, which matching and rendering read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.kernels import FAST, kernel, square
from lfcal.runtime.light.tone import is_encoded

from .microimages import row_of_disc

__all__ = [
    "GrayFlat",
    "correction_cell",
    "correction_tables",
    "grey_light",
    "has_uneven_lenses",
    "make_gray_flat",
    "trusted_radius",
    "white_level",
]

# More would amplify noise at the rim of a microimage rather than the picture.
_LARGEST_GAIN = 4.0
# Pixels of a small image at the rim of a microimage that average pixels from beyond it [px of the
# small image].
_MIXED = 0.5


@dataclass(frozen=True)
class GrayFlat:
    """Brightness of a flat, corrected for vignetting, 1 at white; all in its own pixels."""

    image: NDArray[np.float32]  # (H, W)
    centres: NDArray[np.float32]  # (n, 2) in the order of `lattice.centres()`
    radius: float  # up to which a microimage is trusted
    pitch: float
    lens_type: NDArray[np.int8] | None = None  # (n,) if lenses are focused at different depths
    rounding: float = 0.0  # standard deviation that rounding to integers leaves at least

    def downsampled(self, factor: int) -> GrayFlat:
        """The flat at a whole fraction of its resolution: each pixel is the mean of `factor` x
        `factor`.
        """
        if factor == 1:
            return self
        import cv2

        height, width = (n // factor for n in self.image.shape)
        whole = self.image[: height * factor, : width * factor]
        image = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        return GrayFlat(
            np.asarray(image, np.float32),
            ((self.centres + 0.5) / factor - 0.5).astype(np.float32),
            self.radius / factor - _MIXED,
            self.pitch / factor,
            self.lens_type,
            self.rounding / factor,
        )


def correction_tables(calibration: Calibration) -> tuple[NDArray[np.float32], float]:
    """Factors (t, k), for each type of lens if known, that undo the vignetting at squared distances
    `0, step, 2 * step`
    ... from the centre of a lens, and that step [px^2]."""
    # To the corners between square microimages.
    squared = np.linspace(0.0, (0.75 * calibration.lattice.pitch) ** 2, 512)
    if calibration.vignetting is None:
        return np.ones((1, len(squared)), np.float32), float(squared[1])
    radii = np.sqrt(squared)
    light = calibration.vignetting.at(radii)[None]
    gain = calibration.gain_map
    if gain is not None and gain.type_light.size:
        light = light * np.array(
            [np.interp(radii / gain.step, np.arange(len(one)), one) for one in gain.type_light]
        )
    return (1.0 / np.maximum(light, 1.0 / _LARGEST_GAIN)).astype(np.float32), float(squared[1])


def correction_cell(calibration: Calibration) -> NDArray[np.int8]:
    """(m, m) which of `correction_tables` is that of lens `(i, j)`: `cell[i % m, j % m]`."""
    gain = calibration.gain_map
    # Writable in any case: for read-only arrays, kernels are compiled anew.
    return (
        np.zeros((1, 1), np.int8)
        if gain is None or not gain.type_cell.size
        else gain.type_cell.copy()
    )


def has_uneven_lenses(calibration: Calibration, types: bool = False) -> bool:
    """Whether lenses differ in their light by more than one per cent, or with `types` by the type
    of lens.
    """
    known = calibration.gain_map
    if known is None:
        return False
    uneven = max(np.abs(known.shading).max(), np.abs(known.level[1:]).max(initial=0.0))
    typed = types and known.type_light.size > 0
    return bool(known.lens_gain.size or known.cut.size or uneven > 0.01 or typed)


def white_level(flat: NDArray, calibration: Calibration) -> float:
    """Value of the brightest pixel that flats of the camera, or pictures of them, can have; 1 for
    floats, less if dim.
    """
    if flat.dtype.kind not in "ui":
        return min(1.0, calibration.white_level or 1.0)
    highest = float(np.iinfo(flat.dtype).max)
    return highest if calibration.white_level is None else min(highest, calibration.white_level)


@kernel(share=lambda rows, channels, factor, scale, gain, out: len(out), fastmath=FAST)
def _average_channels(begin, end, rows, channels, factor, scale, gain, out):
    """Mean over the channels of interleaved pixels and blocks of `factor` x `factor` of them, times
    `scale` and, unless that is empty, `gain` (h, w).
    """
    width = out.shape[1]
    together = channels * factor
    weight = np.float32(scale / (together * factor))
    line = np.empty(width * together, np.float32)
    for y in range(begin, end):
        into = out[y]
        for k in range(len(line)):
            line[k] = rows[y * factor, k]
        for v in range(1, factor):
            row = rows[y * factor + v]
            for k in range(len(line)):
                line[k] += row[k]
        # The compiler uses vector instructions for strides it knows.
        if together == 3:
            for x in range(width):
                into[x] = weight * (line[3 * x] + line[3 * x + 1] + line[3 * x + 2])
        else:
            for x in range(width):
                total = np.float32(0.0)
                for k in range(x * together, (x + 1) * together):
                    total += line[np.uint64(k)]
                into[x] = weight * total
        if gain.size > 0:
            for x in range(width):
                into[x] *= gain[y, x]


@kernel(share=lambda centres, *_: len(centres), fastmath=FAST)
def _fill_gains(begin, end, centres, tables, radius, gains, per_step, image):
    """Set the pixels within `radius` of a lens centre to their gain, from row `tables` (n,) of
    `gains` (t, k).
    """
    height, width = image.shape
    last = gains.shape[1] - 1
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        for y in range(
            max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1
        ):
            left, count = row_of_disc(np.float32(y) - cy, cx, radius, 0, width - 1)
            for x in range(left, left + count):
                away = square(x - cx) + square(y - cy)
                image[y, x] = gains[tables[lens], min(int(away * per_step), last)]


@kernel(share=lambda centres, *_: len(centres), fastmath=FAST)
def _fill_unlit(begin, end, centres, radius, light, image):
    """Replace pixels whose `light` is NaN by the mean of the others of their lens: dark, they would
    match like texture.
    """
    height, width = image.shape
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        top = max(0, int(np.ceil(cy - radius)))
        bottom = min(height - 1, int(np.floor(cy + radius)))
        left = max(0, int(np.ceil(cx - radius)))
        right = min(width - 1, int(np.floor(cx + radius)))
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
    flat: NDArray,
    calibration: Calibration,
    factor: int = 1,
    light: NDArray[np.float32] | None = None,
) -> GrayFlat:
    """Brightness of `flat` (H, W, C), corrected for vignetting, the mean of `factor` x `factor`
    pixels each.

    `light` (H, W) is the gain of its pixels; needed if the flat is part of a larger one.
    """
    lattice = calibration.lattice.downscaled(factor)
    image = np.empty(lattice.image_size[::-1], np.float32)
    rows = np.ascontiguousarray(flat).reshape(len(flat), -1)
    radius = trusted_radius(calibration)
    uneven = has_uneven_lenses(calibration)
    gain = np.empty((0, 0), np.float32)
    if calibration.vignetting is not None and not uneven:
        gain = calibration.derived(_correction_image, factor)
    _average_channels(
        rows, flat.shape[2], factor, 1.0 / white_level(flat, calibration), gain, image
    )
    if factor > 1:
        radius = radius / factor - _MIXED
    centres = lattice.centres().astype(np.float32)
    if uneven:
        gain = _uneven_light(calibration, factor, light)
        np.divide(image, gain, out=image, where=np.isfinite(gain))
        _fill_unlit(centres, _own_radius(lattice, radius), gain, image)
    types = calibration.lens_types
    lens_type = None if types is None else types.of(calibration.lattice.indices())
    rounding = (
        12**-0.5 / (factor * white_level(flat, calibration)) if flat.dtype.kind in "ui" else 0.0
    )
    return GrayFlat(image, centres, radius, lattice.pitch, lens_type, rounding)


def _own_radius(lattice: Lattice, radius: float) -> np.float32:
    """A trusted radius and three pixels, which interpolation and smoothing read, as far as no
    lenses share a pixel.
    """
    apart = float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min()) / 2
    # A distortion changes that distance.
    return np.float32(min(radius + 3.0, apart if lattice.distortion is None else 0.98 * apart))


def _correction_image(calibration: Calibration, factor: int) -> NDArray[np.float32]:
    """(H, W) correction of every pixel of the downsampled flat, 1 beyond trusted microimages."""
    lattice = calibration.lattice.downscaled(factor)
    image = np.ones(lattice.image_size[::-1], np.float32)
    radius = trusted_radius(calibration)
    radius = radius if factor == 1 else radius / factor - _MIXED
    gains, step = correction_tables(calibration)
    cell = correction_cell(calibration)
    i, j = lattice.indices().T % len(cell)
    centres = lattice.centres().astype(np.float32)
    per_step = np.float32(factor**2 / step)
    _fill_gains(centres, cell[i, j], _own_radius(lattice, radius), gains, per_step, image)
    return image


def _uneven_light(
    calibration: Calibration, factor: int, part: NDArray[np.float32] | None
) -> NDArray[np.float32]:
    """(h, w) light of blocks of `factor` x `factor` pixels, of a `part` or of the whole flat."""
    if part is not None:
        return _average_light(part, factor)
    return calibration.derived(_whole_light, factor)


def _whole_light(calibration: Calibration, factor: int) -> NDArray[np.float32]:
    return _average_light(calibration.gain(), factor)


def _average_light(light: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over `factor` x `factor` pixels, NaN if one of them is."""
    height, width = (n // factor for n in light.shape)
    whole = light[: height * factor, : width * factor]
    return np.ascontiguousarray(whole.reshape(height, factor, width, factor).mean((1, 3)))


def grey_light(pixels: NDArray, calibration: Calibration) -> NDArray[np.float32]:
    """(...) mean light over the channels of pixels (..., C), with white as one."""
    white = np.float32(white_level(pixels, calibration))
    encoded = is_encoded(pixels.dtype, calibration.encoded)
    channels = pixels.shape[-1]
    total = np.zeros(pixels.shape[:-1], np.float32)
    # NumPy takes six times as long for means over an axis as short as that of the channels.
    for channel in range(channels):
        light = pixels[..., channel] / white
        if encoded:
            light *= light
        total += light.astype(np.float32, copy=False)
    return total / np.float32(channels)


def trusted_radius(calibration: Calibration) -> float:
    """Radius [px] within which microimages can be compared: off the rim, with the light of the
    middle up to a tenth; at least 0.3 D.

    With less light, the correction of the vignetting is as uncertain as weak texture is strong.
    More light than in the middle is that of neighbours.
    """
    lattice = calibration.lattice
    # Interpolation reads one pixel further.
    radius = max(lattice.radius - 1.0, 1.5)
    if calibration.vignetting is not None:
        least = 0.3 * lattice.pitch
        distance = np.arange(0.0, lattice.radius, 0.25)
        uneven = np.abs(calibration.vignetting.at(distance) - 1) > 0.1
        # In the middle, rings have few pixels.
        uneven &= distance > least - 0.25
        if uneven.any():
            radius = min(radius, max(float(distance[uneven.argmax()]), least))
    return radius
