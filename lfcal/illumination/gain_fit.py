"""Measure a gain map: the shape microimages have in common and how it changes over the field.

The pixels of a sample of lenses are compared with the map as it is so far. What is left over is collected over the
distance to the centre (profile), over windows of the field and directions (rim), and over windows and place in the
microimage (shading); low-order polynomials of the field follow it where it is significant.

On a white image a lens has one unknown, its light. On a scene capture it shows something: a plane is fitted to its
inner part, and lenses that are no plane there count for little. That tells where rims lie; the profile itself is
taken from sums over many lenses (`fit_scene_profile`). Scenes say nothing about the light of lenses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, field_frame
from ..lattice.cell import cell_inradius, cell_normals
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..white_fit.model import CatEye
from ..white_fit.rim_fit import fit_best_rim
from .gain_terms import cut_terms, rim_terms, shade_terms
from .residuals import OUTLIER, GainResiduals, Sample, collect_residuals, draw_sample
from .scene_profile import fit_scene_profile

__all__ = ["GainFit", "fit_gain"]

_STEP = 0.25
# Pixels compared in one pass over a white image or a scene: the shape has a few hundred unknowns.
_PIXELS, _SCENE_PIXELS = 2.5e5, 3e5
# First passes measure the profile alone, the others also what changes over direction and field.
_PASSES = (2, 2)
# Every so many lenses of a white image tell its profile, and what the last pass begins with.
_PROFILE, _FIRST = 4, 2
# Inner part of a microimage, in half distances to the neighbour, in which the light of a lens is measured: of white
# images, and of scenes.
_CORE, _SCENE_CORE = 0.5, 0.6


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


def fit_gain(
    picture: NDArray[np.float32] | StackedCrops, lattice: Lattice, scene: bool, cat_eye: CatEye | None = None
) -> GainFit:
    """Shape of the microimages of a flat.

    Parameters
    ----------
    picture : (h, w) float32, or of a white image parts of such
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    scene : bool
        Whether lenses show something.
    cat_eye : CatEye or None
        The cutting disc where one is known.
    """
    parts = StackedCrops.of(picture)
    picture = parts.picture
    sample = draw_sample(lattice, _SCENE_PIXELS if scene else _PIXELS, parts)
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    rings = int(cell_normals(lattice)[1] / _STEP) + 3
    cut: tuple[float, ...] = ()
    if cat_eye is not None:
        cut = (*cat_eye.shift, cat_eye.growth.sum(), cat_eye.radius, cat_eye.soft)
    gain = GainMap.round(np.ones(rings), _STEP, limit, cut)
    core = (_SCENE_CORE if scene else _CORE) * limit
    # A white image may well be as even as if it were clipped.
    brightest = 0.995 * float(picture.max()) ** 2 if scene else math.inf
    spread, windows = np.full(rings, np.inf), np.ones(len(sample.first) - 1)

    def left_over(every: int, sectors: bool = False, terms: bool = True) -> GainResiduals:
        limit = OUTLIER * spread * windows[:, None]
        few = sample if scene or sectors else sample.some(every)
        return collect_residuals(picture, lattice, gain, few, core, scene, brightest, limit, sectors, terms)

    for turn in range(_PASSES[0]):
        left = left_over(_PROFILE, sectors=cat_eye is None and turn == _PASSES[0] - 1, terms=False)
        gain = _scaled(gain, left)
    if cat_eye is None:
        gain = _with_cut(gain, left, sample, lattice)
    for turn in range(_PASSES[1]):
        every = 1 if turn == _PASSES[1] - 1 else _FIRST
        left = left_over(every)
        gain = replace(gain, rim=rim_terms(left, gain, sample.middle, lattice))
        if not scene:
            gain = replace(gain, shading=shade_terms(left, gain, sample.middle, lattice))
        gain = _scaled(gain, left)
        spread, windows = _noise(left)
        if len(gain.cut):
            # Where the two rims lie upon each other, both at once would be moved twice as far as they have to.
            gain = replace(gain, cut=cut_terms(left_over(every), gain))
    if scene:
        gain = replace(gain, profile=fit_scene_profile(picture, lattice, gain, brightest))
    return GainFit(gain, spread, windows.reshape(sample.shape))


def _with_cut(gain: GainMap, left: GainResiduals, sample: Sample, lattice: Lattice) -> GainMap:
    """The map with a cutting disc where rims are as such a disc leaves them, else as it is."""
    faces = cell_normals(lattice)[0]
    inner = cell_inradius(faces)
    dark = gain.dark
    bright = np.flatnonzero(gain.profile > 0.5 * (1 + dark))
    if len(bright) == 0 or bright[-1] >= len(gain.profile) - 2:
        return gain
    edge = float(bright[-1]) * gain.step
    # Light just inside the rim, where a cut takes it away.
    height = float(np.interp(0.85 * edge, np.arange(len(gain.profile)) * gain.step, gain.profile)) - dark
    excess, area = left.sector[..., 0], left.sector[..., 1]
    square = edge**2 + excess * inner**2 / np.maximum(area * height, 1e-9)
    field = (sample.middle - field_frame(lattice)[:2]) / field_frame(lattice)[2]
    found = fit_best_rim(np.sqrt(np.maximum(square, (0.2 * edge) ** 2)), area, field)
    if found is None:
        return gain
    rim = np.zeros((3, 3))
    rim[1, 1] = rim[2, 2] = found.own
    soft = max(0.35, 0.3 * gain.step)
    return replace(gain, rim=rim, cut=np.array([*found.shift, found.growth, found.radius, soft]))


def _noise(left: GainResiduals) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard deviation over the distance to the centre, and its factor in each window of the field."""
    smooth = np.ones(5)
    square, count = left.ring_square.sum(0), left.ring_count.sum(0)
    overall = square.sum() / max(count.sum(), 1e-12)
    few = max(1e-4 * count.sum(), 1e-12)
    near = (np.convolve(square, smooth, "same") + few * overall) / (np.convolve(count, smooth, "same") + few)
    expected = (left.ring_count * near).sum(1)
    windows = np.where(expected > 0, left.ring_square.sum(1) / np.maximum(expected, 1e-300), 1.0)
    return np.sqrt(np.maximum(near, 1e-12)), np.sqrt(np.maximum(windows, 1e-3))


def _scaled(gain: GainMap, left: GainResiduals) -> GainMap:
    """The map with its profile corrected, brightest 1, and the light in the gaps."""
    smooth = np.convolve(np.pad(left.profile, 2, "edge"), np.ones(5) / 5, "valid")
    inner = np.arange(len(smooth)) * gain.step < gain.radius
    brightest = max(float(smooth[inner].max()), 1e-9)
    return replace(gain, profile=left.profile / brightest, dark=left.dark / brightest)
