"""Global fit of a white image: lattice, distortion and cat-eye at once, every pixel of which votes.

All lenses share one lattice, one radial profile and one cutting disc; each has a gain of its own. Each further part of
the model is kept only where the pixels ask for it. A few lenses find the model, more of them the orders, all of them
the figures.
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
from ..runtime.errors import CalibrationError
from .cutouts import FEWEST_LENSES, cut_out_lenses
from .gauss_newton import FitState, compare_halves, converge, evaluate_cost, finish, measure_offsets, predict_shift
from .mechanical_vignetting import drop_needless_cut, fit_cutting_disc, resolve_disc_roles
from .model import CatEye, WhiteModel

__all__ = ["WhiteFit", "fit_white", "refine_on_parts"]

# Pixels, and least number of lenses, with which a cutting disc is looked for, and with which the orders of the model
# are chosen.
_FEW = (1e5, 150)
_SOME = (6e5, 400)
# Lenses by which a lattice is followed outwards.
_FOLLOWS = 800
# With so many lenses, orders that matter stand out by far, however few pixels each has.
_MANY = 8000
# Flats of so many pixels are used whole. Of larger ones, so many lenses are enough that centres have this standard
# error [px]: a hundredth of what any use of them could tell.
_ALL = 4e6
_FINE = 3.5e-4
# Of cut microimages, whose model leaves centres unsure by several times this, so many that they have this one [px],
# but no fewer and no more pixels, nor fewer lenses.
_FINE_CUT = 2e-3
_CUT, _FEWEST_CUT = (1e5, 2e5), 250
# Further orders must move centres by so many px (RMS) and by so many standard errors, and lower the misfit by this
# share. Less is no matter to anyone and may be the model's fault. The first step shows about how far they will.
_BENT = 0.01
_PROMISING = 0.5
_SURE = 8.0
_GAIN = 0.003
_RADIAL = ("k1", "centre", "k2")
# Steps after which a model without a cut has settled as far as it ever will.
_FIRST_PASSES = 5
# The blur that both edges of cut microimages share is known to so much, whatever the pixels say: no model of it is
# exact, and places hang on it where the two discs are alike.
_UNSURE_SHARED = 0.02
# Parameters of the cutting disc.
_NOT_OF_LATTICE = ("shift", "growth", "growth2", "growth3", "radius", "shared")


@dataclass(frozen=True)
class WhiteFit:
    """A fitted lattice and how its microimages agree with it.

    Parameters
    ----------
    lattice : Lattice [px]
    cat_eye : CatEye or None
        None where microimages are whole.
    residual_rms : float [px]
        Robust RMS distance of single microimages from the lattice.
    errors : LatticeErrors
        As the scatter of the microimages implies.
    lenses_used : int
    half_difference : float [px]
        RMS distance over the flat between the steps of two independent halves of the microimages.
    residuals : Residuals [px]
        Of the single microimages that took part.
    """

    lattice: Lattice
    cat_eye: CatEye | None
    residual_rms: float
    errors: LatticeErrors
    lenses_used: int
    half_difference: float
    residuals: Residuals


def fit_white(tones: NDArray[np.float32] | StackedCrops, lattice: Lattice, pixels: float = 3.2e6) -> WhiteFit:
    """Fit a white image.

    Parameters
    ----------
    tones : (h, w) float32, or parts of such
        Square root of the light (`features.tone`).
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat. The orders of its distortion, if any, are kept.
    pixels : float
        Use at most as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    tones, known = StackedCrops.of(tones), _known_orders(lattice)
    state, lit = cut_out_lenses(tones, WhiteModel(lattice, None), *_FEW, None)
    state, _ = converge(state, known, passes=_FIRST_PASSES)
    bent, bends = (state, known) if known else _better(state, (), _bent(state), ("k1",))
    state = fit_cutting_disc(state, bent, known)
    if state.model.cat_eye is None:
        state, known = bent, bends
    some, fewest = min(_SOME[0], _MANY * abs(float(np.linalg.det(lattice.basis)))), _SOME[1]
    if state.model.cat_eye is not None:
        some, fewest = float(np.clip(_pixels(state) * (state.uncertainty / _FINE_CUT) ** 2, *_CUT)), _FEWEST_CUT
    state, lit = cut_out_lenses(tones, state.model, some, fewest, state.discs, lit)
    state, summary = converge(state, known, known=True)
    first = state
    if state.model.cat_eye is not None:
        state = resolve_disc_roles(state)
    state, orders = _with_orders(state, known)
    if state.model.cat_eye is None and orders != known:
        state = fit_cutting_disc(state, state, orders)
    if orders != known:
        state, orders = drop_needless_cut(state, orders)
    if state.model.cat_eye is None:
        if _wanted(state, pixels) > _pixels(state):
            state, _ = cut_out_lenses(tones, state.model, _wanted(state, pixels), FEWEST_LENSES, state.discs, lit)
        state, summary = finish(state, orders)
    elif state is not first:
        state, summary = converge(state, orders, known=True)
    own = [k for k, name in enumerate(summary.names) if name not in _NOT_OF_LATTICE]
    covariance = summary.covariance + np.outer(summary.by_shared, summary.by_shared) * _UNSURE_SHARED**2
    errors = LatticeErrors(tuple(summary.names[k] for k in own), covariance[np.ix_(own, own)])
    return WhiteFit(
        state.model.lattice, state.model.cat_eye, summary.residual, errors, summary.used,
        compare_halves(summary),
        Residuals(state.indices.astype(np.int32), measure_offsets(state, summary).astype(np.float32)),
    )  # fmt: skip


