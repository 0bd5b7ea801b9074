"""Estimate a gain map: the common shape of the microimages of a flat and its changes over the field.

The pixels of a sample of lenses are compared with the current map. Their residuals, summed over the distance to the
centre, correct the profile; over the direction, the rim; over the place in the microimage, the shading. Low-order
polynomials of the field follow them if significant (least squares).

On a white image a lens has one unknown, its light. On a scene capture a plane is fitted to its inner part, and lenses
that are no plane have little weight. That suffices for the rims; the profile itself is taken from sums over many lenses
(`scene_profile`). The light of single lenses cannot be measured from scenes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, count_terms, field_frame
from ..lattice.cell import cell_inradius, cell_normals
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..white_fit.cat_eye import CatEye
from .residuals import GainResiduals, ResidualOptions, collect_residuals
from .rim_fit import fit_best_rim
from .sample import Sample, draw_sample
from .scene_profile import fit_scene_profile
from .settings import DEFAULT, KERNEL, EstimateSettings

__all__ = ["GainFit", "estimate_gain", "field_monomials"]


@dataclass(frozen=True)
class GainFit:
    """A gain map without the light of single lenses, and its noise.

    Parameters
    ----------
    gain : GainMap
    spread : (k,) float64
        Standard deviation of pixels from the map at the distances of its profile, as a share of the light of a lens.
    windows : (b, a) float64
        Factor of `spread` in parts of the field, rows from the top.
    """

    gain: GainMap
    spread: NDArray[np.float64]
    windows: NDArray[np.float64]


def estimate_gain(
    picture: NDArray[np.float32] | StackedCrops, lattice: Lattice, scene: bool, cat_eye: CatEye | None = None,
    settings: EstimateSettings = DEFAULT,
) -> GainFit:  # fmt: skip
    """Estimate the shape of the microimages of a flat.

    Parameters
    ----------
    picture : (h, w) float32, or crops of such a white image
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    scene : bool
        Whether the flat is a scene capture, not a white image.
    cat_eye : CatEye or None
        The cutting disc if known.
    settings : EstimateSettings
    """
    crops = StackedCrops.of(picture)
    picture = crops.picture
    sample = draw_sample(lattice, settings.scene_pixels if scene else settings.white_pixels, crops)
    middles = sample.middle
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    rings = int(cell_normals(lattice)[1] / settings.step) + 3
    cut: tuple[float, ...] = ()
    if cat_eye is not None:
        cut = (*cat_eye.shift, cat_eye.growth, cat_eye.radius, cat_eye.blur)
    gain = GainMap.round(np.ones(rings), settings.step, limit, cut)
    core = (settings.scene_core if scene else settings.white_core) * limit
    # A white image can be as even as if it were clipped.
    brightest = settings.clipped * float(picture.max()) ** 2 if scene else math.inf
    spread, windows = np.full(rings, np.inf), np.ones(len(sample.first) - 1)

    def collect(every: int, sectors: bool = False, terms: bool = True) -> GainResiduals:
        largest = settings.outlier * spread * windows[:, None]
        few = sample if scene or sectors else sample.thin(every)
        options = ResidualOptions(core, scene, brightest, largest**2, terms)
        return collect_residuals(picture, lattice, gain, few, options, sectors)

    for turn in range(settings.profile_passes):
        last = turn == settings.profile_passes - 1
        residuals = collect(settings.profile_every, sectors=cat_eye is None and last, terms=False)
        gain = _correct_profile(gain, residuals)
    if cat_eye is None:
        gain = _find_cut(gain, residuals, sample, lattice)
    for turn in range(settings.field_passes):
        every = 1 if turn == settings.field_passes - 1 else settings.first_every
        residuals = collect(every)
        gain = replace(gain, rim=_fit_rim(residuals, gain, middles, lattice, settings))
        if not scene:
            gain = replace(gain, shading=_fit_shading(residuals, gain, middles, lattice, settings.shading_degree))
        gain = _correct_profile(gain, residuals)
        spread, windows = _estimate_noise(residuals)
        if len(gain.cut):
            # From new residuals: where the two rims coincide, both would else be moved to correct the same error.
            gain = replace(gain, cut=_fit_cut(collect(every), gain))
    if scene:
        gain = replace(gain, profile=fit_scene_profile(picture, lattice, gain, brightest))
    return GainFit(gain, spread, windows.reshape(sample.shape))


def _find_cut(gain: GainMap, residuals: GainResiduals, sample: Sample, lattice: Lattice) -> GainMap:
    """The map with a cutting disc if the rims, by area in each direction, fit one; else the map itself."""
    inner = cell_inradius(cell_normals(lattice)[0])
    stray = gain.stray_light
    bright = np.flatnonzero(gain.profile > 0.5 * (1 + stray))
    if len(bright) == 0 or bright[-1] >= len(gain.profile) - 2:
        return gain
    edge = float(bright[-1]) * gain.step
    # Light just inside the rim, which a cut takes away.
    height = float(np.interp(0.85 * edge, np.arange(len(gain.profile)) * gain.step, gain.profile)) - stray
    excess, area = residuals.sector[..., 0], residuals.sector[..., 1]
    square = edge**2 + excess * inner**2 / np.maximum(area * height, 1e-9)
    frame = field_frame(lattice)
    field = (sample.middle - frame[:2]) / frame[2]
    found = fit_best_rim(np.sqrt(np.maximum(square, (0.2 * edge) ** 2)), area, field)
    if found is None:
        return gain
    rim = np.zeros((3, 3))
    rim[1, 1] = rim[2, 2] = found.lattice_growth
    soft = max(0.35, 0.3 * gain.step)
    return replace(gain, rim=rim, cut=np.array([*found.shift, found.growth, found.radius, soft]))


def _estimate_noise(residuals: GainResiduals) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard deviation over the distance to the centre, and its factor in each window of the field."""
    smooth = np.ones(5)
    square, count = residuals.rings[2].sum(0), residuals.rings[3].sum(0)
    overall = square.sum() / max(count.sum(), 1e-12)
    few = max(1e-4 * count.sum(), 1e-12)
    near = (np.convolve(square, smooth, "same") + few * overall) / (np.convolve(count, smooth, "same") + few)
    expected = (residuals.rings[3] * near).sum(1)
    windows = np.where(expected > 0, residuals.rings[2].sum(1) / np.maximum(expected, 1e-300), 1.0)
    return np.sqrt(np.maximum(near, 1e-12)), np.sqrt(np.maximum(windows, 1e-3))


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
    # Each degree from the one before: powers take far longer.
    table = np.empty((len(x), count_terms(degree)))
    table[:, 0] = 1.0
    for d in range(1, degree + 1):
        start, before = count_terms(d - 1), count_terms(d - 2)
        table[:, start : start + d] = table[:, before:start] * x[:, None]
        table[:, start + d] = table[:, start - 1] * y
    return table


