"""Global fit of a white image: lattice, distortion and cat-eye at once, every pixel of which votes.

All lenses share one lattice, one radial profile and one cutting disc; each has a gain of its own. Each further part of
the model is kept only where the pixels ask for it. A few lenses find the model, more of them the orders, all of them
the figures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .disc_model import Discs, DiscSteps, disc_steps, edge_of, first_level
from .disc_parameters import CatEye, DiscModel, design, field_of, moved
from .distortion import Distortion
from .errors import CalibrationError
from .fit import cell_faces, whole_lenses
from .lattice import Lattice
from .windows import cut_windows

__all__ = ["DiscFit", "fit_discs"]

_GOLDEN = 0.6180339887498949
# Distance between samples of the profile [px]: edges of discs are about one pixel wide.
_STEP = 0.125
# Pixels, and least number of lenses, with which a cutting disc is looked for, and with which the orders of the model
# are chosen.
_FEW = (1e5, 150)
_SOME = (6e5, 400)
_FEWEST_LENSES = 12
_OUTLIER = 4.685
_PASSES = 15
# Weights that follow the residuals for longer would keep the fit from settling.
_FREE_PASSES = 5
_ROBUST_TURNS = 3
# Steps below this share of the standard error change nothing.
_SETTLED = 0.3
_RUNAWAY = 0.05
# A microimage darker than this share of a bright one is none: the array does not fill the sensor.
_DARK = 0.03
# Lenses are grouped by brightness into so many groups to see how their noise depends on it.
_GROUPS = 12
# A cutting disc must lower the misfit by this share and reach into microimages by so many px. Further orders must move
# centres by so many px (RMS) and by so many standard errors, and lower the misfit by this share. Less is no matter to
# anyone and may be the model's fault.
_CUT_GAIN = 0.02
_CUT_DEPTH = 0.3
_BENT = 0.01
_SURE = 8.0
_GAIN = 0.003
# Noise at the edges of whole microimages is at most this multiple of the noise inside them.
_UNEVEN = 1.3
# Displacements in the corner and radii, both in radii of the microimage, at which cutting discs are looked for, and
# the part of the displacement by which the lattice found without it follows; the best few are tried to the end.
_GROWTHS = (-0.6, -0.4, -0.25, -0.12, 0.12, 0.25, 0.4, 0.6)
_RADII = (1.0, 1.1, 1.25)
_FOLLOWED = (0.25, 0.5)
_STARTS = 3


@dataclass(frozen=True)
class DiscFit:
    """A fitted lattice and how its microimages agree with it.

    Parameters
    ----------
    lattice : Lattice [px]
    cat_eye : CatEye or None
        None where microimages are whole.
    residual_rms : float [px]
        Robust RMS distance of single microimages from the lattice.
    uncertainty : float [px]
        Standard error of a centre, RMS over the flat, as the scatter of the microimages implies.
    lenses_used : int
    halves_differ : float [px]
        RMS distance over the flat between the steps of two independent halves of the microimages.
    """

    lattice: Lattice
    cat_eye: CatEye | None
    residual_rms: float
    uncertainty: float
    lenses_used: int
    halves_differ: float


@dataclass(frozen=True)
class _State:
    """The model and the lenses that take part."""

    model: DiscModel
    indices: NDArray[np.int64]
    discs: Discs


@dataclass(frozen=True)
class _Summary:
    """What the last step says; see `DiscFit`, and by how much it moved centres (RMS) [px]."""

    moved: float
    residual: float
    uncertainty: float
    used: int


def fit_discs(tones: NDArray[np.float32], lattice: Lattice, pixels: float = 6e6) -> DiscFit:
    """Fit a white image.

    Parameters
    ----------
    tones : (h, w) float32
        Square root of the light (`features.tone`).
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat.
    pixels : float
        Use only as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    state = _opened(tones, DiscModel(lattice, None), *_FEW, None)
    state, _ = _converged(state, ())
    state = _with_cut(state)
    state = _opened(tones, state.model, *_SOME, state.discs)
    state, _ = _converged(state, ())
    state, orders = _without_idle_cut(*_with_orders(state))
    state = _opened(tones, state.model, pixels, _FEWEST_LENSES, state.discs)
    state, summary = _converged(state, orders)
    return DiscFit(
        state.model.lattice, state.model.cat_eye, summary.residual, summary.uncertainty, summary.used,
        _halves_differ(state, orders),
    )  # fmt: skip


