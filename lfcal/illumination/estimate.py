"""Estimate a gain map: the common shape of the microimages of a flat and its changes over the field.

The pixels of a sample of lenses are compared with the current map. Their residuals, summed over the distance to the
centre, correct the profile; over the direction, the rim; over the place in the microimage, the shading. Low-order
polynomials of the field follow them if significant (least squares).

On a white image a lens has one unknown, its light. On a scene capture a plane is fitted to its inner part, and lenses
that are no plane there have little weight. That suffices for the rims; the profile itself is taken from sums over many
lenses (`scene_profile`). The light of single lenses cannot be measured from scenes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, count_terms, field_frame
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..white_fit.cat_eye import CatEye
from .residuals import DIRECTIONS, GainResiduals, ResidualOptions, collect_residuals
from .sample import draw_sample
from .scene_profile import fit_scene_profile

__all__ = ["clipping_luminance", "estimate_gain", "field_monomials"]

# [px] between samples of the profile; a rim is about one pixel soft.
_STEP = 0.25
# Harmonics of the rim over the direction: squares and hexagons with their corners.
_HARMONICS = 12


def estimate_gain(
    picture: NDArray[np.float32] | StackedCrops, lattice: Lattice, scene: bool, cat_eye: CatEye | None = None
) -> GainMap:
    """Estimate the shape of the microimages of a flat, without the light of single lenses.

    Parameters
    ----------
    picture : (h, w) float32, or crops of such a white image
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    scene : bool
        Whether the flat is a scene capture, not a white image.
    cat_eye : CatEye or None
        The cutting disc if known.
    """
    crops = StackedCrops.of(picture)
    picture = crops.picture
    sample = draw_sample(lattice, 3e5, crops)
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    rings = int(Cell.of(lattice).circumradius / _STEP) + 3
    cut = () if cat_eye is None else (*cat_eye.shift, cat_eye.growth, cat_eye.radius, cat_eye.blur)
    gain = GainMap.round(np.ones(rings), _STEP, limit, cut)
    core, brightest = (0.6 if scene else 0.5) * limit, clipping_luminance(picture, scene)
    spread = np.full(rings, np.inf)
    # The profile alone has to be about right before the rest is fitted.
    for terms in (False, False, True, True):
        options = ResidualOptions(core, scene, brightest, (TUKEY_CUTOFF * spread) ** 2, terms)
        residuals = collect_residuals(picture, lattice, gain, sample, options)
        if terms:
            gain = replace(gain, rim=_fit_rim(residuals, gain, sample.middle, lattice))
            if not scene:
                gain = replace(gain, shading=_fit_shading(residuals, gain, sample.middle, lattice))
            spread = _estimate_noise(residuals)
        gain = _correct_profile(gain, residuals)
        if terms and len(gain.cut):
            # From new residuals: where the two rims coincide, both would else be moved to correct the same error.
            gain = replace(gain, cut=_fit_cut(collect_residuals(picture, lattice, gain, sample, options), gain))
    return replace(gain, profile=fit_scene_profile(picture, lattice, gain, brightest)) if scene else gain


def clipping_luminance(picture: NDArray[np.float32], scene: bool) -> float:
    """Luminance from which on pixels count as clipped; a white image can be as even as if it were."""
    return 0.995 * float(picture.max()) ** 2 if scene else math.inf


def _estimate_noise(residuals: GainResiduals) -> NDArray[np.float64]:
    """(k,) standard deviation of pixels over the distance to the centre."""
    square, count = residuals.rings[2].sum(0), residuals.rings[3].sum(0)
    few = max(1e-4 * count.sum(), 1e-12)
    near = np.convolve(square, np.ones(5), "same") + few * square.sum() / max(count.sum(), 1e-12)
    return np.sqrt(np.maximum(near / (np.convolve(count, np.ones(5), "same") + few), 1e-12))


def _correct_profile(gain: GainMap, residuals: GainResiduals) -> GainMap:
    """The map with its profile, 1 at its brightest, and its stray light corrected."""
    up, down = residuals.rings[:2]
    pixels = down.sum(0)
    found = np.maximum(gain.profile + up.sum(0) / np.maximum(pixels, 1e-300), 0.0)
    # Rings with hardly any pixel are interpolated.
    at, filled = np.arange(len(found)), pixels > 1e-3 * pixels.max()
    profile = np.interp(at, at[filled], found[filled]) if filled.any() else gain.profile
    behind, weight = residuals.dark.sum(0)
    stray = max(float(gain.stray_light + behind / weight if weight > 0 else profile.min()), 0.0)
    smooth = np.convolve(np.pad(profile, 2, "edge"), np.ones(5) / 5, "valid")
    brightest = max(float(smooth[at * gain.step < gain.radius].max()), 1e-9)
    return replace(gain, profile=profile / brightest, stray_light=stray / brightest)


def field_monomials(points: NDArray[np.float64], lattice: Lattice, degree: int) -> NDArray[np.float64]:
    """(n, t) terms of a polynomial of the field at flat positions `points` (n, 2), in the order of `GainMap`."""
    middle_x, middle_y, reach = field_frame(lattice)
    x, y = ((points - (middle_x, middle_y)) / reach).T
    xs, ys = (np.vander(v, degree + 1, increasing=True) for v in (x, y))
    return np.column_stack([xs[:, d - b] * ys[:, b] for d in range(degree + 1) for b in range(d + 1)])


def _fit_significant(
    blocks: list[NDArray[np.float64]], target: NDArray[np.float64], weight: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Weighted least-squares factors of the columns of each block, zero for those that hardly move the rim.

    By 0.02 px RMS, and four standard errors.
    """
    table = np.hstack(blocks)
    root = np.sqrt(weight)[:, None]
    usable = int((weight > 0).sum())
    ends = np.cumsum([0] + [b.shape[1] for b in blocks])
    keep, factors = np.ones(table.shape[1], dtype=bool), np.zeros(table.shape[1])
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
            size = math.sqrt(float(weight @ (table[:, own] @ factors[own]) ** 2) / float(weight.sum()))
            ratio = factors[own] @ np.linalg.pinv(whole[own, own]) @ factors[own] / (last - first)
            keep[own] &= size > 0.02 and ratio > 16
    return [factors[a:b] * keep[a:b] for a, b in pairwise(ends)]


