"""Lenses that show nothing but noise, which need not be matched: found where fine texture cannot hide in the noise."""

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
from .settings import CLASSIFY, TexturelessSettings

__all__ = ["find_textureless"]

_DEFAULT = TexturelessSettings()


def find_textureless(
    gray: GrayFlat,
    lattice: Lattice,
    plain: LensStatistics,
    setting: Preset,
    noise: float | None = None,
    asked: NDArray[np.bool_] | None = None,
    settings: TexturelessSettings = _DEFAULT,
) -> NDArray[np.bool_] | None:
    """(n,) bool: lenses whose pixels are explained by noise; None if some of them match, so that all must be matched.

    If every lens shows fine texture, the noise is overestimated from the least rough lenses, and faint texture passes
    for it. So a sample of those lenses is matched. Shading matches as well, but near zero, over a wide range of shifts.
    If none of the lenses that are `asked` (n,) is textureless, the others are not matched.
    """
    noise = estimate_noise(plain.roughness) if noise is None else noise
    blank = find_noise_only(plain, noise)
    if asked is not None and not (blank & asked).any():
        return blank
    texture = classify_texture(gray, plain, noise)
    # Lenses cut by the border of the flat match by chance more often.
    last = np.array(gray.image.shape[::-1]) - 1 - gray.radius
    inner = ((gray.centres >= gray.radius) & (gray.centres <= last)).all(1)
    sample = sample_lenses(lattice.indices(), texture.faint & blank & inner, settings.sample)
    if sample.any():
        matcher = Matcher(texture, *opposite_neighbours(lattice), setting, sample)
        correlation = 1 - matcher.lens_costs(matcher.pair_costs(sample), sample)
        matching = correlation.max(1) >= CLASSIFY.least_correlation
        matching &= ~_match_like_shading(correlation, matcher, settings)
        if matching.sum() >= settings.enough:
            return None
    return blank


def _match_like_shading(
    correlation: NDArray[np.float32], matcher: Matcher, settings: TexturelessSettings
) -> NDArray[np.bool_]:
    """(m,) bool: lenses that match near zero and hardly worse farther out, by correlations (m, k) at each shift."""
    best, last = correlation.argmax(1), len(matcher.shifts) - 1
    shift = matcher.shifts[best]
    outward = np.where(shift < 0, -1, 1) * round(settings.correlation_length / (matcher.factor * matcher.step))
    farther = correlation[np.arange(len(best)), np.clip(best + outward, 0, last)]
    near_zero = np.abs(shift) < CLASSIFY.shading_reach * matcher.gray.pitch
    return np.asarray(near_zero & (farther > settings.decay * correlation.max(1)))
