"""Sub-pixel patch size of lenses from several starts: registration finds the optimum that is next to its start."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat
from .lens_plane import LensFits, fit_lens_planes
from .pair_fit import fit_pairs
from .settings import REFINEMENT, RefinementSettings

__all__ = ["refine_patch_sizes"]


def refine_patch_sizes(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    start: NDArray[np.float32],
    second: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float = 0.02,
    settings: RefinementSettings = REFINEMENT,
) -> LensFits:
    """Sub-pixel patch size of each lens from its own pairs.

    Lenses are fitted again from a larger patch size where matches are biased, and from the second-best match; the fit
    with the smallest error is kept. The best match is the mean over all pairs, including those in which one lens is
    occluded, so that pairs may agree better on the second-best one.

    Parameters
    ----------
    gray : GrayFlat
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    start : (n,) float32 [px]
        Start values; NaN for lenses to leave out.
    second : (n,) float32 [px]
        Other values that may be right, far from the first; NaN where there is none.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly show the same point.
    noise : float
        Standard deviation of a pixel.
    iterations : int
        Of each fit of a pair, at most.
    last_step : float [px]
        As `fit_pairs`.
    settings : RefinementSettings
    """

    def fit(start: NDArray[np.float32]) -> LensFits:
        pairs = fit_pairs(gray, forward, start, scale, noise, iterations, last_step)
        return fit_lens_planes(gray, forward, backward, pairs, start)

    own = fit(start)
    larger = start + np.sign(start) * np.float32(settings.bias * gray.pitch)
    far = np.abs(start) > settings.far_patch_size * gray.pitch
    for other in (np.where(far, larger, np.float32(np.nan)), second.astype(np.float32)):
        if np.isfinite(other).any():
            own = _better_of(own, fit(other))
    return own


def _better_of(one: LensFits, other: LensFits) -> LensFits:
    """For each lens the fit with the smaller error, the first of equals."""
    better = other.standard_error < one.standard_error
    pairs = ((getattr(one, field.name), getattr(other, field.name)) for field in fields(LensFits))
    return LensFits(*(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in pairs))
