"""Coarse disparity of single lenses, to sort them by depth and to find the mode of a scene.

Adjacent microimages are correlated over a grid of signed patch sizes; correlations are summed over
3 x 3 lenses.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..images.preprocessing import sqrt_luminance
from ..lattice.lattice import Lattice
from ..runtime.arrays import Floats, Singles
from ..runtime.kernels import FAST, kernel
from .lens_sample import LensSample, sample_lenses

__all__ = ["STEP", "estimate_coarse_disparity", "find_scene_mode"]

#: Spacing of the disparities that are tried [s / D].
STEP = 0.05
# [s / D] Beyond this, neighbours have too little in common.
_REACH = 0.6
# [usable radius] Pixels that are compared.
_RADIUS = 0.88
# Difference of the correlations of two disparities below which neither is sure.
_AMBIGUOUS = 0.04
# Share of lenses in the other mode: 1 to 9 % in scenes that are in one.
_OTHER_MODE = 0.2


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _covariance(pixels, width, cx, cy, places, across, down):
    """Covariance of the pixels of a lens and another one over some places, and mean variance."""
    a = b = aa = bb = ab = np.float32(0)
    for place in range(places.shape[1]):
        x = cx + places[0, place]
        y = cy + places[1, place]
        own = pixels[np.uint32(np.int32(y) * width + np.int32(x))]
        other = pixels[np.uint32(np.int32(y + down) * width + np.int32(x + across))]
        a += own
        b += other
        aa += own * own
        bb += other * other
        ab += own * other
    count = places.shape[1]
    return (ab - a * b / count) / count, 0.5 * (aa + bb - (a * a + b * b) / count) / count


@kernel(error_model="numpy", share=lambda picture, centres, *_: len(centres), fastmath=FAST)
def _correlate(begin, end, picture, centres, steps, ratios, radius, spacing, covariance, variance):
    """Covariances and mean variances (n, ratios) of lenses and their neighbours.

    They are summed over the `steps`.
    """
    height, width = picture.shape
    pixels = picture.ravel()
    reach = int(radius / spacing)
    side = 2 * reach + 1
    # Places that both lenses show, from the centre of each [px].
    places = np.empty((len(ratios), len(steps), 2, side * side), np.float32)
    shown = np.zeros((len(ratios), len(steps)), np.int64)
    for k in range(len(ratios)):
        for step in range(len(steps)):
            ux = ratios[k] * steps[step, 0] / 2
            uy = ratios[k] * steps[step, 1] / 2
            for row in range(-reach, reach + 1):
                for column in range(-reach, reach + 1):
                    x = column * spacing
                    y = row * spacing
                    first = (x - ux) * (x - ux) + (y - uy) * (y - uy)
                    second = (x + ux) * (x + ux) + (y + uy) * (y + uy)
                    if max(first, second) <= radius * radius:
                        places[k, step, 0, shown[k, step]] = x - ux
                        places[k, step, 1, shown[k, step]] = y - uy
                        shown[k, step] += 1
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        for step in range(len(steps)):
            left = min(cx, cx + steps[step, 0])
            top = min(cy, cy + steps[step, 1])
            right = max(cx, cx + steps[step, 0])
            bottom = max(cy, cy + steps[step, 1])
            # The other lens may lie beyond the flat.
            if (
                min(left, top) < radius
                or right > width - 1 - radius
                or bottom > height - 1 - radius
            ):
                continue
            for k in range(len(ratios)):
                count = shown[k, step]
                if count <= 4:
                    continue
                # With half a pixel added, truncation rounds.
                together, alone = _covariance(
                    pixels,
                    np.int32(width),
                    np.float32(cx + 0.5),
                    np.float32(cy + 0.5),
                    places[k, step, :, :count],
                    np.float32((1 + ratios[k]) * steps[step, 0]),
                    np.float32((1 + ratios[k]) * steps[step, 1]),
                )
                covariance[lens, k] += together
                variance[lens, k] += alone


def estimate_coarse_disparity(picture: Singles, sample: LensSample) -> Floats:
    """(n,) `s / D` of the inner lenses of a sample, in steps of `STEP`.

    NaN if the highest correlation is low, ambiguous, or that of the first or last step. `picture`
    (h, w) is made by `images.preprocessing.sqrt_luminance`.
    """
    lattice = sample.lattice
    radius = _RADIUS * lattice.radius
    ratios = np.linspace(-_REACH, _REACH, 2 * round(_REACH / STEP) + 1)
    steps = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
    # Every other lens is enough, as sums are over 3 x 3 lenses.
    chosen = sample.whole & (sample.index.sum(-1) % 2 == 0)
    sums = np.zeros((2, int(chosen.sum()), len(ratios)))
    _correlate(picture, sample.place[chosen], steps, ratios, radius, max(1.0, radius / 4), *sums)
    full = np.zeros((2, *sample.whole.shape, len(ratios)))
    full[:, chosen] = sums
    padded = np.pad(full, ((0, 0), (0, 0), (1, 1), (1, 1), (0, 0)))
    height, width = full.shape[2:4]
    # Over 3 x 3 lenses.
    covariance, variance = np.sum(
        [padded[:, :, y : y + height, x : x + width] for y in range(3) for x in range(3)], 0
    )
    correlation = covariance / (variance + 1e-5)
    best = correlation.argmax(-1)
    highest = correlation.max(-1)
    apart = np.abs(np.arange(len(ratios)) - best[..., None]) > 2
    second = np.where(apart, correlation, -1.0).max(-1)
    inside = (best > 0) & (best < len(ratios) - 1)
    known = (highest > 0.5) & (highest - second > _AMBIGUOUS) & inside
    return np.where(known, ratios[best], np.nan)[:, 1:-1, 1:-1].ravel()


def find_scene_mode(flat: NDArray, lattice: Lattice) -> Literal["telescopic", "binocular"] | None:
    """The mode of a scene, from the sign of its coarse disparity.

    None if too few lenses have a disparity, or too many have the other mode.

    `flat` is (h, w) or (h, w, 3).
    """
    ratio = estimate_coarse_disparity(sqrt_luminance(flat), sample_lenses(lattice))
    known = ratio[np.isfinite(ratio) & (ratio != 0)]
    telescopic = 0.5
    if len(known):
        telescopic = float((known > 0).mean())
    if len(known) < 100 or min(telescopic, 1 - telescopic) > _OTHER_MODE:
        return None
    if telescopic > 0.5:
        return "telescopic"
    return "binocular"
