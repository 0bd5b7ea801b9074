"""Depth of a flat: signed patch size of every microlens, from nothing but its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .agreement import aggregate, lens_costs
from .consensus import measure
from .depthmap import DepthMap
from .flatcheck import check_flat
from .matching import pair_costs
from .modes import confidence, fill, parabola_peak, second_best
from .neighbours import neighbour_rows
from .radiance import gray_flat, shrink
from .spreading import spread
from .texture import FIXED_SHADING, Texture, find_texture, lens_statistics

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
# Prices of semi-global matching in units of the match cost (0 perfect, 1 unrelated). On ray-traced and real flats a
# slant costs little at half the price, and at double the price depth edges begin to suffer.
_SLOPE_PER_PIXEL, _JUMP = 0.07, 0.8
_SURE = 0.5
# A second depth is tried on the pixels when it matches the lens at most this much worse, and the first leaves
# this much unexplained.
_SECOND, _UNEXPLAINED = 0.3, 0.2
# It is where this share of the lenses has its first: a depth that no lens sees alone is more likely a false match.
_POPULATED = 0.005
# Faint texture is believed when the answer is this sure and the lens itself correlates this much there: of lenses
# without texture one in a hundred does.
_PROVEN, _LEAST_EVIDENCE = 0.95, 0.12
# Shading correlates as well, with a patch size near zero: within this share of the pitch it takes more.
_SHADED_REACH, _EVIDENCE_NEAR_ZERO = 0.2, 0.5


def analyze(flat: NDArray, calibration: Calibration, preset: str = "balanced") -> DepthMap:
    """Estimate the signed patch size, mode and magnification of every microlens.

    Neighbouring microimages are correlated over all signed shifts at once (Lumsdaine and Georgiev
    2008, sections 4 to 6: telescopic and binocular differ only in the sign), lenses support each
    other along the lattice, and the best shift is refined on the pixels of every pair, to a plane through each lens.

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
    half = neighbours.shape[1] // 2
    forward, backward = neighbours[:, :half], neighbours[:, half:]
    texture = find_texture(gray_flat(flat, calibration), lattice)
    found = _search(texture, forward, backward, setting)
    textured = texture.clear | (texture.faint & _credible(found, lattice.pitch))
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    first = np.where(textured, found.patch_size, np.nan).astype(np.float32)
    lenses = measure(texture.flat, forward, backward, first, scale, setting.iterations)
    measured = np.isfinite(lenses.patch_size)
    refined = np.where(measured, lenses.patch_size, found.patch_size)
    error = np.where(measured, lenses.standard_error, np.inf)
    resolved = textured & (found.confidence >= _SURE) & (np.abs(refined) <= _RESOLVABLE * lattice.pitch)
    gap = max(1.0, 0.05 * lattice.pitch)
    drawn = fill(np.where(resolved, refined, found.patch_size).astype(np.float32), resolved, neighbours, gap)
    populated = _populated(found.second, refined[resolved], gap)
    seconds = np.where(textured & populated, found.second, np.nan).astype(np.float32)
    trust = np.where(resolved, found.confidence, 0.05).astype(np.float32)
    surface = spread(texture.flat, lattice, drawn, seconds, trust, texture.noise)
    # A lens that sees two depths answers with the one in its middle.
    middle = surface.at(lattice.centres())
    crossed = resolved & (np.abs(middle - drawn) > gap)
    return DepthMap(
        patch_size=np.where(crossed, middle, np.where(resolved, refined, np.nan)),
        standard_error=np.where(crossed, np.maximum(error, found.step), np.where(resolved, error, np.inf)),
        confidence=np.where(crossed, _SURE * found.confidence, np.where(textured, found.confidence, 0)),
        drawn=np.where(crossed, middle, drawn),
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
    )


@dataclass(frozen=True)
class _Found:
    """Answers of the search for every lens, patch sizes in px of the flat.

    Parameters
    ----------
    patch_size, confidence : (n,) float32
        Best value and the probability that it is the right optimum.
    evidence : (n,) float32
        Correlation of the lens with its neighbours there, 0..1.
    second : (n,) float32
        Next best value, NaN where no other comes near.
    step : float
        Between the values that were tried.
    """

    patch_size: NDArray[np.float32]
    confidence: NDArray[np.float32]
    evidence: NDArray[np.float32]
    second: NDArray[np.float32]
    step: float


def _search(texture: Texture, forward: NDArray[np.int32], backward: NDArray[np.int32], setting: _Preset) -> _Found:
    """Match all signed shifts on a flat made as small as the preset asks for, lenses supporting each other."""
    factor = max(1, round(texture.flat.pitch / setting.search_pitch))
    coarse = shrink(texture.flat, factor)
    statistics = texture.statistics if factor == 1 else lens_statistics(coarse, noise_too=False)
    step = setting.step if factor > 1 else max(setting.step, setting.full_step)
    side = int(np.ceil(_SEARCHED * coarse.pitch / step))
    shifts = (np.arange(-side, side + 1) * step).astype(np.float32)
    pair = pair_costs(
        coarse, forward, statistics.mean, statistics.contrast, texture.clear | texture.faint, shifts,
        texture.noise / factor, FIXED_SHADING, setting.row_step,
    )  # fmt: skip
    cost = lens_costs(pair, forward, backward)
    total = aggregate(cost, forward, backward, _SLOPE_PER_PIXEL * step, _JUMP)
    best = total.argmin(1)
    own = cost[np.arange(len(best)), best]
    other, other_cost = second_best(cost, best, max(2, round(2 / step)))
    rival = (own > _UNEXPLAINED) & (other_cost < own + _SECOND)
    return _Found(
        patch_size=((shifts[best] + parabola_peak(total, best) * step) * factor).astype(np.float32),
        confidence=confidence(total, best, 2 * forward.shape[1], max(1, round(1.5 / step))),
        evidence=1 - own,
        second=np.where(rival, shifts[other] * factor, np.nan).astype(np.float32),
        step=step * factor,
    )


def _populated(values: NDArray[np.float32], known: NDArray[np.float32], gap: float) -> NDArray[np.bool_]:
    """Which `values` have their like among `known`, within `gap`; the false matches of a periodic texture have not."""
    ordered = np.sort(known)
    like = np.searchsorted(ordered, values + gap) - np.searchsorted(ordered, values - gap)
    return like >= max(1, _POPULATED * len(ordered))


def _credible(found: _Found, pitch: float) -> NDArray[np.bool_]:
    """Lenses whose match alone proves that they carry texture."""
    near_zero = np.abs(found.patch_size) < _SHADED_REACH * pitch
    enough = np.where(near_zero, _EVIDENCE_NEAR_ZERO, _LEAST_EVIDENCE)
    return (found.confidence >= _PROVEN) & (found.evidence >= enough)