def _fit_significant(
    blocks: list[NDArray[np.float64]], target: NDArray[np.float64], weight: NDArray[np.float64],
    settings: EstimateSettings,
) -> list[NDArray[np.float64]]:  # fmt: skip
    """Weighted least-squares factors of the columns of each block, all zero for insignificant or irrelevant blocks."""
    table = np.hstack(blocks)
    root = np.sqrt(weight)[:, None]
    usable = int((weight > 0).sum())
    if usable <= 2 * table.shape[1]:
        return [np.zeros(b.shape[1]) for b in blocks]
    ends = np.cumsum([0] + [b.shape[1] for b in blocks])
    keep = np.ones(len(blocks), dtype=bool)
    factors = np.zeros(table.shape[1])
    for _ in range(2):
        columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in np.flatnonzero(keep)] or [np.zeros(0, int)])
        factors[:] = 0
        if len(columns) == 0:
            break
        weighted = root * table[:, columns]
        covariance = np.linalg.pinv(weighted.T @ weighted, rcond=1e-10)
        factors[columns] = covariance @ (weighted.T @ (root[:, 0] * target))
        miss = root[:, 0] * (target - table @ factors)
        covariance *= float(miss @ miss) / (usable - len(columns))
        place = {int(c): k for k, c in enumerate(columns)}
        for k in np.flatnonzero(keep):
            own = np.arange(ends[k], ends[k + 1])
            at = [place[int(c)] for c in own]
            part = table[:, own] @ factors[own]
            size = math.sqrt(float(weight @ part**2) / float(weight.sum()))
            ratio = factors[own] @ np.linalg.pinv(covariance[np.ix_(at, at)]) @ factors[own] / len(own)
            keep[k] = size > settings.relevance and ratio > settings.significance**2
    return [factors[a:b] for a, b in pairwise(ends)]


