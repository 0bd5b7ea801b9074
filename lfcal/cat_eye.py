"""Search for the disc that cuts microimages to lens shapes (cat-eye, mechanical vignetting)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .disc_model import Discs, edge_of
from .disc_newton import FitState, converge, few_of, misfit, placed, with_profile
from .disc_parameters import CatEye, DiscModel, field_of
from .errors import CalibrationError
from .lens_cell import rows_within

__all__ = ["settled_roles", "with_cut", "without_idle_cut"]

# A cutting disc must lower the misfit by this share and reach into microimages by so many px.
_CUT_GAIN = 0.005
_CUT_DEPTH = 0.3
# Misfits that differ by the square of so many standard errors are told apart.
_SURE = 8.0
# Cut microimages are narrower along the field by so many px at least, in the second harmonic of their edge (a cut of
# a pixel has twenty times this), and by so many standard errors.
_NARROW, _CERTAIN = 0.01, 6.0
# Shading is judged so many times the blur of an edge inside of it, on about so many pixels, at least on so many, and
# without those so many standard deviations off.
_DEPTH = 2.0
_SHADED_PIXELS, _FEWEST_SHADED = 2e6, 500
_FAR = 6.0
# Displacements in the corner and radii, both in radii of the microimage, at which cutting discs are looked for, and
# the part of the displacement by which the lattice found without it follows; the best few are tried to the end.
_GROWTHS = (-0.6, -0.4, -0.25, -0.12, 0.12, 0.25, 0.4, 0.6)
_RADII = (1.0, 1.1, 1.25)
_FOLLOWED = (0.25, 0.5)
_STARTS = 3
# So many lenses, and about so many pixels, are enough to choose the starts.
_SCOUTS, _SCOUT_PIXELS = (40, 100), 3e4


def with_cut(plain: FitState, rival: FitState, orders: tuple[str, ...]) -> FitState:
    """`plain` with the best of a few cutting discs, or without where none fits clearly better than it and a rival.

    Parameters
    ----------
    plain : FitState
        Converged without a cut.
    rival : FitState
        Another explanation, such as a distortion.
    orders : tuple of str
        Parameters of `plain`, as in `disc_parameters.design`.
    """
    narrow, error = _narrowing(rival)
    if narrow < max(_NARROW, _CERTAIN * error):
        return plain
    found, least = plain, np.inf
    for model in _starts(plain):
        trial = placed(replace(plain, model=model))
        try:
            trial, _ = converge(with_profile(with_profile(trial)[0])[0], orders)
        except (CalibrationError, ValueError):
            continue
        if misfit(trial, plain) < least:
            found, least = trial, misfit(trial, plain)
    if found.model.cat_eye is None:
        return plain
    # A disc that stays outside the microimages cuts nothing.
    depth = _radius(found.discs) + np.hypot(*found.discs.cut.T).max() - found.model.cat_eye.radius
    better = least < (1 - _CUT_GAIN) * min(misfit(plain, plain), misfit(rival, plain))
    return found if better and depth > _CUT_DEPTH else plain


def _narrowing(state: FitState) -> tuple[float, float]:
    """By how much microimages in the corners of the field are narrower along the field than across, and its error [px].

    Amplitude of `cos(2 * angle)` of the radius, angles from the direction of the field, growing with the field: neither
    a lattice nor its distortion, neither blur nor the shape of pixels give whole discs any.
    """
    discs = state.discs
    tables = np.column_stack([discs.level, np.gradient(discs.level, discs.step), discs.four, discs.weight])
    found = np.zeros((len(discs.centres), 2))
    _narrowings(
        discs.light, discs.corners, discs.centres, field_of(discs.centres, state.model.lattice), discs.gain,
        discs.trust, discs.tilt, discs.inner, discs.step, tables, discs.edge, discs.full, found,
    )  # fmt: skip
    force, information = found.sum(0).tolist()
    if information <= 0:
        return 0.0, np.inf
    return force / information, information**-0.5


@njit(cache=True, nogil=True, error_model="numpy")
def _narrowings(light, corners, centres, field, gain, trust, tilt, inner, step, tables, edge, full, out):
    """Per lens (n, 2): force on the amplitude of `_narrowing`, and information about it."""
    for lens in range(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        far = max(math.hypot(field[lens, 0], field[lens, 1]), 1e-6)
        top, bottom = rows_within(cy, inner, 0, light.shape[1])
        for y in range(top, bottom):
            dy = y - cy
            first, last = rows_within(cx, math.sqrt(max(inner * inner - dy * dy, 0.0)), 0, light.shape[1])
            for x in range(first, last):
                dx = x - cx
                rho = max(math.sqrt(dx * dx + dy * dy), 1e-6)
                place = rho / step
                ring = int(place)
                if not edge[ring] or light[lens, y, x] >= full:
                    continue
                part = place - ring
                level = tables[ring, 0] * (1 - part) + tables[ring + 1, 0] * part
                slope = tables[ring, 1] * (1 - part) + tables[ring + 1, 1] * part
                four = tables[ring, 2] * (1 - part) + tables[ring + 1, 2] * part
                weight = tables[ring, 3] * (1 - part) + tables[ring + 1, 3] * part
                level += four * (1 - 8 * (dx * dy / (rho * rho)) ** 2)
                residual = light[lens, y, x] / (gain[lens] * (1 + tilt[lens, 0] * dx + tilt[lens, 1] * dy)) - level
                weight *= trust[lens]
                if residual * residual * weight >= _FAR * _FAR:
                    continue
                along = (field[lens, 0] * dx + field[lens, 1] * dy) / (far * rho)
                response = slope * far * (2 * along * along - 1)
                out[lens, 0] += weight * response * residual
                out[lens, 1] += weight * response * response


def _starts(plain: FitState) -> list[DiscModel]:
    """Cutting discs to start from, best first."""
    lattice = plain.model.lattice
    middle, reach = (np.array(lattice.image_size) - 1) / 2, np.hypot(*lattice.image_size) / 2
    radius = _radius(plain.discs)
    scouts = few_of(plain, int(np.clip(_SCOUT_PIXELS / abs(np.linalg.det(lattice.basis)), *_SCOUTS)))

    def cost(model: DiscModel) -> float:
        trial = placed(replace(scouts, model=model))
        return with_profile(with_profile(trial)[0])[1]

    trials: list[tuple[float, int, DiscModel]] = []
    for growth in _GROWTHS:
        for ratio in _RADII:
            for followed in _FOLLOWED:
                shrink = 1 - followed * growth * radius / reach
                origin = middle + (lattice.origin - middle) * shrink
                eye = CatEye(np.zeros(2), np.array([growth * radius, 0.0, 0.0]), ratio * radius, 0.5)
                model = DiscModel(replace(lattice, origin=origin, basis=lattice.basis * shrink), eye)
                trials.append((cost(model), len(trials), model))
    return [model for _, _, model in sorted(trials, key=lambda t: t[:2])[:_STARTS]]


def _radius(discs: Discs) -> float:
    """Distance from the centre [px] at which the profile falls through the middle between disc and gap."""
    level = discs.level
    half = 0.5 * (float(np.median(level[: max(2, len(level) // 2)])) + discs.dark)
    return max(int(np.argmax(level < half)), 1) * discs.step


def settled_roles(state: FitState) -> FitState:
    """Which of the two discs is the microimage: the one that fits better as such, or else the smaller one.

    Where lens shapes are cut from two discs, either could be the microimage and the other the cut. Shading inside the
    microimage tells; without any, the one that is whole in the middle of the field is.
    """
    lattice, eye = state.model.lattice, state.model.cat_eye
    assert eye is not None
    middle, reach = (np.array(lattice.image_size) - 1) / 2, np.hypot(*lattice.image_size) / 2
    grown = 1 + eye.growth[0] / reach
    radius = _radius(state.discs)
    other = replace(lattice, origin=middle + (lattice.origin - middle) * grown + eye.shift, basis=lattice.basis * grown)
    swapped = CatEye(-eye.shift, -eye.growth / grown, radius, eye.soft, eye.shared)
    radii = np.arange(len(state.discs.level)) * state.discs.step
    level = np.interp(radii * radius / eye.radius, radii, state.discs.level)
    discs = replace(state.discs, level=level, edge=edge_of(level))
    try:
        trial, _ = converge(placed(FitState(DiscModel(other, swapped), state.indices, discs)), ())
    except CalibrationError:
        return state
    assert trial.model.cat_eye is not None
    gain = _shading_tells(state.discs)
    if abs(gain) > _SURE**2:
        return trial if gain > 0 else state
    excess = [_radius(t.discs) - t.discs.radius for t in (state, trial)]
    return state if excess[0] <= excess[1] else trial


def _shading_tells(discs: Discs) -> float:
    """By how much chi squared falls where shading is centred on the cutting discs instead of on the microimages.

    Only pixels deep inside both discs are looked at: their edges are what a fit with the wrong roles has adapted to.
    """
    side = discs.light.shape[1]
    few = slice(None, None, max(1, int(discs.light.size / _SHADED_PIXELS)))
    light, gain, trust = discs.light[few], discs.gain[few, None, None], np.sqrt(discs.trust[few, None, None])
    corner = (discs.corners[few] - discs.centres[few])[:, None, None]
    offset = corner + np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)
    shares = []
    for place, radius in ((offset, _radius(discs)), (offset - discs.cut[few, None, None], discs.radius)):
        shares.append((place**2).sum(-1) / max(radius - _DEPTH * discs.soft, 1.0) ** 2)
    inside = ((shares[0] < 1) & (shares[1] < 1) & (light < discs.full)).astype(float)
    number = np.maximum(inside.sum((1, 2), keepdims=True), 1)
    value = light / (gain * (1 + (offset * discs.tilt[few, None, None]).sum(-1)))

    def apart(v: NDArray[np.float64]) -> NDArray[np.float64]:
        # The gain of each lens is its own: only differences within a lens count.
        return ((v - (v * inside).sum((1, 2), keepdims=True) / number) * trust)[inside > 0]

    value = apart(value)
    keep = np.abs(value) < _FAR * 1.4826 * np.median(np.abs(value)) if value.size else value > 0
    if keep.sum() < _FEWEST_SHADED:
        return 0.0
    costs = []
    for share in shares:
        columns = np.column_stack([apart(share**power) for power in (1, 2, 3)])[keep]
        left = value[keep] - columns @ np.linalg.lstsq(columns, value[keep], rcond=None)[0]
        costs.append(float(left @ left))
    return (costs[0] - costs[1]) / max(min(costs), 1e-30) * float(keep.sum())


def without_idle_cut(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, tuple[str, ...]]:
    """The state without a cutting disc that a distortion has made needless."""
    if state.model.cat_eye is None or state.model.lattice.distortion is None:
        return state, orders
    fewer = tuple(name for name in orders if not name.startswith("growth"))
    plain = replace(state, model=DiscModel(state.model.lattice, None), discs=replace(state.discs, radius=0.0, soft=0.0))
    try:
        plain, _ = converge(plain, fewer)
    except (CalibrationError, ValueError):
        return state, orders
    needless = misfit(state, plain) > (1 - _CUT_GAIN) * misfit(plain, plain)
    return (plain, fewer) if needless else (state, orders)