def _halves_differ(state: _State, orders: tuple[str, ...]) -> float:
    """RMS distance over the flat between steps from here of every other microimage and of the others [px]."""
    columns, _ = design(state.model, state.indices, orders)
    reduced = _without_gain(disc_steps(state.discs), state.discs.level)
    parity = np.arange(len(columns)) % 2
    one, two = (_pooled(columns, reduced, parity == half)[0] for half in (0, 1))
    return float(np.sqrt(((columns[:, :2] @ (one - two)) ** 2).sum(1).mean()))


def _opened(tones: NDArray[np.float32], model: DiscModel, pixels: float, fewest: int, known: Discs | None) -> _State:
    """Lenses of about so many pixels in all, but at least so many, with gains from their cores."""
    lattice = model.lattice
    faces, reach = cell_faces(lattice)
    indices, centres = whole_lenses(lattice, reach + 2)
    every = max(1.0, len(centres) * abs(np.linalg.det(lattice.basis)) / pixels)
    every = max(1.0, min(every, len(centres) / fewest))
    chosen = np.arange(len(centres)) * _GOLDEN % 1 < 1 / every
    indices, centres = indices[chosen], np.ascontiguousarray(centres[chosen])
    light, corners = cut_windows(tones, centres, reach + 2)
    inner = float(0.5 / np.hypot(*faces.T).max())
    core, middle = max(1, int(0.4 * inner)), light.shape[1] // 2
    gain = light[:, middle - core : middle + core + 1, middle - core : middle + core + 1].mean((1, 2)).astype(float)
    lit = gain > _DARK * np.quantile(gain, 0.95) if len(gain) else np.zeros(0, dtype=bool)
    if lit.sum() < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {lit.sum()} whole microimages of {lattice.pitch:.1f} px pitch are lit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    rings = int(reach / _STEP) + 3
    indices, centres, gain = indices[lit], centres[lit], gain[lit]
    none = np.zeros_like(centres)
    discs = Discs(
        light[lit], corners[lit], centres, none, gain, np.ones(len(gain)), _tilt(centres, gain, lattice), 0.0, 0.0,
        faces, inner, reach, _STEP, np.zeros(rings), np.ones(rings),
        np.zeros(rings), np.zeros(rings, dtype=bool), 0.0,
    )  # fmt: skip
    if known is None:
        level = first_level(discs)
        discs = replace(
            discs, level=level, weight=np.full(rings, 1 / max(float(np.var(level)), 1e-12)), edge=edge_of(level)
        )
    else:
        # Profile and gains share a scale that the new gains settle.
        discs = replace(
            discs, level=known.level, weight=known.weight, four=known.four, edge=known.edge, dark=known.dark
        )
    state = _placed(_State(model, indices, discs))
    if known is not None:
        scale = _scale(state)
        state = replace(state, discs=replace(state.discs, gain=state.discs.gain * scale))
    return _weighted(state, disc_steps(state.discs))


def _scale(state: _State) -> NDArray[np.float64]:
    """(n,) factor of each gain for which the lens agrees best with the known profile."""
    steps = disc_steps(replace(state.discs, weight=1e-6 * state.discs.weight))
    return 1 + np.clip(steps.right[:, -1] / np.maximum(steps.normal[:, -1, -1], 1e-30), -0.5, 1)


