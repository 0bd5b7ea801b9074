"""Global fit of a white image: lattice, distortion and mechanical vignetting at once, by every pixel of many lenses.

All lenses share one lattice, one radial profile and one cutting disc; each has its own gain. A further parameter is
kept only if it lowers the cost significantly and moves the centres. A few lenses find the cut, more of them select the
parameters, and as many as are needed give the final values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.residuals import Residuals
from ..lattice.standard_errors import LatticeErrors
from ..runtime.checks import find_centroid_doubt
from ..runtime.errors import CalibrationError
from .cutouts import cut_out_lenses
from .gauss_newton import (
    FitState,
    StepResult,
    compare_halves,
    converge,
    evaluate_cost,
    finish,
    measure_offsets,
    predict_shift,
)
from .mechanical_vignetting import drop_needless_cut, fit_cutting_disc, measure_centroid_offset
from .model import CatEye, WhiteModel
from .settings import FIT, FitSettings

__all__ = ["WhiteFit", "fit_white", "refine_on_parts"]

_RADIAL = ("k1", "centre", "k2")
_CUT_PARAMETERS = ("shift", "growth", "growth2", "growth3", "radius", "correlation")
# Coefficients of a general distortion.
_GENERAL = 14


@dataclass(frozen=True)
class WhiteFit:
    """A fitted lattice and how its microimages agree with it."""

    lattice: Lattice
    cat_eye: CatEye | None  # None where microimages are whole
    doubt: str | None  # why the centres may be others, and what to do
    residual_rms: float  # [px] robust RMS distance of single microimages from the lattice
    errors: LatticeErrors  # as the scatter of the microimages implies
    lenses_used: int
    half_difference: float  # [px] RMS distance over the flat between the steps of two halves of the microimages
    residuals: Residuals  # [px] of the single microimages that took part


def fit_white(
    tones: NDArray[np.float32] | StackedCrops, lattice: Lattice, pixels: float = 3.2e6, settings: FitSettings = FIT
) -> WhiteFit:
    """Fit a white image.

    Parameters
    ----------
    tones : (h, w) float32, or parts of such
        Square root of the light (`images.preprocessing.sqrt_luminance`).
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat. The orders of its distortion, if any, are kept.
    pixels : float
        Use at most as many lenses, evenly spread, as have so many pixels in all.
    settings : FitSettings

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    tones, known = StackedCrops.of(tones), _distortion_orders(lattice)
    state, lit = cut_out_lenses(tones, WhiteModel(lattice, None), settings.search_pixels, settings.search_lenses, None)
    state, _ = converge(state, known, passes=settings.first_passes)
    bent, bends = (state, known) if known else _try(state, (), _add_distortion(state), ("k1",), settings)
    state = fit_cutting_disc(state, bent, known)
    if state.model.cat_eye is None:
        state, known = bent, bends
        enough = min(settings.order_pixels, settings.most_order_lenses * abs(float(np.linalg.det(lattice.basis))))
        fewest = settings.order_lenses
    else:
        known = known or _distortion_orders(state.model.lattice)
        wanted = state.pixels * (state.uncertainty / settings.cut_target_error) ** 2
        enough = float(np.clip(wanted, settings.cut_least_pixels, settings.cut_most_pixels))
        fewest = settings.cut_lenses
    state, lit = cut_out_lenses(tones, state.model, enough, fewest, state.lenses, lit)
    state, step = converge(state, known, known=True)
    first = state
    state, orders = _select_orders(state, known, settings)
    if state.model.cat_eye is None and orders != known:
        state = fit_cutting_disc(state, state, orders)
    if orders:
        state, orders = drop_needless_cut(state, orders)
    if state.model.cat_eye is None:
        wanted = pixels
        if np.prod(lattice.image_size) >= settings.all_pixels:
            wanted = min(pixels, state.pixels * (state.uncertainty / settings.target_error) ** 2)
        if wanted > state.pixels:
            state, _ = cut_out_lenses(tones, state.model, wanted, settings.fewest_lenses, state.lenses, lit)
        state, step = finish(state, orders)
    elif state is not first:
        state, step = converge(state, orders, known=True)
    return _summarise(state, step, settings)


