"""Lenses of a white image that a fit is to look at: chosen evenly, cut out, and given gains and weights."""

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
from .gauss_newton import FitState, median_by_brightness, update_positions, update_weights
from .model import WhiteModel
from .normal_equations import Microimages, find_edge, mean_profile
from .shading import fit_field_slope, fit_shading_slope
from .windows import cut_windows

__all__ = ["FEWEST_LENSES", "cut_out_lenses"]

FEWEST_LENSES = 12
# Distance between samples of the profile [px]: edges of discs are about one pixel wide.
_STEP = 0.125
# A microimage darker than this share of a bright one is none: the array does not fill the sensor.
_DARK = 0.03
# Side of the square in the middle of a microimage that tells its light, over the diameter inside its cell.
_CORE = 0.4


def cut_out_lenses(
    tones: StackedCrops,
    model: WhiteModel,
    pixels: float,
    fewest: int,
    known: Microimages | None,
    before: LitLenses | None = None,
) -> tuple[FitState, LitLenses]:
    """Lenses of about so many pixels in all, but at least so many, with gains from their cores; and all to choose from.

    `before` are those of a like lattice.
    """
    lattice = model.lattice
    faces, reach = cell_normals(lattice)
    margin = reach + 2
    alight = LitLenses.find(tones, lattice, margin, np.sqrt(_DARK), before)
    every = max(1.0, len(alight.indices) * abs(np.linalg.det(lattice.basis)) / pixels)
    every = max(1.0, min(every, len(alight.indices) / fewest))
    taken = alight.select(tones, lattice, margin, sample_mask(len(alight.indices), 1 / every))
    indices, offset = taken.indices, tones.offsets[taken.part]
    centres = lattice.points(indices)
    # Lenses of a known model hardly move any more.
    light, corners = cut_windows(tones.picture, centres - offset, margin if known is None else reach)
    corners += offset
    inner = cell_inradius(faces)
    core, middle = max(1, int(_CORE * inner)), light.shape[1] // 2
    gain = light[:, middle - core : middle + core + 1, middle - core : middle + core + 1].mean((1, 2)).astype(float)
    lit = gain > _DARK * np.quantile(gain, 0.95) if len(gain) else np.zeros(0, dtype=bool)
    if lit.sum() < FEWEST_LENSES:
        raise CalibrationError(
            f"only {lit.sum()} whole microimages of {lattice.pitch:.1f} px pitch are lit on the flat, "
            f"at least {FEWEST_LENSES} are needed; give the whole sensor"
        )
    rings, full = int(reach / _STEP) + 3, clipping_level(light) if known is None else known.full
    if not lit.all():
        indices, centres, gain, corners, light = indices[lit], centres[lit], gain[lit], corners[lit], light[lit]
    none, tilt = np.zeros_like(centres), fit_field_slope(centres, gain, lattice)
    discs = Microimages(
        light, corners, centres, none, gain, np.ones(len(gain)), tilt, 0.0, 0.0,
        faces, inner, reach, _STEP, np.zeros(rings), np.ones(rings),
        np.zeros(rings), np.zeros(rings, dtype=bool), 0.0, 0.0, full,
    )  # fmt: skip
    if known is None:
        level = mean_profile(discs)
        discs = replace(
            discs, level=level, weight=np.full(rings, 1 / max(float(np.var(level)), 1e-12)), edge=find_edge(level)
        )
        state = update_positions(FitState(model, indices, discs))
        return update_weights(state, state.discs.steps), alight
    discs = replace(
        discs,
        level=_of_length(known.level, rings),
        weight=_of_length(known.weight, rings),
        four=_of_length(known.four, rings),
        edge=_of_length(known.edge, rings),
        shared=known.shared,
        dark=known.dark,
    )
    if model.cat_eye is None and not np.isfinite(full):
        return FitState(model, indices, _alike(discs, known, core, lattice)), alight
    # Profile and gains share a scale that the new gains settle: cores may be cut, or clipped.
    state = update_positions(FitState(model, indices, discs))
    steps = state.discs.steps
    own = np.clip(steps.right[:, -1] / np.maximum(steps.normal[:, -1, -1], 1e-30), -0.5, 1)
    state = replace(state, discs=replace(state.discs, gain=state.discs.gain * (1 + own)))
    return update_weights(state, steps), alight


def _alike(discs: Microimages, known: Microimages, core: int, lattice: Lattice) -> Microimages:
    """The discs with gains in the scale of the known profile, and with the trust known ones of their light have."""
    square = np.arange(-core, core + 1)
    radii = np.hypot(*np.meshgrid(square, square))
    light = float(np.interp(radii, np.arange(len(discs.level)) * discs.step, discs.level).mean())
    gain = discs.gain / max(light, 1e-12)
    discs = replace(discs, gain=gain, trust=np.interp(gain, *median_by_brightness(known.gain, known.trust)))
    return replace(discs, tilt=fit_shading_slope(discs, lattice))


def _of_length(values: NDArray[Any], rings: int) -> NDArray[Any]:
    """Values over the radius for so many rings, the last one carried on: cells grow as their lattice is refined."""
    return np.pad(values, (0, max(rings - len(values), 0)), mode="edge")[:rings]
