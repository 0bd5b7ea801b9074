"""Search for the disc that cuts microimages to lens shapes: cat-eye, or mechanical vignetting.

Only if the edges of the microimages have a second harmonic along the field is a disc looked for. Candidates come from
the rims in parts of the field (`rim_fit`). Either of the two discs could be the microimage and the other its cut; the
shading inside, which is centred on the microimage, decides if it can.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numba import prange
from numpy.typing import NDArray

from ..lattice.cell import clip_rows
from ..runtime.errors import CalibrationError
from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import njit
from .edge_profile import find_edge
from .gauss_newton import FitState, converge, evaluate_cost, fit_profile, update_positions
from .model import CatEye, WhiteModel, field_position
from .normal_equations import Microimages
from .rim_fit import RimFit, fit_rims
from .settings import SOLVER, VIGNETTING

__all__ = ["drop_needless_cut", "fit_cutting_disc", "resolve_disc_roles"]

# Pixels of a lens whose products are summed together.
_BLOCK = 512


def fit_cutting_disc(plain: FitState, alternative: FitState, orders: tuple[str, ...]) -> FitState:
    """`plain` with the best cutting disc, or as it is if none fits clearly better than it and an alternative.

    `plain` has converged without a cut, with the parameters `orders`; the alternative is another explanation of its
    residuals, such as a distortion.
    """
    narrowing, error = _measure_narrowing(alternative)
    if narrowing < max(VIGNETTING.least_narrowing, VIGNETTING.narrowing_significance * error):
        return plain
    best, least = plain, np.inf
    for models in _initial_cuts(plain):
        for trial in _fit_either_role(plain, models, orders):
            cost = evaluate_cost(trial, plain)
            if cost < least:
                best, least = trial, cost
    if best.model.cat_eye is None:
        return plain
    # A disc that stays outside the microimages cuts nothing.
    depth = best.lenses.radius + np.hypot(*best.lenses.cut_offset.T).max() - best.model.cat_eye.radius
    allowed = (1 - VIGNETTING.least_gain) * min(evaluate_cost(plain, plain), evaluate_cost(alternative, plain))
    return best if least < allowed and depth > VIGNETTING.least_depth else plain


def _fit_either_role(
    plain: FitState, models: tuple[WhiteModel, WhiteModel], orders: tuple[str, ...]
) -> Iterator[FitState]:
    """Fits from the two `models` of `_initial_cuts`: the likelier one, and the other if the first is not clear."""
    sure = VIGNETTING.significance**2
    first, second = (update_positions(replace(plain, model=model)) for model in models)
    try:
        first = fit_profile(first)
        starts = (second, first) if _shading_preference(first.lenses) > sure else (first, second)
    except (CalibrationError, ValueError):
        return
    doubtful = []
    for start in starts:
        early = _try_fit(start, orders, start is not first, VIGNETTING.first_passes)
        if early is not None and _shading_preference(early.lenses) > sure:
            doubtful.append(early)
            continue
        trial = early and _try_fit(early, orders)
        if trial is None:
            continue
        yield trial
        gain = _shading_preference(trial.lenses)
        if gain < -sure or (gain < sure and trial.lenses.radius < VIGNETTING.smaller * trial.lenses.cut_radius):
            return
    for early in doubtful:
        trial = _try_fit(early, orders)
        if trial is not None:
            yield trial


def _try_fit(
    state: FitState, orders: tuple[str, ...], learn: bool = False, passes: int = SOLVER.passes
) -> FitState | None:
    """The state converged so far that discs can be compared, None if it fails; `learn` a profile first."""
    try:
        start = fit_profile(state) if learn else state
        return converge(start, orders, passes=passes, settled=VIGNETTING.settled)[0]
    except (CalibrationError, ValueError):
        return None


def resolve_disc_roles(state: FitState) -> FitState:
    """The state with that disc as the microimage which fits better as such, or else the smaller one."""
    eye, lenses = state.model.cat_eye, state.lenses
    assert eye is not None
    gain, sure, radius = _shading_preference(lenses), VIGNETTING.significance**2, lenses.radius
    if gain < -sure or (gain <= sure and radius <= eye.radius):
        return state
    grown = 1 + eye.growth[0] / (np.hypot(*state.model.lattice.image_size) / 2)
    swapped = CatEye(-eye.shift, -eye.growth / grown, radius, eye.blur, eye.correlation)
    model = _move_centres(state.model, eye.growth[0], eye.shift, swapped)
    radii = np.arange(len(lenses.profile)) * lenses.step
    profile = np.interp(radii * radius / eye.radius, radii, lenses.profile)
    start = FitState(model, state.indices, replace(lenses, profile=profile, edge=find_edge(profile)))
    try:
        trial, _ = converge(update_positions(start), ())
    except CalibrationError:
        return state
    if gain > sure:
        return trial
    excess = [one.lenses.radius - one.lenses.cut_radius for one in (state, trial)]
    return state if excess[0] <= excess[1] else trial


def drop_needless_cut(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, tuple[str, ...]]:
    """The state without a cutting disc that a distortion has made needless."""
    if state.model.cat_eye is None or state.model.lattice.distortion is None:
        return state, orders
    fewer = tuple(name for name in orders if not name.startswith("growth"))
    model = WhiteModel(state.model.lattice, None)
    plain = replace(state, model=model, lenses=replace(state.lenses, cut_radius=0.0, cut_blur=0.0))
    try:
        plain, _ = converge(plain, fewer)
    except (CalibrationError, ValueError):
        return state, orders
    needless = evaluate_cost(state, plain) > (1 - VIGNETTING.least_gain) * evaluate_cost(plain, plain)
    return (plain, fewer) if needless else (state, orders)


def _measure_narrowing(state: FitState) -> tuple[float, float]:
    """By how much microimages in the corners of the field are narrower along the field than across, and its error [px].

    Amplitude of `cos(2 * angle)` of the radius, angles from the direction of the field, growing with the field: neither
    a lattice nor its distortion, neither blur nor the shape of pixels give whole discs any.
    """
    lenses = state.lenses
    slope = np.gradient(lenses.profile, lenses.step)
    rings = np.column_stack([lenses.profile, slope, lenses.harmonic, lenses.ring_weight])
    out = np.zeros((len(lenses.centres), 2))
    _accumulate_narrowing(
        lenses.windows, field_position(lenses.centres, state.model.lattice), lenses.inradius, lenses.step, rings,
        lenses.edge, lenses.saturation, VIGNETTING.outlier, out,
    )  # fmt: skip
    force, information = out.sum(0).tolist()
    if information <= 0:
        return 0.0, np.inf
    return force / information, information**-0.5


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _accumulate_narrowing(windows, field, inradius, step, rings, edge, saturation, outlier, out):
    """Per lens (n, 2): right side and normal matrix of the amplitude of `_measure_narrowing`."""
    light, corners, centres, gain, lens_weight, gain_slope = windows
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        far = max(math.hypot(field[lens, 0], field[lens, 1]), 1e-6)
        top, bottom = clip_rows(cy, inradius, 0, light.shape[1])
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(inradius * inradius - dy * dy, 0.0)), 0, light.shape[1])
            for x in range(first, last):
                dx = x - cx
                rho = max(math.sqrt(dx * dx + dy * dy), 1e-6)
                place = rho / step
                ring = int(place)
                if not edge[ring] or light[lens, y, x] >= saturation:
                    continue
                part = place - ring
                level = rings[ring, 0] * (1 - part) + rings[ring + 1, 0] * part
                slope = rings[ring, 1] * (1 - part) + rings[ring + 1, 1] * part
                harmonic = rings[ring, 2] * (1 - part) + rings[ring + 1, 2] * part
                weight = rings[ring, 3] * (1 - part) + rings[ring + 1, 3] * part
                level += harmonic * (1 - 8 * (dx * dy / (rho * rho)) ** 2)
                tilt = 1 + gain_slope[lens, 0] * dx + gain_slope[lens, 1] * dy
                residual = light[lens, y, x] / (gain[lens] * tilt) - level
                weight *= lens_weight[lens]
                if residual * residual * weight >= outlier * outlier:
                    continue
                along = (field[lens, 0] * dx + field[lens, 1] * dy) / (far * rho)
                response = slope * far * (2 * along * along - 1)
                out[lens, 0] += weight * response * residual
                out[lens, 1] += weight * response * response


def _shading_preference(lenses: Microimages) -> float:
    """By how much chi squared falls if shading is centred on the cutting discs instead of on the microimages.

    Only pixels deep inside both discs are used: a fit with the wrong roles has adapted to their edges.
    """
    count, margin = len(lenses.centres), VIGNETTING.inner_margin * lenses.cut_blur
    moments, number = np.zeros((count, 7, 7)), np.zeros(count, np.int64)
    own_reach, cut_reach = (max(radius - margin, 1.0) for radius in (lenses.radius, lenses.cut_radius))
    _shading_moments(
        lenses.windows, lenses.cut_offset, (own_reach, cut_reach), lenses.step, lenses.profile, lenses.ring_weight,
        lenses.saturation, VIGNETTING.outlier, moments, number,
    )  # fmt: skip
    if number.sum() < VIGNETTING.fewest_pixels:
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
def _shading_moments(windows, cut, reaches, step, profile, weight, saturation, outlier, moments, number):
    """Per lens the covariances of light and of powers of the distances to the centres of both discs.

    Of pixels within `reaches` of the two centres, outliers left out.
    """
    light, corners, centres, gain, lens_weight, gain_slope = windows
    side, per_step = light.shape[1], 1 / step
    reach, cut_reach = reaches
    per_reach, per_cut_reach = 1 / (reach * reach), 1 / (cut_reach * cut_reach)
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        bright, slope_x, slope_y = 1 / gain[lens], gain_slope[lens, 0], gain_slope[lens, 1]
        limit = outlier * outlier / lens_weight[lens]
        # The last value is 1, so that sums are products too.
        values, products, count = np.ones((8, _BLOCK + side)), np.zeros((8, 8)), 0
        top, bottom = clip_rows(cy, reach, 0, side)
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
            for x in range(first, last):
                dx = x - cx
                ex, ey = dx - cut[lens, 0], dy - cut[lens, 1]
                square = dx * dx + dy * dy
                own, other = square * per_reach, (ex * ex + ey * ey) * per_cut_reach
                if other >= 1 or own >= 1 or light[lens, y, x] >= saturation:
                    continue
                place = math.sqrt(square) * per_step
                ring = int(place)
                model = profile[ring] + (profile[ring + 1] - profile[ring]) * (place - ring)
                # The gain of each lens is free: only differences within a lens count.
                more = light[lens, y, x] * bright / (1 + slope_x * dx + slope_y * dy) - model
                if more * more * weight[ring] >= limit:
                    continue
                values[0, count] = more + model - profile[0]
                values[1, count], values[2, count], values[3, count] = own, own * own, own * own * own
                values[4, count], values[5, count], values[6, count] = other, other * other, other * other * other
                count += 1
            if count > _BLOCK:
                _add_products(values, count, products)
                count = 0
        _add_products(values, count, products)
        number[lens] = products[7, 7]
        for a in range(7):
            for b in range(a, 7):
                total = products[a, 7] * products[b, 7] / max(products[7, 7], 1.0)
                moments[lens, a, b] = moments[lens, b, a] = (products[a, b] - total) * lens_weight[lens]


def _initial_cuts(plain: FitState) -> list[tuple[WhiteModel, WhiteModel]]:
    """Models with a cut to start from, the likeliest first; each also with the two discs interchanged.

    Of the two the first one has the larger disc as the cut.
    """
    rims = _measure_rims(plain)
    if rims is None:
        return []
    found = fit_rims(*rims)
    most = VIGNETTING.alternative * found[0].residual
    return [_cut_models(plain.model, fit) for fit in found if fit.residual <= most]


def _cut_models(plain: WhiteModel, fit: RimFit) -> tuple[WhiteModel, WhiteModel]:
    blur, growth = VIGNETTING.start_blur, fit.growth - fit.lattice_growth
    eye = CatEye(fit.shift, np.array([growth, 0, 0]), fit.radius, blur)
    swapped = CatEye(-fit.shift, np.array([-growth, 0, 0]), fit.disc_radius, blur)
    one = _move_centres(plain, fit.lattice_growth, np.zeros(2), eye)
    other = _move_centres(plain, fit.growth, fit.shift, swapped)
    return (one, other) if fit.radius >= fit.disc_radius else (other, one)


def _move_centres(plain: WhiteModel, grown: float, shift: NDArray[np.float64], eye: CatEye) -> WhiteModel:
    """The model with centres moved by `shift`, and outwards by `grown` px in the corners."""
    lattice = plain.lattice
    middle, reach = (np.array(lattice.image_size) - 1) / 2, float(np.hypot(*lattice.image_size) / 2)
    scale = 1 + grown / reach
    origin = middle + (lattice.origin - middle) * scale + shift
    return WhiteModel(replace(lattice, origin=origin, basis=lattice.basis * scale), eye)


def _measure_rims(state: FitState) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Distances of rims (n, d) [px] in parts of the field, pixels they rest on, and places (n, 2) in the field.

    None if the profile has no fall, as where the gaps are clipped too.
    """
    lenses, lattice = state.lenses, state.model.lattice
    field, grid = field_position(lenses.centres, lattice), (VIGNETTING.field_columns, VIGNETTING.field_rows)
    share = (lenses.centres + 0.5) / np.array(lattice.image_size) * grid
    column, row = np.clip(share.astype(int), 0, np.array(grid) - 1).T
    part, parts = row * grid[0] + column, grid[0] * grid[1]
    single = np.zeros((len(field), VIGNETTING.directions, 2))
    out = np.zeros((parts, VIGNETTING.directions, 2))
    _accumulate_excess(lenses.windows, lenses.profile, lenses.inradius, lenses.step, single)
    np.add.at(out, part, single)
    number = np.maximum(np.bincount(part, minlength=parts), 1)
    middle = np.column_stack([np.bincount(part, field[:, axis], parts) / number for axis in (0, 1)])
    square = lenses.inradius**2
    radii = np.arange(int(lenses.inradius / lenses.step) + 1) * lenses.step
    profile = lenses.profile[: len(radii)] - lenses.gap
    even = radii < VIGNETTING.even * lenses.radius
    table = np.column_stack([np.ones(even.sum()), radii[even] ** 2 / square]) * np.sqrt(radii[even])[:, None]
    bright, falls = np.linalg.lstsq(table, profile[even] * np.sqrt(radii[even]), rcond=None)[0].tolist()
    if not bright > 0:
        return None
    falls = min(max(-falls / bright, 1e-6), VIGNETTING.most_falloff)
    # The light of a direction up to the side of the cell, as a share of an even one without a rim.
    full = 2 * float(np.trapezoid(profile * radii, radii)) / square
    lit = (full + out[..., 0] / np.maximum(out[..., 1], 1e-9)) / bright
    lit = np.clip(lit, VIGNETTING.least_light, None)
    return np.sqrt(square * (1 - np.sqrt(np.maximum(1 - 2 * falls * lit, 0))) / falls), out[..., 1], middle


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _accumulate_excess(windows, profile, inradius, step, out):
    """Light of lenses minus their profile, by direction, into `out` (n, directions, 2), and pixels there."""
    light, corners, centres, gain, _, gain_slope = windows
    directions = out.shape[1]
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
        top, bottom = clip_rows(cy, inradius, 0, light.shape[1])
        for y in range(top, bottom):
            dy = y - cy
            first, last = clip_rows(cx, math.sqrt(max(inradius * inradius - dy * dy, 0.0)), 0, light.shape[1])
            for x in range(first, last):
                dx = x - cx
                place = math.sqrt(dx * dx + dy * dy) / step
                ring = int(place)
                model = profile[ring] + (profile[ring + 1] - profile[ring]) * (place - ring)
                tilt = 1 + gain_slope[lens, 0] * dx + gain_slope[lens, 1] * dy
                # Hot pixels are no rim.
                more = min(max(light[lens, y, x] / (gain[lens] * tilt) - model, -1.0), 1.0)
                turn = (math.atan2(dy, dx) / (2 * math.pi)) % 1.0 * directions
                before = int(turn)
                share = turn - before
                after = (before + 1) % directions
                before %= directions
                out[lens, before, 0] += (1 - share) * more
                out[lens, before, 1] += 1 - share
                out[lens, after, 0] += share * more
                out[lens, after, 1] += share