def _fit_rim(
    residuals: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice, settings: EstimateSettings
) -> NDArray[np.float64]:
    """New polynomials of the rim: harmonics of the direction times monomials of the field, the significant ones."""
    windows, harmonics = len(middle), settings.harmonics
    # 0 for a window or direction without rim.
    weight = residuals.rims[1].ravel()
    angle = np.tile(np.arange(KERNEL.directions) * 2 * np.pi / KERNEL.directions, windows)
    degree = settings.rim_degree if windows > 2 * count_terms(settings.rim_degree) else 0
    field = np.repeat(field_monomials(middle, lattice, degree), KERNEL.directions, axis=0)
    old = np.zeros((1 + 2 * harmonics, count_terms(degree)))
    old[: gain.rim.shape[0], : gain.rim.shape[1]] = gain.rim[:, : old.shape[1]]
    waves = [np.ones(len(angle))]
    for k in range(1, harmonics + 1):
        waves += [np.cos(k * angle), np.sin(k * angle)]
    target = residuals.rims[0].ravel() / np.maximum(weight, 1e-30)
    rows: list[list[int]] = [[0]] + [[2 * k - 1, 2 * k] for k in range(1, harmonics + 1)]
    blocks, where = [], []
    for k, pair in enumerate(rows):
        # Without the mean rim of the whole field, which the profile holds.
        columns = range(field.shape[1]) if k <= settings.changing_harmonics else range(1)
        cells = [(row, c) for row in pair for c in columns if not (k == 0 and c == 0)]
        if cells:
            blocks.append(np.column_stack([waves[row] * field[:, c] for row, c in cells]))
            where.append(cells)
    # What the map holds already is fitted again, so that its significance is tested again.
    for block, cells in zip(blocks, where, strict=True):
        target = target + block @ np.array([old[cell] for cell in cells])
    factors = _fit_significant(blocks, np.where(weight > 0, target, 0.0), weight, settings)
    rim = np.zeros_like(old)
    for values, cells in zip(factors, where, strict=True):
        for value, cell in zip(values, cells, strict=True):
            rim[cell] = value
    last = max([0] + [k for k in range(1, harmonics + 1) if np.any(rim[2 * k - 1 : 2 * k + 1])])
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
    residuals: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice, degree: int
) -> NDArray[np.float64]:
    """New polynomials of the shading: least squares on the normal equations of all windows."""
    windows = len(middle)
    degree = degree if windows > 2 * count_terms(degree) else 1 if windows > 2 * count_terms(1) else 0
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
    force = np.einsum("wap,wa->p", design, right)
    ridge = (1e-9 * np.trace(matrix) + 1e-12) * np.eye(len(cells))
    matrix += np.outer(curvature, curvature) * np.trace(matrix) + ridge
    change = np.linalg.solve(matrix, force)
    for value, cell in zip(change, cells, strict=True):
        shading[cell] += value
    return shading