def _fit_rim(
    residuals: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice
) -> NDArray[np.float64]:
    """New polynomials of the rim: harmonics of the direction times monomials of the field, the significant ones.

    Only the mean and the first three harmonics may change over the field, and the mean rim of the whole field is in
    the profile.
    """
    # 0 for a window or direction without rim.
    weight = residuals.rims[1].ravel()
    angle = np.tile(np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS, len(middle))
    degree = 2 if len(middle) > 2 * count_terms(2) else 0
    field = np.repeat(field_monomials(middle, lattice, degree), DIRECTIONS, axis=0)
    old = np.zeros((1 + 2 * _HARMONICS, count_terms(degree)))
    old[: gain.rim.shape[0], : gain.rim.shape[1]] = gain.rim[:, : old.shape[1]]
    rows = [[0]] + [[2 * k - 1, 2 * k] for k in range(1, _HARMONICS + 1)]
    waves = np.ones((1 + 2 * _HARMONICS, len(angle)))
    for k in range(1, _HARMONICS + 1):
        waves[2 * k - 1], waves[2 * k] = np.cos(k * angle), np.sin(k * angle)
    where = [
        [(row, c) for row in pair for c in range(field.shape[1] if k <= 3 else 1) if (row, c) != (0, 0)]
        for k, pair in enumerate(rows)
    ]
    where = [cells for cells in where if cells]
    blocks = [np.column_stack([waves[row] * field[:, c] for row, c in cells]) for cells in where]
    # What the map holds already is fitted again, so that its significance is tested again.
    target = residuals.rims[0].ravel() / np.maximum(weight, 1e-30)
    for block, cells in zip(blocks, where, strict=True):
        target = target + block @ np.array([old[cell] for cell in cells])
    rim = np.zeros_like(old)
    factors = _fit_significant(blocks, np.where(weight > 0, target, 0.0), weight)
    for values, cells in zip(factors, where, strict=True):
        for value, cell in zip(values, cells, strict=True):
            rim[cell] = value
    last = int(np.flatnonzero(rim.any(1)).max(initial=0) + 1) // 2
    return rim[: 1 + 2 * last]


def _fit_cut(residuals: GainResiduals, gain: GainMap) -> NDArray[np.float64]:
    """One Gauss-Newton step of the cutting disc."""
    normal = residuals.cut_normal.sum(0)
    normal += np.tril(normal, -1).T
    normal += 1e-6 * np.trace(normal) * np.eye(5) + 1e-12 * np.eye(5)
    radius, soft = gain.cut[3:]
    # Steps beyond the range of the linear model are shortened.
    most = np.array([1, 1, 1, 1, 0.3]) * soft
    cut = gain.cut + np.clip(np.linalg.solve(normal, residuals.cut_right.sum(0)), -most, most)
    cut[3], cut[4] = max(cut[3], 0.3 * radius), np.clip(cut[4], 0.2, 0.2 + 0.1 * radius)
    return cut


def _fit_shading(
    residuals: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice
) -> NDArray[np.float64]:
    """New polynomials of the shading: least squares on the normal equations of all windows."""
    windows = len(middle)
    degree = next((d for d in (3, 1) if windows > 2 * count_terms(d)), 0)
    field = field_monomials(middle, lattice, degree)
    shading = np.zeros((5, field.shape[1]))
    shading[:, : gain.shading.shape[1]] = gain.shading[:, : field.shape[1]]
    # The light of a window is eliminated (Schur complement); the mean curvature is in the profile.
    whole = residuals.normal + np.tril(residuals.normal, -1).transpose(0, 2, 1)
    own = np.maximum(whole[:, 5, 5], 1e-30)
    mixed = whole[:, :5, 5]
    normal = whole[:, :5, :5] - mixed[:, :, None] * mixed[:, None, :] / own[:, None, None]
    right = residuals.right[:, :5] - mixed * (residuals.right[:, 5] / own)[:, None]
    cells = [(row, c) for row in range(5) for c in range(field.shape[1] if row < 2 else min(6, field.shape[1]))]
    design = np.zeros((windows, 5, len(cells)))
    for k, (row, c) in enumerate(cells):
        design[:, row, k] = field[:, c]
    curvature = np.array([1.0 * (cell in ((2, 0), (4, 0))) for cell in cells])
    matrix = np.einsum("wap,wab,wbq->pq", design, normal, design, optimize=True)
    ridge = (1e-9 * np.trace(matrix) + 1e-12) * np.eye(len(cells))
    matrix += np.outer(curvature, curvature) * np.trace(matrix) + ridge
    change = np.linalg.solve(matrix, np.einsum("wap,wa->p", design, right))
    for value, cell in zip(change, cells, strict=True):
        shading[cell] += value
    return shading
