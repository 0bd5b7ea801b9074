"""Cutting discs to start a fit from, as the rims of microimages in parts of the field show them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.cell import clip_rows
from .gauss_newton import FitState
from .model import CatEye, WhiteModel, field_position
from .normal_equations import Microimages
from .rim_fit import RimFit, fit_rims

__all__ = ["disc_radius", "initial_cuts"]

# Columns and rows of parts of the field, and directions, in which rims are measured.
_PARTS, _DIRECTIONS = (8, 6), 24
# Another cut that leaves this multiple of what the best one leaves over, or less, may be the right one.
_RIVAL = 1.05
# A microimage is even in its middle and darker outwards in this share of its radius; its light may fall to half of that
# in the middle at the side of the cell.
_EVEN, _FALLS = 0.5, 0.5
# Light in a direction counts as no less than this share of a full one.
_LEAST = 0.04
# Blur of the edge of a disc to start with [px].
_SOFT = 0.5


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _left_over(light, corners, centres, gain, tilt, level, inner, step, out):
    """What the light of lenses is more than their profile, into `out` (n, directions, 2), and pixels there."""
    directions = out.shape[1]
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        top, bottom = clip_rows(cy, inner, 0, light.shape[1])
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(inner * inner - dy * dy, 0.0)), 0, light.shape[1])
            for x in range(first, last):
                dx = x - cx
                place = math.sqrt(dx * dx + dy * dy) / step
                ring = int(place)
                model = level[ring] + (level[ring + 1] - level[ring]) * (place - ring)
                more = light[lens, y, x] / (gain[lens] * (1 + tilt[lens, 0] * dx + tilt[lens, 1] * dy)) - model
                # Hot pixels are no rim.
                more = min(max(more, -1.0), 1.0)
                turn = (math.atan2(dy, dx) / (2 * math.pi)) % 1.0 * directions
                before = int(turn)
                share = turn - before
                after = (before + 1) % directions
                before %= directions
                out[lens, before, 0] += (1 - share) * more
                out[lens, before, 1] += 1 - share
                out[lens, after, 0] += share * more
                out[lens, after, 1] += share


def _rims(state: FitState) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Distances of rims (n, d) [px], pixels they rest on and places (n, 2) in the field, of a fit without a cut.

    None where the profile has no fall that a rim could be told by, as where the gaps are clipped too.
    """
    discs, lattice = state.discs, state.model.lattice
    field = field_position(discs.centres, lattice)
    share = (discs.centres + 0.5) / np.array(lattice.image_size) * _PARTS
    column, row = np.clip(share.astype(int), 0, np.array(_PARTS) - 1).T
    part, parts = row * _PARTS[0] + column, _PARTS[0] * _PARTS[1]
    single, out = np.zeros((len(field), _DIRECTIONS, 2)), np.zeros((parts, _DIRECTIONS, 2))
    _left_over(
        discs.light, discs.corners, discs.centres, discs.gain, discs.tilt, discs.level, discs.inner, discs.step, single
    )
    np.add.at(out, part, single)
    number = np.maximum(np.bincount(part, minlength=parts), 1)
    middle = np.column_stack([np.bincount(part, field[:, axis], parts) / number for axis in (0, 1)])
    square = discs.inner**2
    radii = np.arange(int(discs.inner / discs.step) + 1) * discs.step
    profile = discs.level[: len(radii)] - discs.dark
    even = radii < _EVEN * disc_radius(discs)
    table = np.column_stack([np.ones(even.sum()), radii[even] ** 2 / square]) * np.sqrt(radii[even])[:, None]
    bright, falls = np.linalg.lstsq(table, profile[even] * np.sqrt(radii[even]), rcond=None)[0].tolist()
    if not bright > 0:
        return None
    falls = min(max(-falls / bright, 1e-6), _FALLS)
    # The light of a direction up to the side of the cell, as a share of an even one without a rim.
    full = 2 * float(np.trapezoid(profile * radii, radii)) / square
    lit = (full + out[..., 0] / np.maximum(out[..., 1], 1e-9)) / bright
    lit = np.clip(lit, _LEAST, None)
    return np.sqrt(square * (1 - np.sqrt(np.maximum(1 - 2 * falls * lit, 0))) / falls), out[..., 1], middle


def disc_radius(discs: Microimages) -> float:
    """Distance from the centre [px] at which the profile falls through the middle between disc and gap."""
    level = discs.level
    half = 0.5 * (float(np.median(level[: max(2, len(level) // 2)])) + discs.dark)
    return max(int(np.argmax(level < half)), 1) * discs.step


def initial_cuts(plain: FitState) -> list[tuple[WhiteModel, WhiteModel]]:
    """Models with a cut to start from, the likeliest first, and the same with microimage and cut in each other's place.

    Of the two the first one has the larger disc as the cut.
    """
    rims = _rims(plain)
    if rims is None:
        return []
    found = fit_rims(*rims)
    return [_models(plain.model, cut) for cut in found if cut.left <= _RIVAL * found[0].left]


def _models(plain: WhiteModel, cut: RimFit) -> tuple[WhiteModel, WhiteModel]:
    none = np.zeros(2)
    one = _model(plain, cut.own, none, CatEye(cut.shift, np.array([cut.growth - cut.own, 0, 0]), cut.radius, _SOFT))
    other = _model(
        plain, cut.growth, cut.shift, CatEye(-cut.shift, np.array([cut.own - cut.growth, 0, 0]), cut.whole, _SOFT)
    )
    return (one, other) if cut.radius >= cut.whole else (other, one)


def _model(plain: WhiteModel, grown: float, shift: NDArray[np.float64], eye: CatEye) -> WhiteModel:
    """The model with centres moved by `shift`, and outwards by so many px in the corners."""
    lattice = plain.lattice
    middle, reach = (np.array(lattice.image_size) - 1) / 2, float(np.hypot(*lattice.image_size) / 2)
    scale = 1 + grown / reach
    origin = middle + (lattice.origin - middle) * scale + shift
    return WhiteModel(replace(lattice, origin=origin, basis=lattice.basis * scale), eye)
