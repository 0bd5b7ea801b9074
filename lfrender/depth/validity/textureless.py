"""Lenses that show nothing but noise, which need not be matched: found where fine texture cannot
hide in the noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...flat.gray_flat import GrayFlat
from ...flat.neighbours import neighbours_of
from ...flat.texture import LensStatistics, classify_texture, find_noise_only
from ..matching.matcher import Matcher, sample_lenses
from ..presets import Preset
from .classify import LEAST_CORRELATION, SHADING_REACH

__all__ = ["find_textureless"]


def find_textureless(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    preset: Preset,
    noise: float | None = None,
    asked: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_] | None:
    """(n,) bool: lenses whose pixels are explained by noise; None if some of them match, so that
    all must be matched.

    A sample of those lenses is matched, since faint texture all over passes for noise. If none of
    the lenses that are `asked` (n,) is textureless, the others are not matched.
    """
    noise = plain.noise if noise is None else noise
    blank = find_noise_only(plain, noise)
    if asked is not None and not (blank & asked).any():
        return blank
    texture = classify_texture(gray, plain, noise)
    # Lenses cut by the border of the flat match by chance more often.
    last = np.array(gray.image.shape[::-1]) - 1 - gray.radius
    inner = ((gray.centres >= gray.radius) & (gray.centres <= last)).all(1)
    sample = sample_lenses(lattice.indices(), texture.faint & blank & inner, 32)
    if not sample.any():
        return blank
    matcher = Matcher(texture, neighbours_of(lattice), preset, sample)
    correlation = 1 - matcher.lens_costs(matcher.pair_costs(sample), sample)
    best = correlation.argmax(1)
    last_shift = len(matcher.shifts) - 1
    shift = matcher.shifts[best]
    highest = correlation.max(1)
    # Texture as fine as noise correlates with itself by less than half of that three pixels of the
    # flat farther out.
    outward = np.where(shift < 0, -1, 1) * round(3 / (matcher.factor * matcher.step))
    farther = correlation[np.arange(len(best)), np.clip(best + outward, 0, last_shift)]
    like_shading = (np.abs(shift) < SHADING_REACH * matcher.gray.pitch) & (farther > 0.5 * highest)
    # Of noise, one lens in a hundred correlates half as much.
    return None if ((highest >= LEAST_CORRELATION) & ~like_shading).sum() >= 3 else blank
