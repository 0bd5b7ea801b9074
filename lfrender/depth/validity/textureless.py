"""Which lenses need not be matched, and whether that can be told: texture as fine as noise shows in matches alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import opposite_neighbours
from ...flat.texture import LensStatistics, classify_texture, estimate_noise, find_noise_only
from ..matching.matcher import Matcher
from ..matching.shortcuts import sample_lenses
from ..presets import Preset
from .classify import LEAST_EVIDENCE, SHADED_REACH

__all__ = ["find_textureless"]

# About so many of the lenses that seem to show nothing but noise are matched. So many of them that correlate like faint
# texture show some: of noise hardly one in a hundred correlates half as much.
_SAMPLE, _ENOUGH = 32, 3
# Texture as fine as noise correlates with itself over this shift [px] by less than this share of what it does in place.
_FINE, _FALLEN = 3.0, 0.5


def find_textureless(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    setting: Preset,
    noise: float | None = None,
    asked: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_] | None:
    """(n,) bool: lenses whose pixels are explained by noise; None where some of them do match, so that all must be.

    Where every lens shows fine texture, the least rough of them do not tell the noise, and faint texture passes for it.
    Shading matches as well, but near zero, and over a wide range of shifts. Where none of those that are `asked` (n,)
    is blank, the others are not looked at.
    """
    noise = estimate_noise(plain.roughness) if noise is None else noise
    blank = find_noise_only(plain, noise)
    if asked is not None and not (blank & asked).any():
        return blank
    texture = classify_texture(gray, plain, noise)
    sample = sample_lenses(lattice.indices(), texture.faint & blank, _SAMPLE)
    if sample.any():
        matcher = Matcher(texture, *opposite_neighbours(lattice), setting, sample)
        evidence = 1 - matcher.lens_costs(matcher.pair_costs(sample), sample)
        matching = (evidence.max(1) >= LEAST_EVIDENCE) & ~_like_shading(evidence, matcher)
        if matching.sum() >= _ENOUGH:
            return None
    return blank


def _like_shading(evidence: NDArray[np.float32], matcher: Matcher) -> NDArray[np.bool_]:
    """(m,) bool: lenses that match near zero and hardly worse farther out, by correlations (m, k) at each shift."""
    best, last = evidence.argmax(1), len(matcher.shifts) - 1
    shift = matcher.shifts[best]
    outward = np.where(shift < 0, -1, 1) * round(_FINE / (matcher.factor * matcher.step))
    farther = evidence[np.arange(len(best)), np.clip(best + outward, 0, last)]
    near_zero = np.abs(shift) < SHADED_REACH * matcher.gray.pitch
    return np.asarray(near_zero & (farther > _FALLEN * evidence.max(1)))
