"""Profile of microimages from scene captures: what scenes show cancels in sums over many lenses.

A scene is as bright on the average at the rims of microimages as in their middles. The ratio of the summed light at
one distance to that at others is free of it; the mean of ratios within lenses is not, since a lens that shows
something bright in its middle shows something darker around it more often than not.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from ..gain.kernel import evaluate_shape, relative_light
from ..lattice.cell import cell_inradius, cell_normals, is_outside_cell
from ..lattice.lattice import Lattice
from .residuals import draw_sample

__all__ = ["fit_scene_profile"]

# Pixels summed: scenes have more contrast than white images have noise.
_PIXELS = 1e6
# The part of a microimage [its radius] that is 1 on the average before parts that are sure are told from it.
_CORE = 0.6
# Windows of the field as dark as this, over the mean, say nothing.
_DARK = 0.02
# Light is even within this distance from the middle of a microimage [px]: a pixel blurs as much.
_MIDDLE = 1.5
# Parts of the profile nearer to 1 than so many standard errors are taken for 1.
_UNSURE = 2.0


@njit(cache=True, nogil=True, error_model="numpy")
def _sums(picture, centres, first, stride, faces, inner, reach, brightest, field, radius, profile, step, shade, rim,
          cut, up, down):  # fmt: skip
    powers, lens = np.empty(64), np.empty(7 + rim.shape[0])
    total, number = np.empty(len(profile)), np.empty(len(profile))
    for window in range(len(first) - 1):
        for n in range(first[window], first[window + 1]):
            cx, cy = centres[n, 0], centres[n, 1]
            evaluate_shape(cx, cy, field, radius, shade, rim, cut, powers, lens)
            total[:], number[:] = 0.0, 0.0
            clipped, count = 0, 0
            # What a scene shows differs little from row to row.
            for y in range(math.ceil(cy - reach) + n % (2 * stride), math.floor(cy + reach) + 1, 2 * stride):
                dy = y - cy
                half = math.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(math.ceil(cx - half) + (n // stride) % stride, math.floor(cx + half) + 1, stride):
                    dx = x - cx
                    if dx * dx + dy * dy > inner * inner and is_outside_cell(dx, dy, faces):
                        continue
                    _, stretched, through = relative_light(dx, dy, lens, profile, step, cut)
                    if through < 0.5:
                        continue
                    v = picture[y, x] * picture[y, x]
                    clipped += v >= brightest
                    count += 1
                    place = stretched / step
                    ring = min(int(place), len(profile) - 2)
                    part = min(place - ring, 1.0)
                    total[ring] += v * (1 - part)
                    total[ring + 1] += v * part
                    number[ring] += through * (1 - part)
                    number[ring + 1] += through * part
            if clipped * 20 <= count:
                up[window] += total
                down[window] += number


def fit_scene_profile(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, brightest: float
) -> NDArray[np.float64]:
    """(k,) profile of a gain map whose rims are right, from a scene capture; 1 wherever that cannot be excluded.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    gain : GainMap
        Its profile is used where this capture shows none.
    brightest : float
        Light that has been clipped where many pixels of a lens share it.
    """
    faces, reach = cell_normals(lattice)
    sample = draw_sample(lattice, _PIXELS)
    up, down = np.zeros((2, len(sample.first) - 1, len(gain.profile)))
    kernel: Any = _sums
    kernel(
        picture, sample.centres, sample.first, sample.stride, faces, cell_inradius(faces), reach, brightest,
        *gain.shape(lattice), up, down,
    )  # fmt: skip
    rings = np.arange(len(gain.profile))
    core = rings * gain.step < _CORE * gain.radius
    level = up[:, core].sum(1) / np.maximum(down[:, core].sum(1), 1e-12)
    bright = level > _DARK * level.mean()
    if not bright.any():
        return gain.profile
    # A lens has few pixels in its middle, which must not tell more than those around them.
    middle = rings * gain.step < _MIDDLE
    for sums in (up, down):
        sums[:, middle] = sums[:, middle].mean(1, keepdims=True)
    # Each part of the field counts by its pixels, not by its light.
    up, down = up[bright] / level[bright, None], down[bright]
    pixels = down.sum(0)
    ratio = up.sum(0) / np.maximum(pixels, 1e-12)
    filled = pixels > 1e-3 * pixels.max()
    profile = np.interp(rings, rings[filled], ratio[filled])
    profile = _sure(profile, np.interp(rings, rings[filled], _errors(up, down)[filled]))
    smooth = np.convolve(np.pad(profile, 2, "edge"), np.ones(5) / 5, "valid")
    even: NDArray[np.float64] = profile / smooth[rings * gain.step < gain.radius].max()
    return even


def _errors(up: NDArray[np.float64], down: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k,) standard error of the profile, from how parts of the field differ."""
    total = np.maximum(down.sum(0), 1e-12)
    miss = up - down * (up.sum(0) / total)
    parts = max(len(up), 2)
    errors: NDArray[np.float64] = np.sqrt((miss**2).sum(0) * parts / (parts - 1)) / total
    return errors


def _sure(profile: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """The profile, 1 wherever its scenes may have made it differ (shrinkage after James and Stein)."""
    away = profile - 1
    kept = np.maximum(1 - (_UNSURE * error / np.where(away == 0, 1e-12, away)) ** 2, 0)
    return 1 + away * kept
