"""Which lenses need not be matched, and whether that can be told: texture as fine as noise shows in matches alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from .judgement import LEAST_EVIDENCE
from .neighbours import lens_halves
from .radiance import GrayFlat
from .search import Matcher, Preset
from .skipping import sample_lenses
from .texture import LensStatistics, blank_lenses, noise_of, untouched_texture

__all__ = ["skipped_lenses"]

# About so many of the lenses that seem to show nothing but noise are matched. So many of them that correlate like faint
# texture show some: of noise hardly one in a hundred correlates half as much.
_SAMPLE, _ENOUGH = 32, 3


def skipped_lenses(
    gray: GrayFlat, lattice: Lattice, plain: LensStatistics, setting: Preset, noise: float | None = None
) -> NDArray[np.bool_] | None:
    """(n,) bool: lenses whose pixels are explained by noise; None where some of them do match, so that all must be.

    Where every lens shows fine texture, the least rough of them do not tell the noise, and faint texture passes for it.
    """
    noise = noise_of(plain.roughness) if noise is None else noise
    blank = blank_lenses(plain, noise)
    texture = untouched_texture(gray, plain, noise)
    sample = sample_lenses(lattice, texture.faint & blank, _SAMPLE)
    if sample.any():
        matcher = Matcher(texture, *lens_halves(lattice), setting)
        cost = matcher.costs(matcher.pairs(sample))[sample]
        if np.sum(1 - cost.min(1) >= LEAST_EVIDENCE) >= _ENOUGH:
            return None
    return blank
