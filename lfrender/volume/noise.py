"""The variance of the pixels of a flat: photon noise, in proportion to light, measured where the
flat is smoothest.

Second differences along both axes leave noise alone where light changes evenly (Immerkaer 1996). Of
the brighter half of the microimages, those that have the least show the least of the specimen; dark
ones would show read-out alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfcal import Calibration
from lfcal.runtime.arrays import Singles

__all__ = ["measure_variance"]

# Of the brighter half of the microimages, the share that is taken for smooth.
_SMOOTH = 0.1
# Below this share of the mean of the brighter half, read-out hides how noise depends on light.
_DARK = 0.01
# The sum of the squared weights of both second differences.
_WEIGHTS = 6**2


def measure_variance(flat: Singles, calibration: Calibration) -> Callable[[Singles], Singles]:
    """A function from values of a linear flat (h, w) to the variance of pixels that have them."""
    lattice = calibration.lattice
    half = int(np.clip((lattice.pitch / 2 - 1) / np.sqrt(2), 2, 5))
    centres = np.rint(lattice.centres()).astype(int)
    inside = ((centres >= half) & (centres < np.array(lattice.image_size) - half)).all(1)
    x, y = centres[inside].T[:, :, None, None]
    step = np.arange(-half, half + 1)
    boxes = flat[y + step[:, None], x + step]
    mean = boxes.mean((1, 2), dtype=np.float64)
    rough = np.diff(np.diff(boxes, 2, 1), 2, 2)
    change = (rough**2).mean((1, 2), dtype=np.float64) / _WEIGHTS
    bright = mean >= max(float(np.median(mean)), 1e-12) if len(mean) else np.zeros(0, bool)
    if not bright.any():
        return lambda values: np.full_like(values, 1e-12)
    per_light = np.float32(max(np.quantile(change[bright] / mean[bright], _SMOOTH), 1e-12))
    dark = np.float32(_DARK * mean[bright].mean())

    def variance(values: Singles) -> Singles:
        return per_light * np.maximum(values, dark)

    return variance
