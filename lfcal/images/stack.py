"""Several flats of one camera combined into one: white images by exposure, frames of scenes by their mean.

Flats without contrast, such as dark or saturated ones, are left out; clipped pixels are taken from other flats.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .settings import STACK

__all__ = ["average_scenes", "clipping_level", "combine_whites", "select_contrasted"]


def select_contrasted(lights: Sequence[NDArray[np.float32]]) -> list[int]:
    """Indices of the flats that have contrast, among `lights` (h, w) in one scale."""
    contrast = [float(light.std(dtype=np.float64)) for light in lights]
    return [k for k, value in enumerate(contrast) if value >= STACK.least_contrast * max(contrast)]


def combine_whites(lights: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Weighted least-squares estimate of the light from all white images, by their exposures.

    `lights` (h, w) are linear, with any exposures and black levels; the result is in the scale of the best exposed one.
    """
    if len(lights) == 1:
        return lights[0]
    levels = [clipping_level(light) for light in lights]
    step = max(1, int(np.sqrt(lights[0].size / STACK.sample)))
    # Odd steps sample every phase of a mosaic.
    few = [light[:: step | 1, :: step | 1].ravel().astype(np.float64) for light in lights]
    unclipped = [sample < top for sample, top in zip(few, levels, strict=True)]
    best = max(range(len(lights)), key=lambda k: float(few[k].std()) * (0.5 + float(unclipped[k].mean())))
    total = np.zeros(lights[0].shape, np.float32)
    share = np.zeros_like(total)
    for light, top, sample, valid in zip(lights, levels, few, unclipped, strict=True):
        both = valid & unclipped[best]
        if both.sum() < min(STACK.least_sample, both.size // 4):
            continue
        a, b = few[best][both], sample[both]
        exposure = float(np.mean((a - a.mean()) * (b - b.mean())) / max(float(a.var()), 1e-30))
        if not exposure > STACK.least_contrast:
            continue
        black = float(b.mean() - exposure * a.mean())
        good = light < np.float32(top)
        total += np.where(good, np.float32(exposure) * (light - np.float32(black)), np.float32(0))
        share += np.where(good, np.float32(exposure**2), np.float32(0))
    known = share > 0
    if not known.any():
        return lights[best]
    combined = np.where(known, total / np.where(known, share, np.float32(1)), np.float32(levels[best]))
    return np.maximum(combined, np.float32(0))


def average_scenes(lights: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(h, w) mean of the lights of scenes, each scaled to mean 1."""
    total = np.zeros(lights[0].shape, np.float32)
    for light in lights:
        total += light / np.float32(max(float(light.mean(dtype=np.float64)), 1e-30) * len(lights))
    return total


def clipping_level(light: NDArray[np.float32]) -> float:
    """Least light of clipped pixels in an array of any shape, infinite where none are clipped."""
    top = STACK.clipped_level * float(light.max())
    return top if float((light >= top).mean()) > STACK.clipped_share else float("inf")
