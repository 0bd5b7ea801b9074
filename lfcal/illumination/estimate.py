"""Estimate a gain map: the common shape of microimages, and its change over the field.

The pixels of a sample of lenses are compared with the current map. Their residuals, summed over the
distance to the centre, correct the profile; over the direction, the rim; over the place in the
microimage, the shading. Low-order polynomials of the field follow them if significant (least
squares).

On a white image a lens has one unknown, its light. On a scene capture a plane is fitted to its
inner part, and lenses that are no plane there have little weight. That suffices for the rims; the
profile itself is taken from sums over many lenses (`profiles`). The light of single lenses cannot
be measured from scenes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..gain.gain_map import GainMap, count_terms, nearest_half
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..microimage.average import average_profile, estimate_variance
from ..runtime.arrays import Array, Booleans, Floats, Singles
from .residuals import Residuals, collect_residuals, draw_sample

__all__ = ["estimate_gain"]

# Pixels of the sample.
_PIXELS = 1.5e5
# [px] between samples of the profile; a rim is about one pixel soft.
_STEP = 0.25
# Light of a rim falls by at least this over the radius; a term of the rim moves it by more [px].
_LEAST = 0.02
# Harmonics of rims, enough for squares and hexagons with their corners; and directions in which rims
# are summed, four for each period of the finest harmonic.
_HARMONICS = 12
_DIRECTIONS = 4 * _HARMONICS
# Light through the cutting disc between which pixels lie on its edge.
_EDGE = 0.001
# [softness of its edge] largest step of the softness; other steps may be as long as that is wide.
_SOFTENING = 0.3
# [px] Least softness of the edge, and how much more of the radius is allowed.
_SOFTEST = (0.2, 0.1)
# [radius] Least radius of the cutting disc after a step.
_SHRINKING = 0.3
# Relative light, and light through the cutting disc, of pixels that show the shading.
_SHADED = (0.7, 0.95)


def estimate_gain(
    picture: Singles | StackedCrops, lattice: Lattice, scene: bool, cut: Floats | None = None
) -> GainMap:
    """Estimate the shape of the microimages of a flat, without the light of single lenses.

    On a scene, the profile is that of single lenses: `fit_scene_profile` corrects it.

    `picture` (h, w), or crops of a white image, is the square root of the luminance; `cut` the
    cutting disc if known.
    """
    sample = draw_sample(lattice, picture, _PIXELS, scene, 1 + scene)
    rings = int(Cell.of(lattice).circumradius / _STEP) + 3
    gain = GainMap.round(np.ones(rings), _STEP, nearest_half(lattice), () if cut is None else cut)
    largest = np.full(rings, np.inf)
    # The profile alone has to be about right before the rest is fitted.
    for terms in (False, False, True, True):
        residuals = collect_residuals(sample, gain, scene, largest)
        if terms:
            rims = _select_rims(residuals, gain)
            gain = replace(gain, rim=_fit_rim(residuals, gain, *rims, scene))
            if not scene:
                gain = replace(gain, shading=_fit_shading(residuals, gain, rims[0]))
            largest = TUKEY_CUTOFF * _measure_noise(residuals, rings)
        gain = _correct_profile(gain, residuals)
        if terms and len(gain.cut):
            # From new residuals: where the two rims coincide, both would else be moved to correct
            # the same error.
            gain = replace(
                gain, cut=_fit_cut(collect_residuals(sample, gain, scene, largest), gain)
            )
    return gain


def _measure_noise(residuals: Residuals, rings: int) -> Array:
    """(k,) standard deviation of pixels over the distance to the centre."""
    before = residuals.places.before
    squares = np.bincount(before, residuals.weight * residuals.error**2, rings)
    number = np.bincount(before, residuals.weight, rings)
    return np.sqrt(np.maximum(estimate_variance(squares, number), 1e-12))


def _correct_profile(gain: GainMap, residuals: Residuals) -> GainMap:
    """The map with its profile, 1 at its brightest, and its stray light corrected."""
    r = residuals
    rings = len(gain.profile)
    bright = r.weight * r.through * r.plane * (r.through > 0.5)
    pixels = r.places.add(bright * r.through * r.plane, rings)
    profile = gain.profile
    if pixels.any():
        error = r.places.add(bright * r.error, rings)
        profile = np.maximum(average_profile(profile * pixels + error, pixels), 0)
    stray = max(profile.min() if math.isnan(r.stray) else gain.stray_light + r.stray, 0.0)
    smooth = np.convolve(np.pad(profile, 2, "edge"), np.ones(5) / 5, "valid")
    brightest = max(float(smooth[np.arange(rings) * gain.step < gain.radius].max()), 1e-9)
    return replace(gain, profile=profile / brightest, stray_light=stray / brightest)


def _fit_significant(blocks: list[Floats], target: Floats, weight: Floats) -> list[Floats]:
    """Fit the columns of each block by weighted least squares; drop insignificant ones.

    A factor is 0 if it moves the rim by less than `_LEAST` [px RMS] or by less than four standard
    errors.
    """
    table = np.hstack(blocks)
    root = np.sqrt(weight)[:, None]
    usable = int((weight > 0).sum())
    ends = np.cumsum([0] + [b.shape[1] for b in blocks])
    keep = np.ones(table.shape[1], dtype=bool)
    factors = np.zeros(table.shape[1])
    if usable <= 2 * table.shape[1]:
        return [np.zeros(b.shape[1]) for b in blocks]
    for _ in range(2):
        weighted = root * table[:, keep]
        covariance = np.linalg.pinv(weighted.T @ weighted, rcond=1e-10)
        factors[:] = 0
        factors[keep] = covariance @ (weighted.T @ (root[:, 0] * target))
        miss = root[:, 0] * (target - table @ factors)
        whole = np.zeros((len(keep), len(keep)))
        whole[np.ix_(keep, keep)] = covariance * float(miss @ miss) / (usable - int(keep.sum()))
        for first, last in pairwise(ends):
            own = slice(first, last)
            size = math.sqrt(
                float(weight @ (table[:, own] @ factors[own]) ** 2) / float(weight.sum())
            )
            ratio = factors[own] @ np.linalg.pinv(whole[own, own]) @ factors[own] / (last - first)
            keep[own] &= size > _LEAST and ratio > 16
    return [factors[a:b] * keep[a:b] for a, b in pairwise(ends)]


def _select_rims(residuals: Residuals, gain: GainMap) -> tuple[Booleans, Array]:
    """Pixels (q,) of rims, and how their light falls towards the outside there, over the radius."""
    r = residuals
    slope = np.gradient(gain.profile, gain.step)
    far = r.sample.pixels.distance() / gain.radius
    steep = r.places.read(slope) * r.through * r.plane * far
    return np.abs(steep) > _LEAST, steep


def _fit_rim(
    residuals: Residuals, gain: GainMap, rims: Booleans, steep: Array, scene: bool
) -> Array:
    """New polynomials of the rim: harmonics of the direction times monomials of the field.

    Only significant terms are kept.

    Only the mean and the first three harmonics may change over the field, and the mean rim of the
    whole field is in the profile. Of scenes, whose content leaks into them, none changes.
    """
    sample = residuals.sample
    lens, x, y, _ = sample.pixels
    directions = _DIRECTIONS
    harmonics = _HARMONICS
    # Sums over the pixels of the rims in each direction of each window: how far they should move.
    bins = np.floor(np.arctan2(y[rims], x[rims]) / (2 * np.pi) * directions + 0.5).astype(np.int64)
    bins = bins % directions + directions * sample.window[lens[rims]]
    size = sample.windows * directions
    steep = steep[rims]
    weight: Array = np.bincount(bins, residuals.weight[rims] * steep**2, size)
    pull: Array = np.bincount(bins, -residuals.weight[rims] * steep * residuals.error[rims], size)
    target = pull / np.maximum(weight, 1e-30)
    angle = np.tile(np.arange(directions) * 2 * np.pi / directions, sample.windows)
    terms = 1
    if sample.windows > 2 * count_terms(2) and not scene:
        terms = count_terms(2)
    field = np.repeat(sample.window_terms[:, :terms], directions, axis=0)
    old, rim = np.zeros((2, 1 + 2 * harmonics, terms))
    old[: len(gain.rim), : gain.rim.shape[1]] = gain.rim
    order = np.outer(np.arange(1, 1 + harmonics), angle)
    waves = np.ones((1 + 2 * harmonics, len(angle)))
    waves[1::2] = np.cos(order)
    waves[2::2] = np.sin(order)
    blocks = []
    places = []
    for k in range(harmonics + 1):
        own = [
            (row, c)
            for row in range(max(2 * k - 1, 0), 2 * k + 1)
            for c in range(terms if k <= 3 else 1)
            if (row, c) != (0, 0)
        ]
        if own:
            row, c = np.array(own).T
            places.append((row, c))
            blocks.append(waves[row].T * field[:, c])
            # What the map holds already is fitted again, so that its significance is tested again.
            target = target + blocks[-1] @ old[places[-1]]
    for place, factors in zip(
        places, _fit_significant(blocks, np.where(weight > 0, target, 0), weight), strict=True
    ):
        rim[place] = factors
    last = int(np.flatnonzero(rim.any(1)).max(initial=0) + 1) // 2
    return rim[: 1 + 2 * last]


def _fit_cut(residuals: Residuals, gain: GainMap) -> Array:
    """One Gauss-Newton step of the cutting disc: shift (2), growth, radius and softness."""
    on_edge = np.abs(residuals.through - 0.5) < 0.5 - _EDGE
    own = residuals.select(np.flatnonzero(on_edge))
    lens, x, y, _ = own.sample.pixels
    field = own.sample.field[lens]
    cut = gain.cut
    offset = np.stack([x, y], axis=1) - cut[:2] - cut[2] * field
    far = np.hypot(*offset.T)
    depth = (cut[3] - far) / cut[4]
    density = np.exp(-0.5 * depth**2) / (math.sqrt(2 * math.pi) * cut[4])
    push = (own.light - gain.stray_light) / own.through * density * own.plane
    shift = push[:, None] * offset / far[:, None]
    rows = np.column_stack([shift, (shift * field).sum(1), push, -push * depth])
    normal = rows.T @ (rows * own.weight[:, None])
    normal += 1e-6 * np.trace(normal) * np.eye(5) + 1e-12 * np.eye(5)
    radius, soft = cut[3:]
    # Steps beyond the range of the linear model are shortened.
    most = np.array([1, 1, 1, 1, _SOFTENING]) * soft
    cut = cut + np.clip(np.linalg.solve(normal, rows.T @ (own.weight * own.error)), -most, most)
    least, more = _SOFTEST
    cut[3] = max(cut[3], _SHRINKING * radius)
    cut[4] = np.clip(cut[4], least, least + more * radius)
    return cut


def _fit_shading(residuals: Residuals, gain: GainMap, rims: Booleans) -> Array:
    """New polynomials of the shading: least squares on the normal equations of all windows."""
    inside = ~rims & (residuals.light > _SHADED[0]) & (residuals.through > _SHADED[1])
    own = residuals.select(np.flatnonzero(inside))
    sample = own.sample
    lens, x, y, _ = sample.pixels
    u = x / gain.radius
    v = y / gain.radius
    rows = own.light[:, None] * np.column_stack([u, v, u * u, u * v, v * v, np.ones_like(u)])
    windows = sample.windows
    window = sample.window[lens]
    terms = next((count_terms(d) for d in (3, 1) if windows > 2 * count_terms(d)), 1)
    field = sample.window_terms
    shading = np.zeros((5, terms))
    shading[:, : gain.shading.shape[1]] = gain.shading[:, :terms]
    fitted = np.ones((5, terms), np.bool_)
    fitted[2:, count_terms(2) :] = False
    matrix = np.zeros((fitted.sum(), fitted.sum()))
    right = np.zeros(len(matrix))
    for k in range(windows):
        pixels = rows[window == k]
        weighted = pixels.T * own.weight[window == k]
        normal = weighted @ pixels
        pull = weighted @ own.error[window == k]
        # The light of a window is eliminated (Schur complement).
        mixed = normal[:5, 5] / max(normal[5, 5], 1e-30)
        normal = normal[:5, :5] - np.outer(mixed, normal[5, :5])
        pull = pull[:5] - mixed * pull[5]
        design = np.kron(np.eye(5), field[k, :terms])[:, fitted.ravel()]
        matrix += design.T @ normal @ design
        right += design.T @ pull
    # The mean curvature is in the profile.
    mean = np.zeros((5, terms))
    mean[[2, 4], 0] = 1
    curvature = mean[fitted]
    trace = np.trace(matrix)
    matrix += np.outer(curvature, curvature) * trace + (1e-9 * trace + 1e-12) * np.eye(len(matrix))
    shading[fitted] += np.linalg.solve(matrix, right)
    return shading