def _wanted(state: FitState, pixels: float) -> float:
    """Pixels to be used of a flat of whole microimages, at most so many."""
    if np.prod(state.model.lattice.image_size) < _ALL:
        return pixels
    return min(pixels, _pixels(state) * (state.uncertainty / _FINE) ** 2)


def _pixels(state: FitState) -> float:
    return len(state.indices) * abs(float(np.linalg.det(state.model.lattice.basis)))


def refine_on_parts(tones: StackedCrops, lattice: Lattice) -> Lattice:
    """The lattice fitted to some lenses, with a distortion where they ask for one: a start for a larger part of a flat.

    Parameters
    ----------
    tones : Parts
        Square root of the light (`features.tone`).
    lattice : Lattice [px]
        Right to a fraction of the pitch in these parts.

    Raises
    ------
    CalibrationError
        As for `fit_white`.
    """
    known = _known_orders(lattice)
    few = min(_FEW[0], _FOLLOWS * abs(float(np.linalg.det(lattice.basis))))
    state, _ = converge(cut_out_lenses(tones, WhiteModel(lattice, None), few, _FEW[1], None)[0], known)
    if not known:
        state, known = _better(state, (), _bent(state), ("k1",))
    if "general" not in known:
        state, known = _better(state, known, _bent(state, np.zeros((2, 7))), ("general",))
    return state.model.lattice


def _known_orders(lattice: Lattice) -> tuple[str, ...]:
    """Names of the parameters that a lattice is distorted by."""
    bend = lattice.distortion
    return () if bend is None else ("k1",) if bend.general is None else ("general",)


def _with_orders(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, tuple[str, ...]]:
    """The state with the further parameters that the pixels ask for, and their names, those it has in front."""
    if state.model.cat_eye is not None:
        for name in ("growth2", "growth3"):
            state, orders = _better(state, orders, state, (*orders, name))
    cut, straight = orders, state
    for name in _RADIAL:
        before = orders
        if "general" in orders:
            return state, orders
        if name in orders:
            continue
        state, orders = _better(state, orders, _bent(state) if name == "k1" else state, (*orders, name))
        if orders == before:
            break
    if state.model.cat_eye is not None:
        # What its model leaves over can be taken for a distortion that follows no law.
        return state, orders
    # What is radial of it stays as it is: a general distortion could do the same.
    general = (*(name for name in cut if name not in _RADIAL), "general")
    return _better(state, orders, _bent(straight, np.zeros((2, 7))), general)


def _bent(state: FitState, general: NDArray[np.float64] | None = None) -> FitState:
    """The state with a distortion of no strength, or beside the one it has with a general one of none."""
    lattice = state.model.lattice
    if lattice.distortion is not None:
        if general is None or lattice.distortion.general is not None:
            return state
        bend = replace(lattice.distortion, general=general, middle=(np.array(lattice.image_size) - 1) / 2)
        return replace(state, model=replace(state.model, lattice=replace(lattice, distortion=bend)))
    middle, reach = (np.array(lattice.image_size) - 1) / 2, float(np.hypot(*lattice.image_size) / 2)
    bend = Distortion(middle, 0.0, 0.0, reach, general, middle)
    return replace(state, model=replace(state.model, lattice=replace(lattice, distortion=bend)))


def _better(
    state: FitState, orders: tuple[str, ...], start: FitState, more: tuple[str, ...]
) -> tuple[FitState, tuple[str, ...]]:
    """`start` fitted with the parameters `more` where that is clearly better than `state` and matters, else `state`."""
    if predict_shift(start, more) < _PROMISING * _BENT:
        return state, orders
    try:
        trial, _ = converge(start, more, known=True)
        better = evaluate_cost(state, state) - evaluate_cost(trial, state)
    except (CalibrationError, ValueError):
        return state, orders
    pixels = len(state.indices) * abs(np.linalg.det(state.model.lattice.basis))
    gain = better * pixels / (14 if "general" in more else 1)
    shift = trial.model.lattice.points(state.indices) - state.model.lattice.points(state.indices)
    matters = np.sqrt((shift**2).sum(1).mean()) > _BENT
    sure = gain > max(_SURE**2, _GAIN * evaluate_cost(state, state) * pixels)
    return (trial, more) if sure and matters else (state, orders)
