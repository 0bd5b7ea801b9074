"""Search for the disc that cuts microimages to lens shapes (cat-eye, mechanical vignetting)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numba import njit, prange

from ..lattice.cell import clip_rows
from ..runtime.errors import CalibrationError
from ..runtime.fastmath import FAST
from .cut_start import disc_radius, initial_cuts
from .gauss_newton import PASSES, FitState, converge, evaluate_cost, fit_profile, update_positions
from .model import CatEye, WhiteModel, field_position
from .normal_equations import Microimages, find_edge

__all__ = ["drop_needless_cut", "fit_cutting_disc", "resolve_disc_roles"]

# A cutting disc must lower the misfit by this share and reach into microimages by so many px.
_CUT_GAIN = 0.005
_CUT_DEPTH = 0.3
# Misfits that differ by the square of so many standard errors are told apart.
_SURE = 8.0
# A disc smaller than this share of the other one is taken for the microimage where shading does not tell.
_SMALLER = 0.9
# Discs that are told apart here are fitted with more lenses afterwards: steps below so many standard errors will do.
_NEARLY = 1.0
# Steps after which shading tells that discs are in each other's place.
_GLANCE = 2
# Cut microimages are narrower along the field by so many px at least, in the second harmonic of their edge (a cut of
# a pixel has twenty times this), and by so many standard errors.
_NARROW, _CERTAIN = 0.01, 6.0
# Shading is judged so many times the blur of an edge inside of it, at least on so many pixels, and without those so
# many standard deviations off.
_DEPTH = 2.0
_FEWEST_SHADED = 500
_FAR = 6.0
# Pixels of a lens whose products are summed together.
_TOGETHER = 512


def fit_cutting_disc(plain: FitState, rival: FitState, orders: tuple[str, ...]) -> FitState:
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
    for models in initial_cuts(plain):
        for trial in _of_either_role(plain, models, orders):
            left = evaluate_cost(trial, plain)
            if left < least:
                found, least = trial, left
    if found.model.cat_eye is None:
        return plain
    # A disc that stays outside the microimages cuts nothing.
    depth = disc_radius(found.discs) + np.hypot(*found.discs.cut.T).max() - found.model.cat_eye.radius
    better = least < (1 - _CUT_GAIN) * min(evaluate_cost(plain, plain), evaluate_cost(rival, plain))
    return found if better and depth > _CUT_DEPTH else plain


def _of_either_role(
    plain: FitState, models: tuple[WhiteModel, WhiteModel], orders: tuple[str, ...]
) -> Iterator[FitState]:
    """Fits with a cut from models of `initial_cuts`: the likelier one, and the other where that does not settle it."""
    first, second = (update_positions(replace(plain, model=model)) for model in models)
    try:
        first = fit_profile(first)
        starts = (second, first) if _shading_tells(first.discs) > _SURE**2 else (first, second)
    except (CalibrationError, ValueError):
        return
    doubtful = []
    for start in starts:
        glance = _fitted(start, orders, start is not first, _GLANCE)
        if glance is not None and _shading_tells(glance.discs) > _SURE**2:
            doubtful.append(glance)
            continue
        trial = glance and _fitted(glance, orders, False, PASSES)
        if trial is None:
            continue
        yield trial
        gain = _shading_tells(trial.discs)
        if gain < -(_SURE**2) or (gain < _SURE**2 and disc_radius(trial.discs) < _SMALLER * trial.discs.radius):
            return
    for glance in doubtful:
        trial = _fitted(glance, orders, False, PASSES)
        if trial is not None:
            yield trial


def _fitted(state: FitState, orders: tuple[str, ...], learn: bool, passes: int) -> FitState | None:
    """The state so far converged that discs can be told apart, None where it does not; `learn` a profile first."""
    try:
        return converge(fit_profile(state) if learn else state, orders, passes=passes, settled=_NEARLY)[0]
    except (CalibrationError, ValueError):
        return None


def _narrowing(state: FitState) -> tuple[float, float]:
    """By how much microimages in the corners of the field are narrower along the field than across, and its error [px].

    Amplitude of `cos(2 * angle)` of the radius, angles from the direction of the field, growing with the field: neither
    a lattice nor its distortion, neither blur nor the shape of pixels give whole discs any.
    """
    discs = state.discs
    tables = np.column_stack([discs.level, np.gradient(discs.level, discs.step), discs.four, discs.weight])
    found = np.zeros((len(discs.centres), 2))
    _narrowings(
        discs.light, discs.corners, discs.centres, field_position(discs.centres, state.model.lattice), discs.gain,
        discs.trust, discs.tilt, discs.inner, discs.step, tables, discs.edge, discs.full, found,
    )  # fmt: skip
    force, information = found.sum(0).tolist()
    if information <= 0:
        return 0.0, np.inf
    return force / information, information**-0.5


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _narrowings(light, corners, centres, field, gain, trust, tilt, inner, step, tables, edge, full, out):
    """Per lens (n, 2): force on the amplitude of `_narrowing`, and information about it."""
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        far = max(math.hypot(field[lens, 0], field[lens, 1]), 1e-6)
        top, bottom = clip_rows(cy, inner, 0, light.shape[1])
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(inner * inner - dy * dy, 0.0)), 0, light.shape[1])
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


def resolve_disc_roles(state: FitState) -> FitState:
    """Which of the two discs is the microimage: the one that fits better as such, or else the smaller one.

    Where lens shapes are cut from two discs, either could be the microimage and the other the cut. Shading inside the
    microimage tells; without any, the one that is whole in the middle of the field is.
    """
    lattice, eye = state.model.lattice, state.model.cat_eye
    assert eye is not None
    gain = _shading_tells(state.discs)
    if gain < -(_SURE**2) or (gain <= _SURE**2 and disc_radius(state.discs) <= eye.radius):
        return state
    middle, reach = (np.array(lattice.image_size) - 1) / 2, np.hypot(*lattice.image_size) / 2
    grown = 1 + eye.growth[0] / reach
    radius = disc_radius(state.discs)
    other = replace(lattice, origin=middle + (lattice.origin - middle) * grown + eye.shift, basis=lattice.basis * grown)
    swapped = CatEye(-eye.shift, -eye.growth / grown, radius, eye.soft, eye.shared)
    radii = np.arange(len(state.discs.level)) * state.discs.step
    level = np.interp(radii * radius / eye.radius, radii, state.discs.level)
    discs = replace(state.discs, level=level, edge=find_edge(level))
    try:
        trial, _ = converge(update_positions(FitState(WhiteModel(other, swapped), state.indices, discs)), ())
    except CalibrationError:
        return state
    assert trial.model.cat_eye is not None
    if gain > _SURE**2:
        return trial
    excess = [disc_radius(t.discs) - t.discs.radius for t in (state, trial)]
    return state if excess[0] <= excess[1] else trial


def _shading_tells(discs: Microimages) -> float:
    """By how much chi squared falls where shading is centred on the cutting discs instead of on the microimages.

    Only pixels deep inside both discs are looked at: their edges are what a fit with the wrong roles has adapted to.
    """
    moments, number = np.zeros((len(discs.centres), 7, 7)), np.zeros(len(discs.centres), np.int64)
    own_reach, cut_reach = (max(radius - _DEPTH * discs.soft, 1.0) for radius in (disc_radius(discs), discs.radius))
    _shading_moments(
        discs.light, discs.corners, discs.centres, discs.cut, discs.gain, discs.trust, discs.tilt, own_reach, cut_reach,
        discs.step, discs.level, discs.weight, discs.full, moments, number,
    )  # fmt: skip
    if number.sum() < _FEWEST_SHADED:
        return 0.0
    total, costs = moments.sum(0), []
    for own in (slice(1, 4), slice(4, 7)):
        force = total[0, own]
        costs.append(float(total[0, 0] - force @ np.linalg.lstsq(total[own, own], force, rcond=1e-9)[0]))
    return (costs[0] - costs[1]) / max(min(costs), 1e-30) * float(number.sum())


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _add_products(values, count, products):
    """Add to the upper half of `products` those of all pairs of rows, summed over the first columns."""
    for a in range(len(values)):
        for b in range(a, len(values)):
            total = 0.0
            for k in range(count):
                total += values[a, k] * values[b, k]
            products[a, b] += total


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _shading_moments(
    light, corners, centres, cut, gain, trust, tilt, inside, within, step, level, weight, full, moments, number
):
    """Per lens the covariances of light, and of powers of the distances to the middles of both discs.

    Of pixels within `inside` of the one and `within` of the other; not of those that are far off the profile.
    """
    side, per_step = light.shape[1], 1 / step
    per_inside, per_within = 1 / (inside * inside), 1 / (within * within)
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        bright, tilt_x, tilt_y = 1 / gain[lens], tilt[lens, 0], tilt[lens, 1]
        limit = _FAR * _FAR / trust[lens]
        # The last value is 1, so that sums are products too.
        values, products, count = np.ones((8, _TOGETHER + side)), np.zeros((8, 8)), 0
        top, bottom = clip_rows(cy, inside, 0, side)
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(inside * inside - dy * dy, 0.0)), 0, side)
            for x in range(first, last):
                dx = x - cx
                ex, ey = dx - cut[lens, 0], dy - cut[lens, 1]
                square = dx * dx + dy * dy
                own, other = square * per_inside, (ex * ex + ey * ey) * per_within
                if other >= 1 or own >= 1 or light[lens, y, x] >= full:
                    continue
                place = math.sqrt(square) * per_step
                ring = int(place)
                model = level[ring] + (level[ring + 1] - level[ring]) * (place - ring)
                # The gain of each lens is its own: only differences within a lens count.
                more = light[lens, y, x] * bright / (1 + tilt_x * dx + tilt_y * dy) - model
                if more * more * weight[ring] >= limit:
                    continue
                values[0, count] = more + model - level[0]
                values[1, count], values[2, count], values[3, count] = own, own * own, own * own * own
                values[4, count], values[5, count], values[6, count] = other, other * other, other * other * other
                count += 1
            if count > _TOGETHER:
                _add_products(values, count, products)
                count = 0
        _add_products(values, count, products)
        number[lens] = products[7, 7]
        for a in range(7):
            for b in range(a, 7):
                total = products[a, 7] * products[b, 7] / max(products[7, 7], 1.0)
                moments[lens, a, b] = moments[lens, b, a] = (products[a, b] - total) * trust[lens]


def drop_needless_cut(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, tuple[str, ...]]:
    """The state without a cutting disc that a distortion has made needless."""
    if state.model.cat_eye is None or state.model.lattice.distortion is None:
        return state, orders
    fewer = tuple(name for name in orders if not name.startswith("growth"))
    model = WhiteModel(state.model.lattice, None)
    plain = replace(state, model=model, discs=replace(state.discs, radius=0.0, soft=0.0))
    try:
        plain, _ = converge(plain, fewer)
    except (CalibrationError, ValueError):
        return state, orders
    needless = evaluate_cost(state, plain) > (1 - _CUT_GAIN) * evaluate_cost(plain, plain)
    return (plain, fewer) if needless else (state, orders)
