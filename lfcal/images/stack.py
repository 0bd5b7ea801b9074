"""Several flats of one camera as one: white images add up, frames of scenes share what their lenses have in common.

Frames that show next to nothing, such as dark or saturated ones, are left out; clipped pixels are taken from others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["average_scenes", "clipping_level", "combine_whites", "select_contrasted"]

# A flat with less than this share of the contrast of the best one is dark, saturated or blank.
_TELLING = 0.05
# Pixels this near to the brightest one are clipped where so large a share of the flat is.
_AT_TOP, _CLIPPED = 0.995, 0.002
# About so many pixels say how much light one flat has against another.
_SAMPLES = 200_000
_FEWEST = 1000


def select_contrasted(lights: Sequence[NDArray[np.float32]]) -> list[int]:
    """Indices of the flats that have contrast, of `lights` (h, w) in one scale."""
    contrast = [float(light.std(dtype=np.float64)) for light in lights]
    return [k for k, value in enumerate(contrast) if value >= _TELLING * max(contrast)]


def combine_whites(lights: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Light of all white images together, each weighted as its exposure asks.

    Parameters
    ----------
    lights : sequence of (h, w) float32
        Linear light; exposures and black levels may differ.

    Returns
    -------
    (h, w) float32
        In the scale of the best exposed one.
    """
    if len(lights) == 1:
        return lights[0]
    tops = [clipping_level(light) for light in lights]
    step = max(1, int(np.sqrt(lights[0].size / _SAMPLES)))
    # Odd steps, so that both rows and columns of a mosaic have their say.
    few = [light[:: step | 1, :: step | 1].ravel().astype(np.float64) for light in lights]
    open_ = [sample < top for sample, top in zip(few, tops, strict=True)]
    best = max(range(len(lights)), key=lambda k: float(few[k].std()) * (0.5 + float(open_[k].mean())))
    total = np.zeros(lights[0].shape, np.float32)
    share = np.zeros_like(total)
    for light, top, sample, unclipped in zip(lights, tops, few, open_, strict=True):
        both = unclipped & open_[best]
        if both.sum() < min(_FEWEST, both.size // 4):
            continue
        a, b = few[best][both], sample[both]
        exposure = float(np.mean((a - a.mean()) * (b - b.mean())) / max(float(a.var()), 1e-30))
        if not exposure > _TELLING:
            continue
        black = float(b.mean() - exposure * a.mean())
        good = light < np.float32(top)
        total += np.where(good, np.float32(exposure) * (light - np.float32(black)), np.float32(0))
        share += np.where(good, np.float32(exposure**2), np.float32(0))
    seen = share > 0
    if not seen.any():
        return lights[best]
    combined = np.where(seen, total / np.where(seen, share, np.float32(1)), np.float32(tops[best]))
    return np.maximum(combined, np.float32(0))


def average_scenes(lights: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(h, w) mean light of the frames of scenes, each scaled to mean 1."""
    total = np.zeros(lights[0].shape, np.float32)
    for light in lights:
        total += light / np.float32(max(float(light.mean(dtype=np.float64)), 1e-30) * len(lights))
    return total


def clipping_level(light: NDArray[np.float32]) -> float:
    """Light from which on pixels of an array of any shape are clipped, infinite where none are."""
    top = _AT_TOP * float(light.max())
    return top if float((light >= top).mean()) > _CLIPPED else float("inf")