def _summarise(state: FitState, step: StepResult, settings: FitSettings) -> WhiteFit:
    own = [k for k, name in enumerate(step.names) if name not in _CUT_PARAMETERS]
    covariance = step.covariance
    if state.model.discs is not None:
        # No model of the blur that both edges share is exact, and centres depend on it where the two discs are alike.
        fault = np.hypot(state.model.discs.correlation_error, settings.correlation_error)
        response = step.correlation_response * fault
        covariance = covariance + np.outer(response, response)
    errors = LatticeErrors(tuple(step.names[k] for k in own), covariance[np.ix_(own, own)])
    residuals = Residuals(state.indices.astype(np.int32), measure_offsets(state, step).astype(np.float32))
    doubt = None if state.model.discs is None else state.model.discs.doubt
    error = float(np.sqrt((errors.of_centres(state.model.lattice) ** 2).mean()))
    if state.model.discs is not None and error > settings.cut_promise and doubt is None:
        doubt = (
            f"microimages are the overlap of two discs with soft edges ({state.model.discs.blur[0]:.2f} px): their "
            f"centres are known to {error:.2f} px only; close the aperture of the main lens for a white image without "
            "vignetting"
        )
    doubt = doubt or find_centroid_doubt(measure_centroid_offset(state))
    return WhiteFit(
        state.model.lattice, state.model.cat_eye, doubt, step.residual_rms, errors, step.used, compare_halves(step),
        residuals,
    )  # fmt: skip


def refine_on_parts(tones: StackedCrops, lattice: Lattice, settings: FitSettings = FIT) -> Lattice:
    """The lattice fitted to some lenses of parts of a flat, with a distortion if it is significant.

    `tones` are square roots of the light; the lattice is right to a fraction of the pitch in these parts. Raises
    `CalibrationError` as `fit_white`.
    """
    known = _distortion_orders(lattice)
    few = min(settings.search_pixels, settings.part_lenses * abs(float(np.linalg.det(lattice.basis))))
    state, _ = cut_out_lenses(tones, WhiteModel(lattice, None), few, settings.search_lenses, None)
    state, _ = converge(state, known)
    if not known:
        state, known = _try(state, (), _add_distortion(state), ("k1",), settings)
    if "general" not in known:
        state, known = _try(state, known, _add_distortion(state, general=True), ("general",), settings)
    return state.model.lattice


def _distortion_orders(lattice: Lattice) -> tuple[str, ...]:
    """Names of the parameters that a lattice is distorted by."""
    bend = lattice.distortion
    return () if bend is None else ("k1",) if bend.general is None else ("general",)


def _select_orders(state: FitState, orders: tuple[str, ...], settings: FitSettings) -> tuple[FitState, tuple[str, ...]]:
    """The state with the further parameters that are significant, and the names of all beyond the basis."""
    if state.model.cat_eye is not None:
        for name in ("growth2", "growth3"):
            state, orders = _try(state, orders, state, (*orders, name), settings)
    cut, straight = orders, state
    for name in _RADIAL:
        before = orders
        if "general" in orders:
            return state, orders
        if name in orders:
            continue
        start = _add_distortion(state) if name == "k1" else state
        state, orders = _try(state, orders, start, (*orders, name), settings)
        if orders == before:
            break
    if state.model.cat_eye is not None:
        # What the model of the cut leaves over looks like a general distortion.
        return state, orders
    # The radial part stays as it is: a general distortion could do the same.
    general = (*(name for name in cut if name not in _RADIAL), "general")
    return _try(state, orders, _add_distortion(straight, general=True), general, settings)


def _add_distortion(state: FitState, general: bool = False) -> FitState:
    """The state with a distortion of zero strength, or with a `general` one beside the one it has."""
    lattice = state.model.lattice
    bend = lattice.distortion or Distortion.zero(lattice.image_size)
    if general and bend.general is None:
        middle = (np.array(lattice.image_size) - 1) / 2
        bend = replace(bend, general=np.zeros((2, _GENERAL // 2)), middle=middle)
    return replace(state, model=replace(state.model, lattice=replace(lattice, distortion=bend)))


def _try(
    state: FitState, orders: tuple[str, ...], start: FitState, more: tuple[str, ...], settings: FitSettings
) -> tuple[FitState, tuple[str, ...]]:
    """`start` fitted with the parameters `more` if that is significantly better than `state` and moves centres."""
    if predict_shift(start, more) < settings.promising * settings.least_shift:
        return state, orders
    try:
        trial, _ = converge(start, more, known=True)
        cost = evaluate_cost(state, state)
        gain = cost - evaluate_cost(trial, state)
    except (CalibrationError, ValueError):
        return state, orders
    gain = gain * state.pixels / (_GENERAL if "general" in more else 1)
    shift = trial.model.lattice.points(state.indices) - state.model.lattice.points(state.indices)
    moves = np.sqrt((shift**2).sum(1).mean()) > settings.least_shift
    significant = gain > max(settings.significance**2, settings.least_gain * cost * state.pixels)
    return (trial, more) if significant and moves else (state, orders)
