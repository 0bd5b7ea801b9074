"""The noise variance of the pixels of a flat, estimated from the smoothest microimages.

Second differences along both axes cancel light that changes evenly, and leave the noise (Immerkaer
1996). Of the brighter half of the microimages, those with the least second differences show the
least of the specimen; dark microimages would show the read-out noise only. Photon noise is in
proportion to light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfcal import Calibration
from lfcal.runtime.arrays import Singles

__all__ = ["measure_variance"]

# Share of the brighter half of the microimages that is taken as free of structure.
_SMOOTH = 0.1
# The variance is constant below this share of the mean light of the brighter half, where read-out
# noise dominates.
_DARK = 0.01
# The sum of the squared weights (1, -2, 1) of both second differences.
_WEIGHTS = 6**2


def measure_variance(flat: Singles, calibration: Calibration) -> Callable[[Singles], Singles]:
    """A function from values of a linear flat (h, w) to the noise variance of such pixels."""
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
