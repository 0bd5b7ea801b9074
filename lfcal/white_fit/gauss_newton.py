"""Robust Gauss-Newton fit of the model of a white image to a set of lenses.

Each pass solves for the global parameters, the radial profile and the gains of the lenses, then updates robust weights
of rings, lenses and pixels (IRLS). Steps of a cutting disc are damped to stay within a trust region.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lattice.robust_fit import field_rms
from ..runtime.errors import CalibrationError
from .edge_profile import find_edge
from .model import WhiteModel, apply_step, build_jacobian, field_position, step_limits
from .normal_equations import (
    Microimages,
    NormalEquations,
    ReducedEquations,
    build_normal_equations,
    eliminate_gains,
    invert_2x2,
    regularisation,
    solve_robustly,
)
from .settings import SOLVER
from .shading import field_slope, fit_shade

__all__ = [
    "FitState", "StepResult", "compare_halves", "converge", "evaluate_cost", "finish", "fit_profile",
    "measure_offsets", "median_by_brightness", "predict_shift", "update_positions", "update_weights",
]  # fmt: skip

_NO_EDGES = "the microimages show no edges; give a sharper flat or a white image"
# Fields of `Microimages` that have one row a lens.
_OF_LENSES = ("light", "corners", "centres", "cut_offset", "gain", "lens_weight", "slope", "shade")


@dataclass(frozen=True)
class FitState:
    """The model, the lenses that take part, and the last step of a converged fit (None before)."""

    model: WhiteModel
    indices: NDArray[np.int64]
    lenses: Microimages
    last: StepResult | None = None

    @property
    def uncertainty(self) -> float:
        """Standard error of a centre, RMS [px]."""
        return np.inf if self.last is None else self.last.uncertainty

    @property
    def pixels(self) -> float:
        """Pixels in the cells of all lenses, about."""
        return len(self.indices) * abs(float(np.linalg.det(self.model.lattice.basis)))


@dataclass(frozen=True)
class StepResult:
    """A Gauss-Newton step of `p` global parameters, `m` local ones and `n` lenses."""

    change: NDArray[np.float64]  # (p,)
    correlation_response: NDArray[np.float64]  # (p,) derivative of the others with `CatEye.correlation`, which is held
    shift_rms: float  # [px] movement of the centres
    residual_rms: float  # [px] of single microimages from the lattice
    uncertainty: float  # [px] standard error of a centre, RMS
    used: int  # lenses of positive weight
    names: list[str]  # (p,)
    covariance: NDArray[np.float64]  # (p, p)
    jacobian: NDArray[np.float64]  # (n, m, p) `build_jacobian`
    reduced: ReducedEquations
    residuals: NDArray[np.float64]  # (n, 2) [px] of single microimages from the lattice
    least_squares_shift: NDArray[np.float64]  # (n, 2) [px] movement of the centres before scaling and damping
    weight: NDArray[np.float64]  # (n,) of the lenses


def update_positions(state: FitState) -> FitState:
    """The state with centres and cutting discs where the model has them."""
    lattice, eye = state.model.lattice, state.model.cat_eye
    centres = lattice.points(state.indices)
    if eye is None:
        return replace(state, lenses=replace(state.lenses, centres=centres))
    lenses = replace(
        state.lenses,
        centres=centres,
        cut_offset=eye.displacement(field_position(centres, lattice)),
        cut_radius=eye.radius,
        cut_blur=eye.blur,
        cut_tail=eye.tail,
        correlation=eye.correlation,
    )
    return replace(state, lenses=lenses)


def update_weights(state: FitState, equations: NormalEquations) -> FitState:
    """Weights of rings by their variance and of lenses by their brightness, from the residuals in `equations`."""
    floor = 1e-6 * float(np.var(state.lenses.profile)) + 1e-12
    ring_weight, lens_weight = 1 / np.maximum(equations.variance, floor), _lens_weights(state.lenses, equations)
    return replace(state, lenses=replace(state.lenses, ring_weight=ring_weight, lens_weight=lens_weight))


def _lens_weights(lenses: Microimages, equations: NormalEquations) -> NDArray[np.float64]:
    """(n,) weights of lenses by the scatter that is usual at their brightness."""
    bright, typical = median_by_brightness(lenses.gain, equations.scatter)
    spread = np.interp(lenses.gain, bright, typical)
    weight = 1 / np.maximum(spread / np.median(typical), 0.1)
    # Half a microimage at the border of the array is unlike any other.
    weight *= np.minimum((SOLVER.outlying_scatter * spread / np.maximum(equations.scatter, 1e-30)) ** 4, 1)
    return np.asarray(weight)


def median_by_brightness(
    gain: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median gain and median value of the lenses in each of a few groups of like brightness, darkest first."""
    order = np.argsort(gain, kind="stable")
    groups = min(SOLVER.brightness_groups, len(order))
    # Groups of one size, without the few brightest lenses: one call of NumPy serves all.
    order = order[: len(order) // groups * groups].reshape(groups, -1)
    middle = order.shape[1] // 2
    return gain[order[:, middle]], np.partition(values[order], middle, axis=1)[:, middle]


def fit_profile(state: FitState) -> FitState:
    """The state with the profile that fits it."""
    equations = state.lenses.equations
    profile = state.lenses.profile + np.linalg.solve(equations.profile_normal, equations.profile_right)
    lenses = replace(state.lenses, profile=profile, edge=find_edge(profile))
    return update_positions(replace(state, lenses=lenses))


def _gap_light(profile: NDArray[np.float64], edge: NDArray[np.bool_]) -> float:
    """Light between the microimages: the profile beyond its edge."""
    beyond = profile[np.flatnonzero(edge).max(initial=0) + 1 :]
    return float(max(np.median(beyond) if len(beyond) else profile.min(), 0.0))


def evaluate_cost(state: FitState, standard: FitState) -> float:
    """Mean squared residual with the weights of `standard`."""
    if state.lenses is standard.lenses:
        return state.lenses.equations.cost
    by = standard.lenses
    return replace(state.lenses, ring_weight=by.ring_weight, lens_weight=by.lens_weight).equations.cost


def converge(
    state: FitState,
    orders: tuple[str, ...],
    known: bool = False,
    passes: int = SOLVER.passes,
    settled: float = SOLVER.settled,
) -> tuple[FitState, StepResult]:
    """Gauss-Newton passes until steps are shorter than `settled` standard errors; `known` if the profile was fitted.

    Raises `CalibrationError` if the microimages show no edges, or keep to no lattice.
    """
    start, before, full_steps, radius, last = state.model.lattice.basis, 0.0, True, 1.0, None
    weight = None
    for turn in range(passes):
        step = _solve_step(state, orders, full=full_steps, before=weight)
        weight = step.weight if step.shift_rms < step.uncertainty else None
        if state.model.cat_eye is not None:
            limits = step_limits(state.model.cat_eye, step.names)
            if last is not None:
                # Steps that go back and forth are too long.
                radius = min(2 * radius, 1.0) if step.change / limits @ last > 0 else 0.5 * radius
            step = _damp(step, radius * limits)
            last = step.change / limits
        state = _advance(state, step, turn >= (SOLVER.known_passes if known else SOLVER.free_passes))
        if not np.abs(state.model.lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < SOLVER.runaway:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        shrinks = step.shift_rms / max(before, 1e-30)
        to_come = step.shift_rms * shrinks / (1 - shrinks) if shrinks < SOLVER.steady else np.inf
        if step.shift_rms < settled * step.uncertainty or to_come < SOLVER.remainder * step.uncertainty:
            break
        if (known or turn > 0) and state.lenses.gains_from_cores and _is_near(step):
            break
        # Where all lenses lie alike to the pixels, position and profile are correlated: longer steps go astray.
        full_steps &= turn == 0 or shrinks < SOLVER.steady
        before = step.shift_rms
    return replace(state, last=step), step


def finish(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, StepResult]:
    """`converge` for lenses with the profile of a fit: one step without learning the profile, if that is enough."""
    if state.lenses.gains_from_cores:
        step = _solve_step(state, orders, learn=False)
        if _is_near(step):
            model = apply_step(state.model, step.change, step.names)
            return update_positions(replace(state, model=model, last=step)), step
    return converge(state, orders, known=True)


def _is_near(step: StepResult) -> bool:
    return step.shift_rms < min(SOLVER.near * step.uncertainty, SOLVER.near_px)


def _damp(step: StepResult, limits: NDArray[np.float64]) -> StepResult:
    """The step, its least certain parts shortened until no parameter exceeds its limit (p,).

    Levenberg's damping, as much of it as keeps the step within a trust region (Moré 1978).
    """
    change: NDArray[Any] = step.change
    if not np.abs(change / limits).max() > 1:
        return step
    # A fixed parameter has no variance for the damping to act on.
    bounded = np.where(np.diag(step.covariance) > 0, change, np.clip(change, -limits, limits))
    ease = step.covariance / limits**2
    damping = 0.01 / max(float(np.diag(ease).max()), 1e-200)
    for _ in range(SOLVER.most_dampings):
        change = np.linalg.solve(np.eye(len(limits)) + damping * ease, bounded)
        if np.abs(change / limits).max() <= 1:
            break
        damping *= 2
    return replace(step, change=change, shift_rms=field_rms(step.jacobian[:, :2], change))


def _solve_step(
    state: FitState,
    orders: tuple[str, ...],
    learn: bool = True,
    full: bool = True,
    before: NDArray[np.float64] | None = None,
) -> StepResult:
    """The next step of all global parameters, lengthened by `step_scale` if `full`; `before` as in `solve_robustly`."""
    jacobian, names = build_jacobian(state.model, state.indices, orders)
    lenses = state.lenses
    try:
        equations = lenses.equations if learn else build_normal_equations(lenses, learn=False)
        reweight = _lens_weights(lenses, equations) / lenses.lens_weight if lenses.whole else None
        reduced = eliminate_gains(equations, lenses.profile, reweight)
        change, covariance, weight = solve_robustly(jacobian, reduced, slice(None), before)
        response = np.zeros(len(names))
        if state.model.cat_eye is not None:
            k = names.index("correlation")
            response = covariance[:, k] / max(float(covariance[k, k]), 1e-30)
            change, covariance, weight = _solve_with_held(k, jacobian, reduced, weight)
            change, covariance = _combine_radii(state.model, change, covariance, names.index("radius"))
    except np.linalg.LinAlgError as error:
        raise CalibrationError(_NO_EDGES) from error
    position, positions = jacobian[:, :2], reduced.normal[:, :2, :2]
    left = reduced.right[:, :2] - np.einsum("nij,nj->ni", reduced.normal[:, :2], jacobian @ change)
    inverse = invert_2x2(positions + regularisation(positions))
    residuals = np.einsum("nij,nj->ni", inverse, left) / SOLVER.step_scale
    shift = position @ change
    change, covariance = change / (SOLVER.step_scale if full else 1.0), covariance / SOLVER.step_scale**2
    spread = (position.reshape(-1, position.shape[2]) @ covariance).reshape(position.shape)
    return StepResult(
        change=change,
        correlation_response=response,
        shift_rms=field_rms(position, change),
        residual_rms=float(np.sqrt(np.average((residuals**2).sum(1), weights=weight))),
        uncertainty=float(np.sqrt(max((position * spread).sum((1, 2)).mean(), 0.0))),
        used=int((weight > 0).sum()),
        names=names,
        covariance=covariance,
        jacobian=jacobian,
        reduced=reduced,
        residuals=residuals,
        least_squares_shift=shift,
        weight=weight,
    )


def _solve_with_held(
    held: int, jacobian: NDArray[np.float64], reduced: ReducedEquations, weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """`solve_robustly` for all parameters but the one that is `held`."""
    count = jacobian.shape[2]
    free = np.delete(np.arange(count), held)
    change, covariance = np.zeros(count), np.zeros((count, count))
    solution = solve_robustly(jacobian[:, :, free], reduced, slice(None), weight)
    change[free], covariance[np.ix_(free, free)], weight = solution
    return change, covariance, weight


def _combine_radii(
    model: WhiteModel, change: NDArray[np.float64], covariance: NDArray[np.float64], k: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A step and its covariance with the mean of the radius of the cut that it gives and of that in `model.discs`.

    By their variances: a profile that is free makes up for a wrong radius, the more the softer the edge is.
    """
    eye, discs = model.cat_eye, model.discs
    assert eye is not None and discs is not None
    own = float(covariance[k, k]) + (SOLVER.soft_fault * eye.blur * (eye.blur / eye.radius) ** 3) ** 2
    known = discs.radius_variance
    share = known / (known + own)
    response = covariance[:, k] / max(float(covariance[k, k]), 1e-30)
    away = float(discs.radius[1]) - eye.radius - float(change[k])
    spread = share * own - float(covariance[k, k])
    return change + (1 - share) * away * response, covariance + spread * np.outer(response, response)


def _advance(state: FitState, step: StepResult, frozen: bool) -> FitState:
    """The state after a step of the global parameters, of the profile and of the gains.

    `frozen` leaves weights, the range of the edge, the light between microimages and their slopes as they are.
    """
    old = state.lenses
    equations, reduced, local = old.equations, step.reduced, step.jacobian @ step.change
    try:
        right = reduced.profile_right
        if reduced.coupling.shape[1]:
            follow = reduced.append_gains(local[..., None], slice(None)).reshape(-1)
            right = right - follow @ reduced.coupling.reshape(len(follow), -1)
        profile = reduced.solve_profile(right)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(_NO_EDGES) from error
    own = np.maximum(equations.normal[:, -1, -1], 1e-30)
    explained = (equations.normal[:, -1, :-1] * local).sum(1)
    gain = (equations.right[:, -1] - explained - equations.coupling[:, -1] @ profile) / own
    profile = (old.profile + profile) * (np.linalg.norm(old.profile) / np.linalg.norm(old.profile + profile))
    lenses = replace(
        old,
        profile=profile,
        gain=old.gain * (1 + np.clip(gain, -0.5, 1)),
        harmonic=old.harmonic + equations.harmonic_step,
    )
    if not frozen:
        edge, by = find_edge(profile), update_weights(state, equations).lenses
        # Behind a cutting disc hardly any pixel separates the light between microimages from that of the edge.
        gap = _gap_light(profile, edge) if lenses.whole else lenses.gap
        lenses = replace(lenses, ring_weight=by.ring_weight, lens_weight=by.lens_weight, edge=edge, gap=gap)
        # Of two discs that cut each other, shading decides which is the microimage: it is even about its centre.
        lenses = replace(lenses, slope=field_slope(lenses, state.model.lattice), shade=np.zeros_like(lenses.shade))
        if lenses.whole:
            lenses = replace(lenses, shade=fit_shade(lenses, state.model.lattice))
    return update_positions(FitState(apply_step(state.model, step.change, step.names), state.indices, lenses))


def compare_halves(step: StepResult) -> float:
    """RMS distance over the flat between the steps of every other microimage and of the others [px]."""
    parity = np.arange(len(step.jacobian)) % 2
    one, two = (solve_robustly(step.jacobian, step.reduced, parity == half, step.weight)[0] for half in (0, 1))
    return field_rms(step.jacobian[:, :2], one - two) / SOLVER.step_scale


def predict_shift(state: FitState, more: tuple[str, ...]) -> float:
    """RMS distance [px] by which centres would move if a converged state had the parameters `more` instead of its own.

    Its last step, which was short, is solved again with these parameters.
    """
    assert state.last is not None
    jacobian, _ = build_jacobian(state.model, state.indices, more)
    shift = jacobian[:, :2] @ solve_robustly(jacobian, state.last.reduced, slice(None), state.last.weight)[0]
    further = shift - state.last.least_squares_shift
    return float(np.sqrt((further**2).sum(1).mean())) / SOLVER.step_scale


def measure_offsets(state: FitState, step: StepResult) -> NDArray[np.float64]:
    """(n, 2) [px] from the centres on the lattice to those that the pixels of single microimages show."""
    offset = step.residuals.copy()
    far = np.flatnonzero(np.hypot(*offset.T) > SOLVER.outlying_lens * step.residual_rms)
    if len(far) == 0:
        return offset
    # Pixels on their edges are outliers of the common fit: here each one counts.
    lenses = replace(state.lenses, **{name: getattr(state.lenses, name)[far] for name in _OF_LENSES})
    lenses = replace(lenses, lens_weight=np.full(len(far), SOLVER.single_weight))
    start, longest = lenses.centres, SOLVER.single_step
    for _ in range(SOLVER.single_passes):
        reduced = eliminate_gains(lenses.equations, lenses.profile)
        normal = reduced.normal[:, :2, :2]
        shift = np.linalg.solve(normal + regularisation(normal), reduced.right[:, :2, None])[..., 0]
        lenses = replace(lenses, centres=lenses.centres + np.clip(shift, -longest, longest))
    offset[far] = lenses.centres - start
    return offset