def _tilt(centres: NDArray[np.float64], gain: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the gain over the field [1/px], from a polynomial through all lenses."""
    scale = np.array(lattice.image_size) / 2
    x, y = ((centres - scale) / scale).T
    powers = [(a, b) for a in range(5) for b in range(5 - a)]
    table = np.column_stack([x**a * y**b for a, b in powers])
    log = np.log(gain)
    keep = np.ones(len(log), dtype=bool)
    slope = np.zeros(len(powers))
    for _ in range(3):
        if keep.sum() < 3 * len(powers):
            return np.zeros_like(centres)
        slope = np.linalg.lstsq(table[keep], log[keep], rcond=None)[0]
        miss = np.abs(log - table @ slope)
        keep = miss < 5 * np.median(miss) + 1e-6
    dx = np.column_stack([a * x ** max(a - 1, 0) * y**b for a, b in powers]) @ slope
    dy = np.column_stack([b * x**a * y ** max(b - 1, 0) for a, b in powers]) @ slope
    return np.column_stack([dx, dy]) / scale


def _placed(state: _State) -> _State:
    """The lenses where the model has them now, with the cuts the cat-eye gives them."""
    lattice, eye = state.model.lattice, state.model.cat_eye
    centres = lattice.points(state.indices)
    if eye is None:
        discs = replace(state.discs, centres=centres)
    else:
        cut = eye.displacement(field_of(centres, lattice))
        discs = replace(state.discs, centres=centres, cut=cut, radius=eye.radius, soft=eye.soft)
    return replace(state, discs=discs)


def _weighted(state: _State, steps: DiscSteps) -> _State:
    """Weights of pixels by their radius and of lenses by their brightness, from the residuals of the present model."""
    discs = state.discs
    floor = 1e-6 * float(np.var(discs.level)) + 1e-12
    weight = 1 / np.maximum(steps.variance, floor)
    order = np.argsort(discs.gain, kind="stable")
    groups = [g for g in np.array_split(order, _GROUPS) if len(g)]
    typical = np.array([np.median(steps.scatter[g]) for g in groups])
    spread = np.interp(discs.gain, [np.median(discs.gain[g]) for g in groups], typical)
    trust = 1 / np.maximum(spread / np.median(typical), 0.1)
    return replace(state, discs=replace(discs, weight=weight, trust=trust))


def _with_cut(plain: _State) -> _State:
    """The best of a few cutting discs, or none where none fits clearly better."""
    # Cut microimages disagree with their common profile at the edge, and only there.
    spread = 1 / plain.discs.weight
    if spread.max() < _UNEVEN * np.median(spread):
        return plain
    lattice = plain.model.lattice
    middle, reach = (np.array(lattice.image_size) - 1) / 2, np.hypot(*lattice.image_size) / 2
    radius = _radius(plain.discs)
    trials: list[tuple[float, int, _State]] = []
    for growth in _GROWTHS:
        for ratio in _RADII:
            for followed in _FOLLOWED:
                shrink = 1 - followed * growth * radius / reach
                origin = middle + (lattice.origin - middle) * shrink
                eye = CatEye(np.zeros(2), np.array([growth * radius, 0.0, 0.0]), ratio * radius, 0.5)
                model = DiscModel(replace(lattice, origin=origin, basis=lattice.basis * shrink), eye)
                trial = _placed(replace(plain, model=model))
                for _ in range(2):
                    trial, cost = _profiled(trial)
                trials.append((cost, len(trials), trial))
    converged = []
    for _, number, trial in sorted(trials)[:_STARTS]:
        try:
            converged.append((_misfit(_converged(trial, ())[0], plain), number, trial))
        except CalibrationError:
            continue
    if not converged:
        return plain
    found = _settled_roles(_converged(min(converged)[2], ())[0])
    assert found.model.cat_eye is not None
    # A disc that stays outside the microimages cuts nothing.
    depth = _radius(found.discs) + np.hypot(*found.discs.cut.T).max() - found.model.cat_eye.radius
    better = _misfit(found, plain) < (1 - _CUT_GAIN) * _misfit(plain, plain)
    return found if better and depth > _CUT_DEPTH else plain


def _misfit(state: _State, standard: _State) -> float:
    """Mean squared residual with the weights of `standard`, over all pixels."""
    every = np.zeros_like(state.discs.edge)
    return disc_steps(replace(state.discs, edge=every, weight=standard.discs.weight, trust=standard.discs.trust)).cost


def _radius(discs: Discs) -> float:
    """Distance from the centre [px] at which the profile falls through the middle between disc and gap."""
    level = discs.level
    half = 0.5 * (float(np.median(level[: max(2, len(level) // 2)])) + discs.dark)
    return max(int(np.argmax(level < half)), 1) * discs.step


def _settled_roles(state: _State) -> _State:
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
    swapped = CatEye(-eye.shift, -eye.growth / grown, radius, eye.soft)
    radii = np.arange(len(state.discs.level)) * state.discs.step
    level = np.interp(radii * radius / eye.radius, radii, state.discs.level)
    discs = replace(state.discs, level=level, edge=edge_of(level))
    try:
        trial, _ = _converged(_placed(_State(DiscModel(other, swapped), state.indices, discs)), ())
    except CalibrationError:
        return state
    assert trial.model.cat_eye is not None
    pixels = len(state.indices) * abs(np.linalg.det(lattice.basis))
    gain = (_misfit(state, state) - _misfit(trial, state)) * pixels
    if abs(gain) > _SURE**2:
        return trial if gain > 0 else state
    return state if _radius(state.discs) <= _radius(trial.discs) else trial


def _profiled(state: _State) -> tuple[_State, float]:
    """The state with the profile that fits it, and the cost it had before."""
    steps = disc_steps(state.discs)
    level = state.discs.level + np.linalg.pinv(steps.profile, rcond=1e-9, hermitian=True) @ steps.force
    return replace(
        state, discs=replace(state.discs, level=level, edge=edge_of(level), dark=_dark(level, edge_of(level)))
    ), steps.cost


def _dark(level: NDArray[np.float64], edge: NDArray[np.bool_]) -> float:
    """Light between the microimages: the profile beyond its edge."""
    beyond = level[np.flatnonzero(edge).max(initial=0) + 1 :]
    return float(max(np.median(beyond) if len(beyond) else level.min(), 0.0))


def _with_orders(state: _State) -> tuple[_State, tuple[str, ...]]:
    """The state with the further parameters that the pixels ask for, and their names."""
    orders: tuple[str, ...] = ()
    if state.model.cat_eye is not None:
        for name in ("growth2", "growth3"):
            state, orders = _better(state, orders, state, (*orders, name))
    lattice, cut = state.model.lattice, orders
    reach, middle = float(np.hypot(*lattice.image_size) / 2), (np.array(lattice.image_size) - 1) / 2
    straight = state
    for name in ("k1", "centre", "k2"):
        start = _bent(state, Distortion(middle, 0.0, 0.0, reach)) if name == "k1" else state
        before = orders
        state, orders = _better(state, orders, start, (*orders, name))
        if orders == before:
            break
    if state.model.cat_eye is not None:
        # What its model leaves over can be taken for a distortion that follows no law.
        return state, orders
    general = _bent(straight, Distortion(middle, 0.0, 0.0, reach, np.zeros((2, 7)), middle))
    return _better(state, orders, general, (*cut, "general"))


def _without_idle_cut(state: _State, orders: tuple[str, ...]) -> tuple[_State, tuple[str, ...]]:
    """The state without a cutting disc that a distortion has made needless."""
    if state.model.cat_eye is None or state.model.lattice.distortion is None:
        return state, orders
    fewer = tuple(name for name in orders if not name.startswith("growth"))
    plain = replace(state, model=DiscModel(state.model.lattice, None), discs=replace(state.discs, radius=0.0, soft=0.0))
    try:
        plain, _ = _converged(plain, fewer)
    except (CalibrationError, ValueError):
        return state, orders
    needless = _misfit(state, plain) > (1 - _CUT_GAIN) * _misfit(plain, plain)
    return (plain, fewer) if needless else (state, orders)


def _bent(state: _State, distortion: Distortion) -> _State:
    model = replace(state.model, lattice=replace(state.model.lattice, distortion=distortion))
    return replace(state, model=model)


def _better(
    state: _State, orders: tuple[str, ...], start: _State, more: tuple[str, ...]
) -> tuple[_State, tuple[str, ...]]:
    """`start` fitted with the parameters `more` where that is clearly better than `state` and matters, else `state`."""
    try:
        trial, _ = _converged(start, more)
    except (CalibrationError, ValueError):
        return state, orders
    pixels = len(state.indices) * abs(np.linalg.det(state.model.lattice.basis))
    gain = (_misfit(state, state) - _misfit(trial, state)) * pixels / (14 if "general" in more else 1)
    shift = trial.model.lattice.points(state.indices) - state.model.lattice.points(state.indices)
    matters = np.sqrt((shift**2).sum(1).mean()) > _BENT
    sure = gain > max(_SURE**2, _GAIN * _misfit(state, state) * pixels)
    return (trial, more) if sure and matters else (state, orders)


def _converged(state: _State, orders: tuple[str, ...]) -> tuple[_State, _Summary]:
    """Gauss-Newton until nothing moves any more."""
    start = state.model.lattice.basis
    for turn in range(_PASSES):
        try:
            state, summary = _stepped(state, orders, turn >= _FREE_PASSES)
        except np.linalg.LinAlgError as error:
            raise CalibrationError("the microimages show no edges; give a sharper flat or a white image") from error
        if not np.abs(state.model.lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        if summary.moved < _SETTLED * summary.uncertainty:
            break
    return state, summary


@dataclass(frozen=True)
class _Reduced:
    """Least squares without the gains: local parameters (n, 6), profile (r,) and between them; none where unneeded."""

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    mixed: NDArray[np.float64]
    profile: NDArray[np.float64]
    force: NDArray[np.float64]


def _without_gain(steps: DiscSteps, level: NDArray[np.float64]) -> _Reduced:
    own = np.maximum(steps.normal[:, -1, -1], 1e-30)
    share = steps.normal[:, :-1, -1] / own[:, None]
    gain = steps.mixed[:, -1]
    # Gains and profile share one scale, which the profile keeps.
    scale = np.trace(steps.profile) / (level @ level) * np.outer(level, level)
    return _Reduced(
        steps.normal[:, :-1, :-1] - share[:, :, None] * steps.normal[:, None, :-1, -1],
        steps.right[:, :-1] - share * steps.right[:, [-1]],
        steps.mixed[:, :-1] - (share[:, :, None] * gain[:, None] if steps.mixed.shape[1] > 1 else 0),
        steps.profile - gain.T @ (gain / own[:, None]) + scale,
        steps.force - (steps.right[:, -1] / own) @ gain,
    )


def _stepped(state: _State, orders: tuple[str, ...], frozen: bool = False) -> tuple[_State, _Summary]:
    """One robust Gauss-Newton step of all global parameters, of the profile and of the gains.

    `frozen` leaves weights, the range of the edge and the light between microimages as they are.
    """
    columns, names = design(state.model, state.indices, orders)
    steps = disc_steps(state.discs)
    reduced = _without_gain(steps, state.discs.level)
    change, covariance, weight = _pooled(columns, reduced, slice(None))
    place, local = columns[:, :2], columns @ change
    ridge = 1e-9 * np.trace(reduced.normal[:, :2, :2].sum(0)) / len(columns) * np.eye(2)
    left = (reduced.right - (reduced.normal @ local[:, :, None])[..., 0])[:, :2, None]
    miss = np.linalg.solve(reduced.normal[:, :2, :2] + ridge, left)[..., 0]
    spread = (place.reshape(-1, place.shape[2]) @ covariance).reshape(place.shape)
    summary = _Summary(
        moved=float(np.sqrt(((place @ change) ** 2).sum(1).mean())),
        residual=float(np.sqrt(np.average((miss**2).sum(1), weights=weight))),
        uncertainty=float(np.sqrt(max((place * spread).sum((1, 2)).mean(), 0.0))),
        used=int((weight > 0).sum()),
    )
    force = reduced.force
    if reduced.mixed.shape[1]:
        force = force - local.reshape(-1) @ reduced.mixed.reshape(local.size, -1)
    level = np.linalg.solve(reduced.profile, force)
    own = np.maximum(steps.normal[:, -1, -1], 1e-30)
    gain = (steps.right[:, -1] - (steps.normal[:, -1, :-1] * local).sum(1) - steps.mixed[:, -1] @ level) / own
    old = state.discs.level
    level = (old + level) * (np.linalg.norm(old) / np.linalg.norm(old + level))
    discs = replace(state.discs, level=level, gain=state.discs.gain * (1 + np.clip(gain, -0.5, 1)))
    discs = replace(discs, four=discs.four + steps.four)
    if not frozen:
        edge = edge_of(level)
        weighted = _weighted(state, steps).discs
        discs = replace(discs, weight=weighted.weight, trust=weighted.trust, edge=edge, dark=_dark(level, edge))
    return _placed(_State(moved(state.model, change, names), state.indices, discs)), summary


def _pooled(
    columns: NDArray[np.float64], reduced: _Reduced, half: NDArray[np.bool_] | slice
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Robust least squares over a part of the lenses: change (p,), covariance (p, p) and weights (n,) of the lenses."""
    columns, normal, right, mixed = columns[half], reduced.normal[half], reduced.right[half], reduced.mixed[half]
    part = len(columns) / len(reduced.normal)
    lenses, local, globals_ = columns.shape
    places = normal[:, :2, :2] + 1e-9 * np.trace(normal[:, :2, :2].sum(0)) / lenses * np.eye(2)
    inverse = np.linalg.inv(places)
    force, matter = right.reshape(-1), (normal @ columns).reshape(-1, globals_)
    profile = part * reduced.profile
    weight = np.ones(lenses)
    for _ in range(_ROBUST_TURNS):
        weighted = (weight[:, None, None] * columns).reshape(-1, globals_).T
        information, pull = weighted @ matter, weighted @ force
        if mixed.shape[1]:
            # The profile changes along with the parameters: what it can take over says nothing about them.
            joint = weighted @ mixed.reshape(lenses * local, -1)
            taken = np.linalg.solve(profile, joint.T).T
            information -= taken @ joint.T / weight.mean()
            pull -= part * taken @ reduced.force
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
        change = covariance @ pull
        left = right[:, :2] - (matter @ change).reshape(lenses, local)[:, :2]
        far = left[:, 0] ** 2 * inverse[:, 0, 0] + left[:, 1] ** 2 * inverse[:, 1, 1]
        far += 2 * left[:, 0] * left[:, 1] * inverse[:, 0, 1]
        spread = float(np.median(far)) / 1.386 + 1e-30
        weight = np.clip(1 - far / (spread * _OUTLIER**2), 0, None) ** 2
    return change, covariance * spread, weight
