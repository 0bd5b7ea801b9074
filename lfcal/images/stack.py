"""Several flats of one camera: checked and combined into one.

White images are combined by their exposures, scenes by their mean. Flats without contrast, such as
dark or saturated ones, are left out; clipped pixels are taken from other flats.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..runtime.arrays import Array, Singles
from ..runtime.errors import FlatError
from .pixels import check_pixels
from .preprocessing import is_mask
from .read import read_flat

__all__ = [
    "CLIPPED_LIGHT",
    "average_scenes",
    "check_flats",
    "clipping_level",
    "combine_whites",
    "estimate_white_level",
    "measure_overexposure",
    "select_contrasted",
]


# Bits of sensors.
_BITS = (8, 10, 12, 14)
# Contrast or exposure over that of the best flat below which a flat is dark, saturated or blank.
_LEAST_SHARE = 0.05
# Pixels from which exposures are estimated.
_SAMPLE = 200_000
# Pixels of the largest light are clipped if more than a share of 0.002 has 0.995 of it.
CLIPPED_LIGHT = 0.995
_CLIPPED_SHARE = 0.002


def check_flats(image: Any) -> list[Array]:
    """One or several flats, or their paths, as arrays; FlatError if they are of two cameras."""
    given: Any = _read_paths(image)
    several = isinstance(given, (list, tuple)) and len(given) > 0 and np.ndim(given[0]) >= 2
    if not several and np.ndim(given) != 4:
        return [_check_flat(given, "image")]
    if len(given) == 0:
        raise FlatError("no flat is given; give at least one")
    flats = [_check_flat(flat, f"flat {k}") for k, flat in enumerate(given, 1)]
    first, *others = ("{} x {} px".format(*flat.shape[1::-1]) for flat in flats)
    for k, size in enumerate(others, 2):
        if size != first:
            raise FlatError(f"flat {k} is {size}, flat 1 is {first}; give flats of one camera")
    return flats


def _read_paths(image: Any) -> Any:
    if isinstance(image, (str, os.PathLike)):
        return read_flat(image)
    if isinstance(image, (list, tuple)) and any(
        isinstance(one, (str, os.PathLike)) for one in image
    ):
        return [_read_paths(one) for one in image]
    return image


def _check_flat(image: ArrayLike, name: str) -> Array:
    try:
        flat = check_pixels(image)
    except FlatError as error:
        raise FlatError(f"{name}: {error}") from error
    if min(flat.shape[:2]) < 16:
        size = "{} x {} px".format(*flat.shape[1::-1])
        raise FlatError(f"{name} of {size} is too small to be a flat; give the whole sensor")
    return flat


def estimate_white_level(flats: Sequence[Array]) -> float | None:
    """Largest value of a sensor of 8, 10, 12 or 14 bits in flats of 16 bits; None if unknown."""
    if any(flat.dtype.kind not in "ui" or flat.dtype.itemsize == 1 for flat in flats):
        return None
    largest = max(int(flat.max()) for flat in flats)
    return next((float(2**bits - 1) for bits in _BITS if largest < 2**bits), None)


def measure_overexposure(flat: Array) -> float:
    """Share of the pixels at the largest value of their type or of a sensor; 0 for masks."""
    top = 0
    if flat.dtype.kind == "u":
        top = int(flat.max())
    known = (8,) if flat.dtype.itemsize == 1 else (*_BITS[1:], 16)
    if is_mask(flat) or top not in [2**bits - 1 for bits in known]:
        return 0.0
    # Reductions over three values take several times as long as those over one channel at a time.
    channels = np.moveaxis(flat.reshape(*flat.shape[:2], -1), -1, 0)
    return float(np.logical_or.reduce([channel >= top for channel in channels]).mean())


def select_contrasted(lights: Sequence[Singles]) -> list[int]:
    """Indices of the flats that have contrast, among `lights` (h, w) in one scale."""
    contrast = [float(light.std(dtype=np.float64)) for light in lights]
    return [k for k, value in enumerate(contrast) if value >= _LEAST_SHARE * max(contrast)]


def combine_whites(lights: Sequence[Singles]) -> Singles:
    """Weighted least-squares estimate of the light from all white images, by their exposures.

    `lights` (h, w) are linear, with any exposures and black levels; the result has the scale of the
    best exposed one.
    """
    if len(lights) == 1:
        return lights[0]
    levels = [clipping_level(light) for light in lights]
    step = max(1, int(np.sqrt(lights[0].size / _SAMPLE)))
    # An odd step samples every phase of a mosaic.
    few = [light[:: step | 1, :: step | 1].ravel().astype(np.float64) for light in lights]
    unclipped = [sample < top for sample, top in zip(few, levels, strict=True)]
    score = [
        sample.std() * (0.5 + valid.mean()) for sample, valid in zip(few, unclipped, strict=True)
    ]
    best = int(np.argmax(score))
    total = np.zeros(lights[0].shape, np.float32)
    share = np.zeros_like(total)
    for light, top, sample, valid in zip(lights, levels, few, unclipped, strict=True):
        both = valid & unclipped[best]
        if both.sum() < min(1000, both.size // 4):
            continue
        a = few[best][both]
        b = sample[both]
        exposure = float(np.mean((a - a.mean()) * (b - b.mean())) / max(float(a.var()), 1e-30))
        if exposure > _LEAST_SHARE:
            good = light < np.float32(top)
            above_black = light - np.float32(b.mean() - exposure * a.mean())
            total += np.where(good, np.float32(exposure) * above_black, np.float32(0))
            share += np.where(good, np.float32(exposure**2), np.float32(0))
    known = share > 0
    if not known.any():
        return lights[best]
    combined = np.full_like(total, levels[best])
    np.divide(total, share, out=combined, where=known)
    return np.maximum(combined, np.float32(0))


def average_scenes(lights: Sequence[Singles]) -> Singles:
    """(h, w) mean of the lights of scenes, each scaled to mean 1."""
    total = np.zeros(lights[0].shape, np.float32)
    for light in lights:
        total += light / np.float32(max(float(light.mean(dtype=np.float64)), 1e-30) * len(lights))
    return total


def clipping_level(light: Singles) -> float:
    """Least light of clipped pixels in an array of any shape, infinite if none are clipped."""
    top = CLIPPED_LIGHT * float(light.max())
    if float((light >= top).mean()) > _CLIPPED_SHARE:
        return top
    return float("inf")
