"""Robust Gauss-Newton on the model of a white image: lenses are opened, weighted, and moved until nothing moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import CalibrationError
from .model import WhiteModel, apply_step, build_jacobian, field_position, step_limits
from .normal_equations import Microimages, NormalEquations, build_normal_equations, find_edge
from .schur_complement import ReducedEquations, eliminate_gains, invert_2x2, solve_robustly
from .shading import field_shading, fit_shading_slope

__all__ = [
    "PASSES",
    "FitState",
    "StepResult",
    "compare_halves",
    "converge",
    "evaluate_cost",
    "finish",
    "fit_profile",
    "measure_offsets",
    "median_by_brightness",
    "predict_shift",
    "update_positions",
    "update_weights",
]  # fmt: skip

# Weights that fall with the residuals hold a step back: of normal residuals Tukey's biweight lets through their second
# over their first derivative, 0.76 / 0.91, and a little more of pixels that are thinned out.
_HELD_BACK = 0.86
PASSES = 15
# Weights that follow the residuals for longer would keep the fit from settling.
_FREE_PASSES = 5
# Those of a fit with other lenses have followed them already.
_KNOWN_PASSES = 2
# Steps below this share of the standard error change nothing, nor does what is to come after steps that shrink as fast
# as the last two where that is below the second share.
_SETTLED, _TO_COME = 0.3, 0.1
_STEADY = 0.5
# A step of whole discs whose profile is known leaves less than a twentieth of itself: so many standard errors are as
# good as made by it, where it is small against the blur of an edge [px].
_NEAR, _SHORT = 3.0, 0.05
# Times that the damping of a step is doubled at most.
_DAMPINGS = 60
_RUNAWAY = 0.05
# Lenses are grouped by brightness into so many groups to see how their noise depends on it.
_GROUPS = 12
# Lenses that scatter by more than this multiple of what is usual at their brightness lose their say.
_UNLIKE = 4.0
# Lenses whose own pixels put them further off than this many times the usual are placed one by one, with a trust that
# makes no pixel an outlier, in so many steps of at most so many px.
_FAR = 2.5
_ANY = 1e-9
_OWN_PASSES = 5
_LONGEST = 0.5
# What `Microimages` holds of each lens.
_OF_LENSES = ("light", "corners", "centres", "cut", "gain", "trust", "tilt")


@dataclass(frozen=True)
class FitState:
    """The model and the lenses that take part; of a converged fit also what its last step says.

    That are the standard error of a centre, RMS [px], the least squares that the step solved, by how much these would
    have moved centres (n, 2) [px], and the weights (n,) of lenses in them.
    """

    model: WhiteModel
    indices: NDArray[np.int64]
    discs: Microimages
    uncertainty: float = np.inf
    solved: ReducedEquations | None = None
    asked: NDArray[np.float64] | None = None
    weight: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class StepResult:
    """What the last step says; see `WhiteFit`.

    Parameters moved by `change` (p,), centres by `moved` (RMS) [px]; single microimages lie `miss` (n, 2) [px] off the
    lattice. Least squares alone, with lenses of a `weight` (n,), would have moved centres by `asked` (n, 2) [px].
    Parameters would follow each unit of `CatEye.shared` by `by_shared` (p,).
    """

    change: NDArray[np.float64]
    by_shared: NDArray[np.float64]
    moved: float
    residual: float
    uncertainty: float
    used: int
    names: list[str]
    covariance: NDArray[np.float64]
    columns: NDArray[np.float64]
    reduced: ReducedEquations
    miss: NDArray[np.float64]
    asked: NDArray[np.float64]
    weight: NDArray[np.float64]


def update_positions(state: FitState) -> FitState:
    """The lenses where the model has them now, with the cuts the cat-eye gives them."""
    lattice, eye = state.model.lattice, state.model.cat_eye
    centres = lattice.points(state.indices)
    if eye is None:
        discs = replace(state.discs, centres=centres)
    else:
        cut = eye.displacement(field_position(centres, lattice))
        discs = replace(state.discs, centres=centres, cut=cut, radius=eye.radius, soft=eye.soft, shared=eye.shared)
    return replace(state, discs=discs)


def update_weights(state: FitState, steps: NormalEquations) -> FitState:
    """Weights of pixels by their radius and of lenses by their brightness, from the residuals of the present model."""
    floor = 1e-6 * float(np.var(state.discs.level)) + 1e-12
    weight = 1 / np.maximum(steps.variance, floor)
    return replace(state, discs=replace(state.discs, weight=weight, trust=_trust(state.discs, steps)))


def _trust(discs: Microimages, steps: NormalEquations) -> NDArray[np.float64]:
    """(n,) weights of lenses by their brightness."""
    bright, typical = median_by_brightness(discs.gain, steps.scatter)
    spread = np.interp(discs.gain, bright, typical)
    trust = 1 / np.maximum(spread / np.median(typical), 0.1)
    # Half a microimage at the border of the array is unlike any other.
    trust *= np.minimum((_UNLIKE * spread / np.maximum(steps.scatter, 1e-30)) ** 4, 1)
    return np.asarray(trust)


def median_by_brightness(
    gain: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median gain and median value of the lenses in each of a few groups of like brightness, in its order."""
    order = np.argsort(gain, kind="stable")
    groups = min(_GROUPS, len(order))
    # Single calls for all groups, of the same size but for the few brightest lenses.
    order = order[: len(order) // groups * groups].reshape(groups, -1)
    middle = order.shape[1] // 2
    return gain[order[:, middle]], np.partition(values[order], middle, axis=1)[:, middle]


def fit_profile(state: FitState) -> FitState:
    """The state with the profile that fits it."""
    steps = state.discs.steps
    level = state.discs.level + np.linalg.solve(steps.profile, steps.force)
    discs = replace(state.discs, level=level, edge=find_edge(level))
    if state.model.cat_eye is None:
        return replace(state, discs=discs)
    return update_positions(replace(state, model=_blurred(state.model, discs), discs=discs))


def _blurred(model: WhiteModel, discs: Microimages) -> WhiteModel:
    """The model with the edge of the cut as soft as that of the microimages: the same lens and pixels blur both."""
    assert model.cat_eye is not None
    return replace(model, cat_eye=model.cat_eye.blurred(discs.blur[0])) if discs.blur else model


def _dark(level: NDArray[np.float64], edge: NDArray[np.bool_]) -> float:
    """Light between the microimages: the profile beyond its edge."""
    beyond = level[np.flatnonzero(edge).max(initial=0) + 1 :]
    return float(max(np.median(beyond) if len(beyond) else level.min(), 0.0))


def evaluate_cost(state: FitState, standard: FitState) -> float:
    """Mean squared residual with the weights of `standard`."""
    if state.discs is standard.discs:
        return state.discs.steps.cost
    return replace(state.discs, weight=standard.discs.weight, trust=standard.discs.trust).steps.cost


def converge(
    state: FitState, orders: tuple[str, ...], known: bool = False, passes: int = PASSES, settled: float = _SETTLED
) -> tuple[FitState, StepResult]:
    """Gauss-Newton until steps are below so many standard errors; `known` where the profile is that of a fit."""
    start, before, bold, trust, last = state.model.lattice.basis, 0.0, True, 1.0, None
    weight = None
    for turn in range(passes):
        summary = _solved(state, orders, bold=bold, before=weight)
        weight = summary.weight if summary.moved < summary.uncertainty else None
        if state.model.cat_eye is not None:
            limits = step_limits(state.model.cat_eye, summary.names)
            if last is not None:
                # Steps to and fro go too far.
                trust = min(2 * trust, 1.0) if summary.change / limits @ last > 0 else 0.5 * trust
            summary = _held(summary, trust * limits)
            last = summary.change / limits
        state = _stepped(state, summary, turn >= (_KNOWN_PASSES if known else _FREE_PASSES))
        if not np.abs(state.model.lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        shrinks = summary.moved / max(before, 1e-30)
        to_come = summary.moved * shrinks / (1 - shrinks) if shrinks < _STEADY else np.inf
        if summary.moved < settled * summary.uncertainty or to_come < _TO_COME * summary.uncertainty:
            break
        if (known or turn > 0) and state.discs.plain and _near(summary):
            break
        # Where all lenses lie alike to the pixels, place and profile wander together, and longer steps go astray.
        bold &= turn == 0 or shrinks < _STEADY
        before = summary.moved
    state = replace(state, uncertainty=summary.uncertainty, solved=summary.reduced)
    return replace(state, asked=summary.asked, weight=summary.weight), summary


def finish(state: FitState, orders: tuple[str, ...]) -> tuple[FitState, StepResult]:
    """`converge` for lenses opened with the profile of a fit, which is not needed afterwards."""
    if state.discs.plain:
        summary = _solved(state, orders, learn=False)
        if _near(summary):
            model = apply_step(state.model, summary.change, summary.names)
            return update_positions(replace(state, model=model, uncertainty=summary.uncertainty)), summary
    return converge(state, orders, known=True)


def _held(summary: StepResult, limits: NDArray[np.float64]) -> StepResult:
    """The step with the part that least squares are least sure of held back, so far that none exceeds its limit (p,).

    Levenberg's damping, as much of it as keeps the step within a trust region (Moré 1978).
    """
    change: NDArray[Any] = summary.change
    if not np.abs(change / limits).max() > 1:
        return summary
    # What is known has no variance that damping could hold back.
    wished = np.where(np.diag(summary.covariance) > 0, change, np.clip(change, -limits, limits))
    ease = summary.covariance / limits**2
    damping = 0.01 / max(float(np.diag(ease).max()), 1e-200)
    for _ in range(_DAMPINGS):
        change = np.linalg.solve(np.eye(len(limits)) + damping * ease, wished)
        if np.abs(change / limits).max() <= 1:
            break
        damping *= 2
    place = summary.columns[:, :2] @ change
    return replace(summary, change=change, moved=float(np.sqrt((place**2).sum(1).mean())))


def _near(summary: StepResult) -> bool:
    return summary.moved < min(_NEAR * summary.uncertainty, _SHORT)


def _with_known(
    known: int, step: float, columns: NDArray[np.float64], reduced: ReducedEquations, weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """`solve_robustly` with the step of the parameter `known` given."""
    free = np.delete(np.arange(columns.shape[2]), known)
    change, covariance = np.full(columns.shape[2], step), np.zeros((columns.shape[2],) * 2)
    free_columns = columns[:, :, free]
    change[free], covariance[np.ix_(free, free)], weight = solve_robustly(free_columns, reduced, slice(None), weight)
    return change, covariance, weight


def _solved(
    state: FitState,
    orders: tuple[str, ...],
    learn: bool = True,
    bold: bool = True,
    before: NDArray[np.float64] | None = None,
) -> StepResult:
    """The next robust Gauss-Newton step of all global parameters, in full length where `bold`.

    `before` are the weights (n,) of lenses in the step before, if that was short.
    """
    columns, names = build_jacobian(state.model, state.indices, orders)
    discs = state.discs
    try:
        steps = discs.steps if learn else build_normal_equations(discs, learn=False)
        say = _trust(discs, steps) / discs.trust if discs.whole else None
        reduced = eliminate_gains(steps, discs.level, say)
        change, covariance, weight = solve_robustly(columns, reduced, slice(None), before)
        by_shared = np.zeros(len(names))
        if state.model.cat_eye is not None:
            shared = names.index("shared")
            by_shared = covariance[:, shared] / max(float(covariance[shared, shared]), 1e-30)
            room = state.model.cat_eye.least_shared - state.model.cat_eye.shared
            if change[shared] < room:
                change, covariance, weight = _with_known(shared, room, columns, reduced, weight)
    except np.linalg.LinAlgError as error:
        raise CalibrationError("the microimages show no edges; give a sharper flat or a white image") from error
    place = columns[:, :2]
    ridge = 1e-9 * np.trace(reduced.normal[:, :2, :2].sum(0)) / len(columns) * np.eye(2)
    left = reduced.right[:, :2] - np.einsum("nij,nj->ni", reduced.normal[:, :2], columns @ change)
    miss = np.einsum("nij,nj->ni", invert_2x2(reduced.normal[:, :2, :2] + ridge), left) / _HELD_BACK
    asked = place @ change
    change, covariance = change / (_HELD_BACK if bold else 1.0), covariance / _HELD_BACK**2
    spread = (place.reshape(-1, place.shape[2]) @ covariance).reshape(place.shape)
    return StepResult(
        change=change,
        by_shared=by_shared,
        moved=float(np.sqrt(((place @ change) ** 2).sum(1).mean())),
        residual=float(np.sqrt(np.average((miss**2).sum(1), weights=weight))),
        uncertainty=float(np.sqrt(max((place * spread).sum((1, 2)).mean(), 0.0))),
        used=int((weight > 0).sum()),
        names=names,
        covariance=covariance,
        columns=columns,
        reduced=reduced,
        miss=miss,
        asked=asked,
        weight=weight,
    )


def _stepped(state: FitState, summary: StepResult, frozen: bool = False) -> FitState:
    """The state after a step of the global parameters, of the profile and of the gains.

    `frozen` leaves weights, the range of the edge and the light between microimages as they are.
    """
    steps, reduced, local = state.discs.steps, summary.reduced, summary.columns @ summary.change
    try:
        if reduced.mixed.shape[1]:
            follow = reduced.with_gains(local[..., None], slice(None)).reshape(-1)
            level = reduced.profiles(reduced.force - follow @ reduced.mixed.reshape(len(follow), -1))
        else:
            level = reduced.profiles(reduced.force)
    except np.linalg.LinAlgError as error:
        raise CalibrationError("the microimages show no edges; give a sharper flat or a white image") from error
    own = np.maximum(steps.normal[:, -1, -1], 1e-30)
    gain = (steps.right[:, -1] - (steps.normal[:, -1, :-1] * local).sum(1) - steps.mixed[:, -1] @ level) / own
    old = state.discs.level
    level = (old + level) * (np.linalg.norm(old) / np.linalg.norm(old + level))
    discs = replace(state.discs, level=level, gain=state.discs.gain * (1 + np.clip(gain, -0.5, 1)))
    discs = replace(discs, four=discs.four + steps.four)
    if not frozen:
        edge, by = find_edge(level), update_weights(state, steps).discs
        # Behind a cutting disc hardly any pixel tells the light between microimages from that of the edge.
        dark = _dark(level, edge) if discs.whole else discs.dark
        discs = replace(discs, weight=by.weight, trust=by.trust, edge=edge, dark=dark)
        # Of two discs that cut each other, shading tells which one is the microimage: about its middle light is even.
        slope = fit_shading_slope if state.model.cat_eye is None else field_shading
        discs = replace(discs, tilt=slope(discs, state.model.lattice))
    model = apply_step(state.model, summary.change, summary.names)
    if model.cat_eye is not None:
        model = _blurred(model, discs)
    return update_positions(FitState(model, state.indices, discs))


def compare_halves(summary: StepResult) -> float:
    """RMS distance over the flat between the last steps of every other microimage and of the others [px]."""
    parity = np.arange(len(summary.columns)) % 2
    one, two = (solve_robustly(summary.columns, summary.reduced, parity == half, summary.weight)[0] for half in (0, 1))
    return float(np.sqrt(((summary.columns[:, :2] @ (one - two)) ** 2).sum(1).mean())) / _HELD_BACK


def predict_shift(state: FitState, more: tuple[str, ...]) -> float:
    """RMS distance [px] by which centres would move if a converged state had the parameters `more` beside its own.

    As its last step would have moved them: that was short.
    """
    assert state.solved is not None and state.asked is not None
    columns, _ = build_jacobian(state.model, state.indices, more)
    moves = columns[:, :2] @ solve_robustly(columns, state.solved, slice(None), state.weight)[0]
    return float(np.sqrt(((moves - state.asked) ** 2).sum(1).mean())) / _HELD_BACK


def measure_offsets(state: FitState, summary: StepResult) -> NDArray[np.float64]:
    """(n, 2) [px] from the centres on the lattice to those that the pixels of single microimages show."""
    offset = summary.miss.copy()
    far = np.flatnonzero(np.hypot(*offset.T) > _FAR * summary.residual)
    if len(far) == 0:
        return offset
    # Their edges are outliers of the common fit: here every pixel counts.
    discs = _of_lenses(state, far).discs
    discs = replace(discs, trust=np.full(len(far), _ANY))
    start = discs.centres
    for _ in range(_OWN_PASSES):
        steps = discs.steps
        reduced = eliminate_gains(steps, discs.level)
        normal = reduced.normal[:, :2, :2]
        ridge = 1e-9 * np.trace(normal.sum(0)) / len(far) * np.eye(2)
        step = np.linalg.solve(normal + ridge, reduced.right[:, :2, None])[..., 0]
        discs = replace(discs, centres=discs.centres + np.clip(step, -_LONGEST, _LONGEST))
    offset[far] = discs.centres - start
    return offset


def _of_lenses(state: FitState, chosen: NDArray[np.int64]) -> FitState:
    """The state with only the chosen lenses."""
    discs = state.discs
    kept = {name: getattr(discs, name)[chosen] for name in _OF_LENSES}
    return replace(state, indices=state.indices[chosen], discs=replace(discs, **kept), solved=None)
