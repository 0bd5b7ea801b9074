"""Depth of a flat: signed patch size of every microlens, from nothing but its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice

from .agreement import aggregate, lens_costs
from .depthmap import DepthMap
from .flatcheck import check_flat
from .matching import lens_statistics, pair_costs
from .modes import confidence, fill, parabola_peak, second_best
from .neighbours import neighbour_rows
from .radiance import GrayFlat, gray_flat, shrink
from .refinement import fit_pairs
from .shading import flatten_shading
from .slant import fit_lenses
from .spreading import spread

__all__ = ["PRESETS", "analyze"]


@dataclass(frozen=True)
class _Preset:
    """What an analysis spends: pitch it searches at [px], shift step [px], every n-th row, refinement steps.

    Detail is sharper in a picture made smaller for the search than in the flat itself, where it has at
    least the microlenses' blur: `full_step` is enough there.
    """

    search_pitch: float
    step: float
    full_step: float
    row_step: int
    iterations: int


PRESETS = {
    "fast": _Preset(search_pitch=16, step=1.0, full_step=1.0, row_step=2, iterations=3),
    "balanced": _Preset(search_pitch=24, step=0.75, full_step=1.0, row_step=2, iterations=5),
    "accurate": _Preset(search_pitch=40, step=0.5, full_step=0.5, row_step=1, iterations=8),
}

# Beyond this share of the pitch neighbouring microimages share too little to tell (GEOMETRY.md).
_RESOLVABLE = 0.75
# The search reaches a little further, so that the last resolvable shift has a rising flank on both sides.
_SEARCHED = 0.82
# Contrast that fixed-pattern shading inside microimages may fake, in shares of their brightness.
_SHADING = 0.02
# A lens carries texture when its contrast exceeds the noise this many times.
_TEXTURED = 1.5
# Prices of semi-global matching in units of the match cost (0 perfect, 1 unrelated).
_SLOPE_PER_PIXEL, _JUMP = 0.03, 0.3
_SURE = 0.5
# A second depth is tried on the pixels when it matches the lens at most this much worse.
_SECOND = 0.3


def analyze(flat: NDArray, calibration: Calibration, preset: str = "balanced") -> DepthMap:
    """Estimate the signed patch size, mode and magnification of every microlens.

    Neighbouring microimages are correlated over all signed shifts at once (Lumsdaine and Georgiev
    2008, sections 4 to 6: telescopic and binocular differ only in the sign), lenses support each
    other along the lattice, and the best shift is refined on the pixels.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
        Raw capture; integers are taken relative to the range of their type, floats to 1.
    calibration : Calibration
        Of the same image size.
    preset : {"fast", "balanced", "accurate"}
        How much time to spend.

    Returns
    -------
    DepthMap

    Raises
    ------
    FlatError
        If `flat` is not a picture of finite numbers.
    CalibrationError
        If `calibration` was made for another image size.
    """
    if preset not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    flat = check_flat(flat, calibration)
    setting = PRESETS[preset]
    lattice = calibration.lattice
    neighbours = neighbour_rows(lattice, lattice.steps)
    fine, noise, contrast, textured = _texture(gray_flat(flat, calibration), lattice)
    factor = max(1, round(lattice.pitch / setting.search_pitch))
    step = setting.step if factor > 1 else max(setting.step, setting.full_step)
    shifts, cost, total = _search(shrink(fine, factor), neighbours, step, setting.row_step, noise / factor, textured)
    best = total.argmin(1)
    start = (shifts[best] + parabola_peak(total, best) * (shifts[1] - shifts[0])) * factor
    sure = confidence(total, best, neighbours.shape[1], max(1, round(1.5 / step)))
    scale = np.maximum(3 * noise, 0.5 * contrast)
    first = np.where(textured, start, np.nan).astype(np.float32)
    half = neighbours.shape[1] // 2
    forward, backward = neighbours[:, :half], neighbours[:, half:]
    fits = fit_lenses(fine, forward, backward, fit_pairs(fine, forward, first, scale, setting.iterations), first)
    measured = np.isfinite(fits.patch_size)
    refined = np.where(measured, fits.patch_size, start)
    error = np.where(measured, fits.standard_error, np.inf)
    resolved = textured & (sure >= _SURE) & (np.abs(refined) <= _RESOLVABLE * lattice.pitch)
    gap = max(1.0, 0.05 * lattice.pitch)
    drawn = fill(np.where(resolved, refined, start).astype(np.float32), resolved, neighbours, gap)
    other, other_cost = second_best(cost, best, max(2, round(2 / step)))
    credible = other_cost < cost[np.arange(len(best)), best] + _SECOND
    seconds = np.where(credible & textured, shifts[other] * factor, np.nan).astype(np.float32)
    trust = np.where(resolved, sure, 0.05).astype(np.float32)
    surface = spread(fine, lattice, drawn, seconds, trust, noise)
    # A lens that sees two depths answers with the one in its middle.
    middle = surface.at(lattice.centres())
    crossed = resolved & (np.abs(middle - drawn) > gap)
    patch_size = np.where(crossed, middle, np.where(resolved, refined, np.nan))
    return DepthMap(
        patch_size=patch_size,
        standard_error=np.where(crossed, np.maximum(error, step * factor), np.where(resolved, error, np.inf)),
        confidence=np.where(crossed, _SURE * sure, np.where(textured, sure, 0)),
        drawn=np.where(crossed, middle, drawn),
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
    )


def _texture(gray: GrayFlat, lattice: Lattice) -> tuple[GrayFlat, float, NDArray[np.float32], NDArray[np.bool_]]:
    """The flat without fixed shading, its noise, each lens's contrast, and which lenses have enough of it."""
    mean, contrast, roughness = lens_statistics(gray).T
    flattened = flatten_shading(gray, lattice, mean, contrast)
    mean, contrast, roughness = lens_statistics(flattened).T
    # The least rough microimages show the noise alone; rounding and coding leave a grey level in any case.
    noise = max(float(np.percentile(roughness, 2)), 1 / 255)
    return flattened, noise, contrast, contrast > np.hypot(_TEXTURED * noise, _SHADING * mean)


def _search(
    coarse: GrayFlat,
    neighbours: NDArray[np.int32],
    step: float,
    row_step: int,
    noise: float,
    textured: NDArray[np.bool_],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Shifts [px of `coarse`], their cost for every lens, and that cost aggregated over the lattice."""
    half = neighbours.shape[1] // 2
    forward, backward = neighbours[:, :half], neighbours[:, half:]
    side = int(np.ceil(_SEARCHED * coarse.pitch / step))
    shifts = (np.arange(-side, side + 1) * step).astype(np.float32)
    means, contrast, _ = lens_statistics(coarse).T
    pair = pair_costs(coarse, forward, means, contrast, textured, shifts, noise, _SHADING, row_step)
    cost = lens_costs(pair, forward, backward)
    return shifts, cost, aggregate(cost, forward, backward, _SLOPE_PER_PIXEL * step, _JUMP)
