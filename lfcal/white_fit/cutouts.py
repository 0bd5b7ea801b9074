"""Windows of the flat around evenly chosen lenses, with first gains, profile and weights."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..images.stack import clipping_level
from ..lattice.cell import cell_inradius, cell_normals
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_mask
from ..lattice.lit_lenses import LitLenses
from ..runtime.errors import CalibrationError
from ..runtime.kernels.jit import kernel
from .edge_profile import find_edge
from .gauss_newton import FitState, median_by_brightness, update_positions, update_weights
from .model import WhiteModel
from .normal_equations import Microimages, mean_profile
from .settings import FIT, PIXELS
from .shading import field_slope, fit_gain_slope, fit_shade
from .two_discs import remove_neighbours

__all__ = ["cut_out_lenses", "cut_windows"]


def cut_out_lenses(
    tones: StackedCrops,
    model: WhiteModel,
    pixels: float,
    fewest: int,
    known: Microimages | None,
    before: LitLenses | None = None,
) -> tuple[FitState, LitLenses]:
    """Cut evenly spread lenses out of a flat, and find all lenses that could be chosen.

    Chosen are about as many as have so many `pixels`, but not fewer than `fewest`. Profile and weights are those of
    `known` lenses of about this model, or the mean profile. Lenses found `before` on nearly the same lattice save the
    search.
    """
    lattice = model.lattice
    normals, reach = cell_normals(lattice)
    margin = reach + 2
    lit = LitLenses.find(tones, lattice, margin, np.sqrt(PIXELS.dark), before)
    every = max(1.0, len(lit.indices) * abs(np.linalg.det(lattice.basis)) / pixels)
    every = max(1.0, min(every, len(lit.indices) / fewest))
    taken = lit.select(tones, lattice, margin, sample_mask(len(lit.indices), 1 / every))
    indices, offset = taken.indices, tones.offsets[taken.crop]
    centres = lattice.points(indices)
    # Lenses of a known model hardly move any more.
    light, corners = cut_windows(tones.picture, centres - offset, margin if known is None else reach)
    corners += offset
    inradius = cell_inradius(normals)
    core, middle = max(1, int(PIXELS.core * inradius)), light.shape[1] // 2
    gain = light[:, middle - core : middle + core + 1, middle - core : middle + core + 1].mean((1, 2)).astype(float)
    bright = gain > PIXELS.dark * np.quantile(gain, 0.95) if len(gain) else np.zeros(0, dtype=bool)
    if bright.sum() < FIT.fewest_lenses:
        raise CalibrationError(
            f"only {bright.sum()} whole microimages of {lattice.pitch:.1f} px pitch are lit on the flat, "
            f"at least {FIT.fewest_lenses} are needed; give the whole sensor"
        )
    rings = int(reach / PIXELS.ring_step) + 3
    saturation = clipping_level(light) if known is None else known.saturation
    if not bright.all():
        indices, centres, gain = indices[bright], centres[bright], gain[bright]
        corners, light = corners[bright], light[bright]
    none, slope = np.zeros_like(centres), fit_gain_slope(centres, gain, lattice)
    lenses = Microimages(
        light, corners, centres, none, gain, np.ones(len(gain)), slope, np.zeros_like(slope), 0.0, 0.0, 0.0,
        normals, inradius, reach, PIXELS.ring_step, np.zeros(rings), np.ones(rings),
        np.zeros(rings), np.zeros(rings, dtype=bool), 0.0, 0.0, saturation,
    )  # fmt: skip
    if known is None:
        profile = mean_profile(lenses)
        weight = np.full(rings, 1 / max(float(np.var(profile)), 1e-12))
        lenses = replace(lenses, profile=profile, ring_weight=weight, edge=find_edge(profile))
        state = update_positions(FitState(model, indices, lenses))
        return update_weights(state, state.lenses.equations), lit
    lenses = replace(
        lenses,
        profile=_resize(known.profile, rings),
        ring_weight=_resize(known.ring_weight, rings),
        harmonic=_resize(known.harmonic, rings),
        edge=_resize(known.edge, rings),
        correlation=known.correlation,
        gap=known.gap,
    )
    if model.cat_eye is None and not np.isfinite(saturation):
        return FitState(model, indices, _scale_gains(lenses, known, core, lattice)), lit
    # Cores may be cut or clipped: gains come from all pixels of a lens.
    state = update_positions(FitState(model, indices, lenses))
    equations = state.lenses.equations
    own = np.clip(equations.right[:, -1] / np.maximum(equations.normal[:, -1, -1], 1e-30), -0.5, 1)
    state = replace(state, lenses=replace(state.lenses, gain=state.lenses.gain * (1 + own)))
    if model.discs is not None:
        state = replace(state, lenses=remove_neighbours(state.lenses, model))
    return update_weights(state, equations), lit


def _scale_gains(lenses: Microimages, known: Microimages, core: int, lattice: Lattice) -> Microimages:
    """The lenses with gains in the scale of the known profile, and weights that known ones of this gain have."""
    square = np.arange(-core, core + 1)
    radii = np.hypot(*np.meshgrid(square, square))
    light = float(np.interp(radii, np.arange(len(lenses.profile)) * lenses.step, lenses.profile).mean())
    gain = lenses.gain / max(light, 1e-12)
    weight = np.interp(gain, *median_by_brightness(known.gain, known.lens_weight))
    lenses = replace(lenses, gain=gain, lens_weight=weight)
    lenses = replace(lenses, slope=field_slope(lenses, lattice))
    return replace(lenses, shade=fit_shade(lenses, lattice))


def _resize(values: NDArray[Any], rings: int) -> NDArray[Any]:
    """Values over the radius for so many rings, the last one repeated: cells grow as their lattice is refined."""
    return np.pad(values, (0, max(rings - len(values), 0)), mode="edge")[:rings]


@kernel(share=lambda tones, corners, *_: len(corners))
def _copy_squares(begin, end, tones, corners, out):
    side = out.shape[1]
    height, width = tones.shape
    for lens in range(begin, end):
        left, top = corners[lens, 0], corners[lens, 1]
        if left >= 0 and top >= 0 and left + side <= width and top + side <= height:
            # Unsigned indices need no test for wrap-around, so that several pixels are moved at once.
            first = np.uintp(left)
            for y in range(side):
                row, line = tones[top + y], out[lens, y]
                for x in range(np.uintp(side)):
                    value = row[first + x]
                    line[x] = value * value
            continue
        for y in range(side):
            row = min(max(top + y, 0), height - 1)
            for x in range(side):
                value = tones[row, min(max(left + x, 0), width - 1)]
                out[lens, y, x] = value * value


def cut_windows(
    tones: NDArray[np.float32], centres: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Squares of light (n, k, k) reaching at least `reach` px from `centres` (n, 2), and their first pixels (n, 2).

    `tones` (h, w) is the square root of the light. Pixels beyond the flat repeat its border.
    """
    half = int(np.ceil(reach)) + 1
    corners = np.rint(centres).astype(np.int64) - half
    light = np.empty((len(centres), 2 * half + 1, 2 * half + 1), np.float32)
    _copy_squares(tones, corners, light)
    return light, corners
