"""Search for the disc that cuts microimages to lens shapes: cat-eye, or mechanical vignetting.

Only if the edges of the microimages have a second harmonic along the field is a disc looked for (`two_discs`). Either
of the two discs found could be the microimage and the other its cut.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..lattice.cell import clip_rows
from ..lattice.distortion import Distortion
from ..runtime.checks import LIMITS
from ..runtime.errors import CalibrationError
from ..runtime.kernels.jit import kernel
from .gauss_newton import FitState, converge, evaluate_cost, fit_profile, update_positions
from .model import CatEye, TwoDiscs, WhiteModel, field_position
from .settings import TWO_DISCS, VIGNETTING
from .two_discs import choose_lens, fit_two_discs, remove_neighbours

__all__ = ["drop_needless_cut", "fit_cutting_disc", "measure_centroid_offset"]


def fit_cutting_disc(plain: FitState, alternative: FitState, orders: tuple[str, ...]) -> FitState:
    """`plain` with a cutting disc, or as it is if none fits clearly better than it and an alternative.

    `plain` has converged without a cut, with the parameters `orders`; the alternative is another explanation of its
    residuals, such as a distortion. The state with a cut may have a distortion that `plain` has not.
    """
    narrowing, error = _measure_narrowing(alternative)
    if narrowing < max(VIGNETTING.least_narrowing, VIGNETTING.narrowing_significance * error):
        return plain
    discs = fit_two_discs(plain.lenses, plain.model.lattice)
    if discs is None:
        return plain
    model = _cut_model(plain.model, choose_lens(discs))
    if model.lattice.distortion is not None and not orders:
        orders = ("k1",)
    try:
        start = update_positions(replace(plain, model=model))
        start = replace(start, lenses=remove_neighbours(start.lenses, model))
        best, _ = converge(fit_profile(start), orders, settled=VIGNETTING.settled)
    except (CalibrationError, ValueError):
        return plain
    # A disc that stays outside the microimages cuts nothing.
    assert best.model.cat_eye is not None
    depth = best.lenses.radius + np.hypot(*best.lenses.cut_offset.T).max() - best.model.cat_eye.radius
    # Where nothing is cut, in the middle, centroids are those of the lenses.
    beside = measure_centroid_offset(best)
    if beside > max(LIMITS.centroids, measure_centroid_offset(plain)):
        return plain
    allowed = (1 - VIGNETTING.least_gain) * min(evaluate_cost(plain, plain), evaluate_cost(alternative, plain))
    return best if evaluate_cost(best, plain) < allowed and depth > VIGNETTING.least_depth else plain


def measure_centroid_offset(state: FitState) -> float:
    """Distance [px] of plain centroids of microimages in the middle of the field from their lattice; 0 for too few."""
    lenses = state.lenses
    far = np.hypot(*field_position(lenses.centres, state.model.lattice).T)
    near = np.flatnonzero(far < VIGNETTING.middle)[: VIGNETTING.middle_lenses]
    if len(near) < VIGNETTING.fewest_lenses:
        return 0.0
    places = np.arange(lenses.light.shape[1]) + (lenses.corners - lenses.centres)[near, :, None]
    x, y = places[:, 0, None, :], places[:, 1, :, None]
    window = np.clip(lenses.inradius + 0.5 - np.hypot(x, y), 0, 1)
    light = lenses.light[near]
    light = window * np.clip(light - np.quantile(light, VIGNETTING.dark, axis=(1, 2))[:, None, None], 0, None)
    total = np.maximum(light.sum((1, 2)), 1e-30)
    return float(np.hypot(*(np.median((light * way).sum((1, 2)) / total) for way in (x, y))))


def _cut_model(plain: WhiteModel, discs: TwoDiscs) -> WhiteModel:
    """The model with the first of the discs as the lens and the second as its cut."""
    lattice = plain.lattice
    middle, reach = (np.array(lattice.image_size) - 1) / 2, float(np.hypot(*lattice.image_size) / 2)
    bend, own = lattice.distortion, discs.growth[0]
    clear = abs(discs.bend) > max(TWO_DISCS.least_bend, TWO_DISCS.bend_significance * discs.bend_error)
    if clear and (bend is None or bend.general is None):
        bend = bend or Distortion.zero(lattice.image_size)
        bend = replace(bend, k1=bend.k1 + discs.bend / reach)
        # A `Distortion` leaves to the basis what a straight lattice can follow.
        own += 0.5 * discs.bend
    stretched, sheared, turned = discs.shear
    moved = np.array([[own + stretched, sheared + turned], [sheared - turned, own - stretched]])
    scale = np.eye(2) + moved / reach
    origin = middle + (lattice.origin - middle) @ scale + discs.offset[0]
    eye = CatEye(
        discs.offset[1] - discs.offset[0],
        np.array([discs.growth[1] - discs.growth[0], 0.0, 0.0]),
        float(discs.radius[1]),
        float(discs.blur[1]),
        discs.tail,
        discs.correlation,
    )
    return WhiteModel(replace(lattice, origin=origin, basis=lattice.basis @ scale, distortion=bend), eye, discs)


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
    rings = np.column_stack([lenses.profile, slope, lenses.harmonic, lenses.ring_weight, lenses.own_light])
    out = np.zeros((len(lenses.centres), 2))
    _accumulate_narrowing(
        lenses.windows, field_position(lenses.centres, state.model.lattice), lenses.inradius, lenses.step, rings,
        lenses.edge, lenses.saturation, VIGNETTING.outlier, out,
    )  # fmt: skip
    force, information = out.sum(0).tolist()
    if information <= 0:
        return 0.0, np.inf
    return force / information, information**-0.5


@kernel(error_model="numpy", share=lambda windows, *_: len(windows[2]))
def _accumulate_narrowing(begin, end, windows, field, inradius, step, rings, edge, saturation, outlier, out):
    """Per lens (n, 2): right side and normal matrix of the amplitude of `_measure_narrowing`."""
    light, corners, centres, gain, lens_weight, gain_slope, shade = windows
    for lens in range(begin, end):
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
                own = rings[ring, 4] * (1 - part) + rings[ring + 1, 4] * part
                level += own * (shade[lens, 0] * dx + shade[lens, 1] * dy)
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
