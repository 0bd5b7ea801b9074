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
from typing import NamedTuple

import numpy as np

from ..gain.gain_map import GainMap, choose_degree, count_terms, nearest_half
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..microimage.average import average_profile, estimate_variance
from ..runtime.arrays import Array, Booleans, Floats, Integers, Singles
from .residuals import Residuals, collect_residuals, draw_sample

__all__ = ["estimate_gain"]

# Pixels of the sample.
_PIXELS = 1.5e5
# [px] between samples of the profile; a rim is about one pixel soft.
_STEP = 0.25
# Light of a rim falls by at least this over the radius.
_LEAST = 0.02
# Harmonics of rims, enough for squares and hexagons with their corners.
_HARMONICS = 12
# Squared standard errors by which the factors of a term differ from 0. With the logarithm of the
# number of lenses (BIC), content of scenes made harmonics.
_FOUR_ERRORS = 16
# Degrees of the polynomials of the field that are tried.
_RIM_DEGREES = (2,)
_SHADING_DEGREES = (3, 1)
# Light through the cutting disc between which pixels lie on its edge.
_EDGE = 0.001
# [softness of its edge] largest step of the softness; other steps may be as long as that is wide.
_SOFTENING = 0.3
# Least relative light of pixels that show the shading.
_SHADED = 0.7
# Light through the cutting disc of pixels that are not on its edge.
_UNCUT = 0.95


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
            edges = Edges.of(residuals, gain)
            gain = replace(gain, rim=_fit_rim(residuals, gain, edges, scene))
            if not scene:
                gain = replace(gain, shading=_fit_shading(residuals, gain, edges))
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


class Edges(NamedTuple):
    """Pixels (q,) of rims."""

    inside: Booleans  # which pixels
    steep: Array  # how their light falls towards the outside, over the radius

    @classmethod
    def of(cls, residuals: Residuals, gain: GainMap) -> Edges:
        """Those of the current map."""
        slope = np.gradient(gain.profile, gain.step)
        far = residuals.sample.pixels.distance() / gain.radius
        steep = residuals.places.read(slope) * residuals.through * residuals.plane * far
        return cls(np.abs(steep) > _LEAST, steep)


def _fit_rim(residuals: Residuals, gain: GainMap, edges: Edges, scene: bool) -> Array:
    """New polynomials of the rim: harmonics of the direction times monomials of the field.

    Only the mean and the first three harmonics may change over the field, and the mean rim of the
    whole field is in the profile. Of scenes, whose content leaks into them, none changes.
    """
    inside = edges.inside & (residuals.through > _UNCUT)
    own = residuals.select(np.flatnonzero(inside))
    _, x, y, _ = own.sample.pixels
    first = np.exp(1j * np.arctan2(y, x))[:, None]
    harmonics = np.cumprod(np.repeat(first, _HARMONICS, axis=1), axis=1)
    waves = np.column_stack([np.ones(len(x)), harmonics.view(np.float64)])
    degree = 0 if scene else choose_degree(len(own.sample.field), _RIM_DEGREES)
    harmonic = (np.arange(waves.shape[1]) + 1) // 2
    free = np.ones((len(harmonic), count_terms(degree)), np.bool_)
    free[harmonic > 3, 1:] = False
    free[0, 0] = False
    moved = waves * -edges.steep[inside, None]
    rim = _fit_factors(own, moved, gain.rim, free, harmonic)
    last = int(harmonic[rim.any(1)].max(initial=0))
    return rim[: 1 + 2 * last]


def _fit_shading(residuals: Residuals, gain: GainMap, edges: Edges) -> Array:
    """New polynomials of the shading, whose mean curvature is in the profile."""
    inside = ~edges.inside & (residuals.light > _SHADED) & (residuals.through > _UNCUT)
    own = residuals.select(np.flatnonzero(inside))
    _, x, y, _ = own.sample.pixels
    u = x / gain.radius
    v = y / gain.radius
    # With the sum and the difference of the squares, one factor is the mean curvature.
    columns = np.column_stack([u, v, u * u - v * v, u * v, u * u + v * v])
    turn = np.array([[1, 0, 1], [0, 1, 0], [-1, 0, 1]])
    old = gain.shading.copy()
    old[2:] = np.linalg.solve(turn, old[2:])
    free = np.ones(
        (5, count_terms(choose_degree(len(own.sample.field), _SHADING_DEGREES))), np.bool_
    )
    free[2:, count_terms(2) :] = False
    free[4, 0] = False
    shading = _fit_factors(own, own.light[:, None] * columns, old, free, np.arange(5))
    shading[2:] = turn @ shading[2:]
    return shading


def _fit_factors(
    residuals: Residuals, columns: Array, old: Array, free: Booleans, group: Integers
) -> Array:
    """Polynomials (c, t) of the field of factors of the `columns` (q, c), by weighted least squares.

    `old` (c, s) are those of the map. Factors are 0 where not `free` (c, t), and in a `group` (c,)
    that does not differ from 0 by four standard errors. These follow from the scatter of whole
    lenses, as pixels of a lens err together.
    """
    lens = residuals.sample.pixels.lens
    if not len(lens):
        return np.zeros(free.shape)
    first = np.flatnonzero(np.diff(lens, prepend=-1))
    terms = residuals.sample.terms[lens[first], : free.shape[1]]
    weighted = residuals.weight[:, None] * columns
    lasts = np.append(first[1:], len(lens))
    # Normal equations of each lens, whose place in the field is one.
    normal = np.array([weighted[a:b].T @ columns[a:b] for a, b in zip(first, lasts, strict=True)])
    right = np.add.reduceat(weighted * residuals.error[:, None], first)
    shared = min(old.shape[1], terms.shape[1])
    before = terms[:, :shared] @ old[:, :shared].T
    right[:, : len(old)] += (normal[:, : len(old), : len(old)] @ before[..., None])[..., 0]
    size = free.size
    whole = np.einsum("lab,lt,lu->atbu", normal, terms, terms, optimize=True).reshape(size, size)
    pull = right.T @ terms
    kept = free.copy()
    for _ in range(2):
        chosen = np.flatnonzero(kept)
        inverse = np.linalg.pinv(whole[np.ix_(chosen, chosen)], rcond=1e-10, hermitian=True)
        factors = np.zeros(free.shape)
        found = inverse @ pull[kept]
        factors[kept] = found
        left = right - (normal @ (terms @ factors.T)[..., None])[..., 0]
        errors = (left[..., None] * terms[:, None])[:, kept] @ inverse
        owner = group[np.nonzero(kept)[0]]
        for one in np.unique(owner):
            part = owner == one
            own = found[part]
            scatter = errors[:, part]
            ratio = own @ np.linalg.pinv(scatter.T @ scatter) @ own
            if ratio < len(own) * _FOUR_ERRORS:
                kept[group == one] = False
    return factors * kept


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
    columns = np.column_stack([shift, (shift * field).sum(1), push, -push * depth])
    free = np.ones((5, 1), np.bool_)
    step = _fit_factors(own, columns, np.zeros((5, 1)), free, np.zeros(5, np.int64))[:, 0]
    # Steps beyond the range of the linear model are shortened.
    most = np.array([1, 1, 1, 1, _SOFTENING]) * cut[4]
    return cut + np.clip(step, -most, most)
