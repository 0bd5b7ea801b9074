"""Measure the blur of the microlenses of a flat, by the structure function of its brightness.

In a sharp picture with edges of all sizes the mean square difference of two places grows as `1 - exp(-distance /
grain)`, linearly at first; blur makes it start quadratically. Width of the blur and grain of the scene are fitted to
it. A scene that is smooth itself looks blurred; it has nothing that could alias either.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import kernel

from .gray_flat import trusted_radius
from .settings import BLUR, LensBlurSettings

__all__ = ["measure_lens_blur"]


def measure_lens_blur(
    pixels: NDArray | Callable[[tuple[int, int, int, int]], NDArray],
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    settings: LensBlurSettings = BLUR,
) -> float:
    """Width over which the microlenses average the scene, as a share of the patch size.

    Parameters
    ----------
    pixels : (H, W, C) array, or function
        The latter returns the part `left, top, right, bottom` of them.
    calibration : Calibration
    patch_size : (n,) float32 [px]
        Of all lenses, NaN where unresolved.
    settings : LensBlurSettings

    Returns
    -------
    float
        Side of the square that blurs as much, over `|s|`; 0 if it cannot be measured.
    """
    lenses = np.flatnonzero(np.abs(np.nan_to_num(patch_size)) > 1)
    radius = trusted_radius(calibration)
    lags = np.array([lag for lag in settings.lags if lag <= radius])
    if len(lags) < settings.least_lags or not len(lenses):
        return 0.0
    read = pixels if callable(pixels) else lambda part: pixels[part[1] : part[3], part[0] : part[2]]
    types = calibration.lens_types
    kinds = np.zeros(len(lenses), int) if types is None else types.of(calibration.lattice.indices()[lenses])
    # The sharpest type dominates where it is in focus, and must not alias.
    return min(
        _measure_type(read, calibration, patch_size, lenses[kinds == kind], radius, lags, settings)
        for kind in np.unique(kinds)
    )


def _measure_type(
    read: Callable[[tuple[int, int, int, int]], NDArray],
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    lenses: NDArray[np.int64],
    radius: float,
    lags: NDArray[np.int64],
    settings: LensBlurSettings,
) -> float:
    """`measure_lens_blur` of the lenses of one type: the mean over ranges of depth, weighted by their contrast."""
    lenses = lenses[:: max(1, len(lenses) // settings.lenses)]
    lenses = lenses[np.argsort(np.abs(patch_size[lenses]), kind="stable")]
    found = np.zeros((len(lenses), len(lags)))
    size = np.array(calibration.image_size)
    for number, centre in enumerate(calibration.lattice.centres()[lenses]):
        low, high = np.floor(centre - radius).astype(int) - 1, np.ceil(centre + radius).astype(int) + 2
        low, high = np.maximum(low, 0), np.minimum(high, size)
        part = np.ascontiguousarray(read((*low.tolist(), *high.tolist())))
        _mean_square_differences(part, (centre - low)[None], radius, lags, found[number : number + 1])
    widths, models = _make_models(lags, settings)
    total = weight = 0.0
    for part in np.array_split(np.arange(len(lenses)), min(settings.depth_ranges, len(lenses))):
        grown = found[part].sum(0)
        if not (grown > 0).all():
            continue
        misfit = np.log(models) - np.log(grown)
        spread = misfit.var(-1)
        width = widths[np.unravel_index(np.argmin(spread), spread.shape)[0]]
        # Minus the width of a pixel, which averages in any case; rendering accounts for that.
        total += grown[-1] * (width**2 - 1) / float(np.median(np.abs(patch_size[lenses[part]]))) ** 2
        weight += grown[-1]
    return float(np.sqrt(total / weight)) if weight > 0 else 0.0


def _make_models(
    lags: NDArray[np.int64], settings: LensBlurSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Widths [px], and (widths, grains, lags) mean square differences of edges of one grain, averaged over a width."""
    widths = np.geomspace(*settings.widths)
    width, grain = widths[:, None, None], np.geomspace(*settings.grains)[:, None]

    def integrate_twice(x: NDArray[np.float64]) -> NDArray[np.float64]:
        # Of 1 - exp(-|x| / grain); the second difference is its mean over pairs of places of a width.
        return x * x / 2 - grain * np.abs(x) - grain**2 * np.exp(-np.abs(x) / grain)

    def average(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return (integrate_twice(x + width) - 2 * integrate_twice(x) + integrate_twice(x - width)) / width**2

    return widths, average(lags.astype(np.float64)) - average(np.zeros(1))


@kernel(share=lambda flat, centres, *_: len(centres), fastmath=FAST)
def _mean_square_differences(begin, end, flat, centres, radius, lags, out):
    """Mean square difference along rows and columns at each of the `lags`, within a circle in each microimage."""
    height, width, channels = flat.shape
    for lens in range(begin, end):
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
