"""How sharp a flat is: what interpolation takes from it, and over which width its lenses have averaged already."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.fastmath import FAST, square

from .gray_flat import trusted_radius

__all__ = ["measure_lens_blur"]

# Distances at which brightness is compared [px]: near ones tell blur, far ones the grain of the scene.
_LAGS = np.array([1, 2, 3, 4, 6, 8])
# Lenses that are compared, and parts of their range of depth that are looked at on their own.
_LENSES, _PARTS = 240, 4
# Widths of blur and grains of scenes that are tried [px].
_WIDTHS, _GRAINS = np.geomspace(1.0, 12.0, 36), np.geomspace(0.7, 45.0, 24)
# With fewer distances than this, blur and grain cannot be told apart.
_LEAST_LAGS = 3


def measure_lens_blur(
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
    """`measure_lens_blur` of some lenses: the mean over parts of their range of depth, by their contrast."""
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
