"""Global fit of a white image: lattice, distortion and cat-eye at once, every pixel of which votes.

All lenses share one lattice, one radial profile and one cutting disc; each has a gain of its own. Each further part of
the model is kept only where the pixels ask for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .disc_model import LOCAL, CatEye, Discs, DiscSteps, disc_steps, measure_level
from .distortion import Distortion
from .errors import CalibrationError
from .fit import cell_faces, radial_profile, whole_lenses
from .lattice import Lattice

__all__ = ["DiscFit", "fit_discs"]

_GOLDEN = 0.6180339887498949
# Lenses, and pixels of them, in which a cutting disc is looked for.
_FEW_PIXELS = 6e4
_FEWEST_LENSES = 12
_OUTLIER = 4.685
_PASSES = 12
# Steps below this share of the standard error change nothing.
_SETTLED = 0.3
_RUNAWAY = 0.05
# A cutting disc must lower the misfit by this share, and a distortion move centres by so many px (RMS) beyond a
# straight lattice and by so many standard errors: less is no matter to anyone and may be the model's own fault.
_CUT_GAIN = 0.02
_BENT = 0.01
_SURE = 8.0
# Noise at the edges of whole microimages is at most this multiple of the noise inside them.
_UNEVEN = 1.5
# Displacements in the corner and radii, both in radii of the microimage, at which cutting discs are looked for, and
# the part of the displacement by which the lattice found without it follows.
_GROWTHS = (-0.6, -0.4, -0.25, -0.12, 0.12, 0.25, 0.4, 0.6)
_RADII = (1.0, 1.1, 1.25)
_FOLLOWED = (0.25, 0.5)


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


@dataclass
class _State:
    """What is known while fitting: the model, the lenses that take part and their share in it."""

    lattice: Lattice
    cat_eye: CatEye | None
    indices: NDArray[np.int64]
    discs: Discs
    steps: DiscSteps


def fit_discs(light: NDArray[np.float32], lattice: Lattice, pixels: float = 6e6) -> DiscFit:
    """Fit a white image.

    Parameters
    ----------
    light : (h, w) float32
        Linear light.
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat.
    pixels : float
        Use only as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    small = _search_cut(light, lattice)
    state = _opened(light, small.lattice, small.cat_eye, pixels, small.discs)
    state, summary = _converged(light, state, ())
    reach = float(np.hypot(*lattice.image_size) / 2)
    middle = (np.array(lattice.image_size) - 1) / 2
    straight, plain = state, summary
    start = replace(state.lattice, distortion=Distortion(middle, 0.0, 0.0, reach))
    for orders in (("k1",), ("k1", "centre"), ("k1", "centre", "k2")):
        trial = replace(state, lattice=start)
        trial, found = _converged(light, trial, orders)
        bend = trial.lattice.distortion
        assert bend is not None
        if orders == ("k1",):
            centres = trial.lattice.centres() - middle
            square = (centres**2).sum(1, keepdims=True) / reach**2
            moved = np.sqrt(((centres * (square - 0.5)) ** 2).sum(1).mean())
            if not (abs(bend.k1) * moved > _BENT and abs(bend.k1) > _SURE * found.errors["k1"]):
                return _finished(straight, plain)
        elif orders[-1] == "k2" and not abs(bend.k2) > _SURE * found.errors["k2"]:
            break
        state, summary, start = trial, found, trial.lattice
    return _finished(state, summary)


@dataclass(frozen=True)
class _Summary:
    """Standard errors of the last step, robust scatter, and disagreement of halves."""

    errors: dict[str, float]
    residual: float
    uncertainty: float
    used: int
    differ: float


def _finished(state: _State, summary: _Summary) -> DiscFit:
    return DiscFit(state.lattice, state.cat_eye, summary.residual, summary.uncertainty, summary.used, summary.differ)


def _opened(
    light: NDArray[np.float32], lattice: Lattice, cat_eye: CatEye | None, pixels: float, known: Discs | None
) -> _State:
    """Lenses of about so many pixels in all, with gains from their cores and a first profile."""
    faces, reach = cell_faces(lattice)
    indices, centres = whole_lenses(lattice, reach + 2)
    every = max(1.0, len(centres) * abs(np.linalg.det(lattice.basis)) / pixels)
    every = max(1.0, min(every, len(centres) / (4 * _FEWEST_LENSES)))
    chosen = np.arange(len(centres)) * _GOLDEN % 1 < 1 / every
    indices, centres = indices[chosen], np.ascontiguousarray(centres[chosen])
    if len(centres) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(centres)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    inner = float(0.5 / np.hypot(*faces.T).max())
    core = max(1, int(0.4 * inner))
    at = np.rint(centres).astype(int)
    gain = np.mean(
        [light[at[:, 1] + y, at[:, 0] + x] for y in range(-core, core + 1) for x in range(-core, core + 1)], axis=0
    )
    gain = np.maximum(gain, 1e-3 * gain.mean())
    profile = radial_profile(light / np.float32(gain.mean()), lattice)
    discs = Discs(
        centres, np.zeros_like(centres), gain, np.zeros_like(centres), cat_eye, faces, inner, reach,
        profile.step, profile.mean if known is None else known.level, 1 / profile.variance,
        float(profile.mean.min()) if known is None else known.dark,
    )  # fmt: skip
    discs = replace(discs, tilt=_tilt(discs, lattice))
    state = _State(lattice, cat_eye, indices, discs, None)  # type: ignore[arg-type]
    state.discs = _placed(state)
    _measured(light, state, known is not None)
    return state


def _tilt(discs: Discs, lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) relative slope of the gain over the field [1/px], from a polynomial through all lenses."""
    scale = np.array(lattice.image_size) / 2
    x, y = ((discs.centres - scale) / scale).T
    powers = [(a, b) for a in range(5) for b in range(5 - a)]
    table = np.column_stack([x**a * y**b for a, b in powers])
    log = np.log(discs.gain)
    keep = np.ones(len(log), dtype=bool)
    slope = np.zeros(len(powers))
    for _ in range(3):
        if keep.sum() < 3 * len(powers):
            return np.zeros_like(discs.centres)
        slope = np.linalg.lstsq(table[keep], log[keep], rcond=None)[0]
        miss = np.abs(log - table @ slope)
        keep = miss < 5 * np.median(miss) + 1e-6
    dx = np.column_stack([a * x ** max(a - 1, 0) * y**b for a, b in powers]) @ slope
    dy = np.column_stack([b * x**a * y ** max(b - 1, 0) for a, b in powers]) @ slope
    return np.column_stack([dx, dy]) / scale


def _placed(state: _State) -> Discs:
    """The lenses where the lattice has them now, with the cuts the cat-eye gives them."""
    centres = state.lattice.points(state.indices)
    cut = np.zeros_like(centres)
    if state.cat_eye is not None:
        cut = state.cat_eye.shift + state.cat_eye.growth * _field(centres, state.lattice)
    return replace(state.discs, centres=centres, cut=cut, cat_eye=state.cat_eye)


def _field(centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) place in the field, of length 1 in the corners."""
    size = np.array(lattice.image_size)
    return (centres - (size - 1) / 2) / (np.hypot(*size) / 2)


def _measured(light: NDArray[np.float32], state: _State, known: bool) -> None:
    """Profile, noise and steps of the lenses as they are placed, written into the state."""
    level = measure_level(light, state.discs, known)
    outside = level[int(state.discs.inner / state.discs.step) :]
    dark = float(min(level.min() if len(outside) == 0 else outside.min(), level[: len(level) // 2].min()))
    discs = replace(state.discs, level=level, dark=max(dark, 0.0))
    steps = disc_steps(light, discs)
    # The noise found now serves the next step: it hardly changes, and a pass over all pixels is saved.
    weight = 1 / np.maximum(steps.variance, 1e-6 * float(np.var(level)) + 1e-12)
    state.discs = replace(discs, weight=weight)
    state.steps = steps


def _search_cut(light: NDArray[np.float32], lattice: Lattice) -> _State:
    """Best of a few cutting discs on a few lenses, or none where none fits clearly better."""
    plain = _opened(light, lattice, None, _FEW_PIXELS, None)
    for _ in range(2):
        plain, _ = _stepped(light, plain, ())
    # Cut microimages disagree with their common profile at the edge, and only there.
    spread = 1 / plain.discs.weight
    if spread.max() < _UNEVEN * np.median(spread):
        return plain
    size = np.array(lattice.image_size)
    middle, reach = (size - 1) / 2, np.hypot(*size) / 2
    level, dark = plain.discs.level, plain.discs.dark
    half = 0.5 * (float(np.median(level[: max(2, len(level) // 2)])) + dark)
    radius = float(np.flatnonzero(level > half).max()) * plain.discs.step
    best, least = None, np.inf
    for growth in _GROWTHS:
        for ratio in _RADII:
            for followed in _FOLLOWED:
                shrink = 1 - followed * growth * radius / reach
                moved = replace(
                    plain.lattice,
                    origin=middle + (plain.lattice.origin - middle) * shrink,
                    basis=plain.lattice.basis * shrink,
                )
                eye = CatEye(np.zeros(2), growth * radius, ratio * radius, 0.5)
                trial = replace(plain, lattice=moved, cat_eye=eye)
                trial.discs = _placed(trial)
                level = measure_level(light, trial.discs, False)
                trial.discs = replace(trial.discs, level=level)
                cost = disc_steps(light, trial.discs).cost
                if cost < least:
                    best, least = trial, cost
    assert best is not None
    weight = plain.discs.weight
    for _ in range(10):
        _measured(light, best, True)
        best, _ = _stepped(light, best, ())
    final = disc_steps(light, replace(best.discs, weight=weight)).cost
    before = disc_steps(light, plain.discs).cost
    return best if final < (1 - _CUT_GAIN) * before else plain


def _converged(light: NDArray[np.float32], state: _State, orders: tuple[str, ...]) -> tuple[_State, _Summary]:
    """Gauss-Newton until nothing moves any more."""
    start = state.lattice.basis
    for _ in range(_PASSES):
        state, summary = _stepped(light, state, orders)
        if not np.abs(state.lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        if summary.errors["moved"] < _SETTLED * summary.uncertainty:
            break
    return state, summary


def _design(state: _State, orders: tuple[str, ...]) -> tuple[NDArray[np.float64], list[str]]:
    """(n, 6, p) change of the local parameters of each lens with the global ones, and the names of these."""
    n = len(state.indices)
    columns: list[NDArray[np.float64]] = []
    names: list[str] = []

    def add(name: str, first: int, values: NDArray[np.float64]) -> None:
        column = np.zeros((n, LOCAL - 1))
        column[:, first : first + values.shape[1]] = values
        columns.append(column)
        names.append(name)

    unit = np.eye(2)
    for factor, name in zip((np.ones(n), *state.indices.T), ("origin", "a1", "a2"), strict=True):
        for axis in range(2):
            add(name, 0, factor[:, None] * unit[axis])
    bend = state.lattice.distortion
    if orders and bend is not None:
        offset = state.lattice.origin + state.indices @ state.lattice.basis - bend.centre
        square = (offset**2).sum(1, keepdims=True) / bend.reach**2
        add("k1", 0, offset * (square - 0.5))
        if "centre" in orders:
            for axis in range(2):
                along = 2 * bend.k1 * offset * offset[:, [axis]] / bend.reach**2
                add("centre", 0, -(bend.k1 * (square - 0.5) * unit[axis] + along))
        if "k2" in orders:
            add("k2", 0, offset * (square**2 - 0.25))
    if state.cat_eye is not None:
        for axis in range(2):
            add("shift", 2, np.ones((n, 1)) * unit[axis])
        add("growth", 2, _field(state.discs.centres, state.lattice))
        add("radius", 4, np.ones((n, 1)))
        add("soft", 5, np.ones((n, 1)))
    return np.stack(columns, axis=2), names


def _stepped(light: NDArray[np.float32], state: _State, orders: tuple[str, ...]) -> tuple[_State, _Summary]:
    """One robust Gauss-Newton step of all global parameters, gains and profile renewed after it."""
    design, names = _design(state, orders)
    normal, right, gains = _without_gain(state.steps)
    change, covariance, weight = _pooled(design, normal, right)
    parity = np.arange(len(design)) % 2
    halves = [_pooled(design[parity == s], normal[parity == s], right[parity == s])[0] for s in (0, 1)]
    place = design[:, :2]
    moved = float(np.sqrt(((place @ change) ** 2).sum(1).mean()))
    differ = float(np.sqrt(((place @ (halves[0] - halves[1])) ** 2).sum(1).mean()))
    error = float(np.sqrt(np.einsum("nap,pq,naq->n", place, covariance, place).mean()))
    ridge = 1e-9 * np.trace(normal[:, :2, :2].sum(0)) / len(normal) * np.eye(2)
    miss = np.linalg.solve(
        normal[:, :2, :2] + ridge, (right - np.einsum("nab,nb->na", normal, design @ change))[:, :2, None]
    )
    residual = float(np.sqrt(np.average((miss[..., 0] ** 2).sum(1), weights=weight)))
    errors = {name: float(np.sqrt(covariance[k, k])) for k, name in enumerate(names)} | {"moved": moved}
    lattice, eye = _moved(state, change, names)
    after = replace(state, lattice=lattice, cat_eye=eye)
    after.discs = replace(_placed(after), gain=state.discs.gain * np.clip(1 + gains, 0.5, 2))
    _measured(light, after, True)
    return after, _Summary(errors, residual, error, int((weight > 0).sum()), differ)


def _moved(state: _State, change: NDArray[np.float64], names: list[str]) -> tuple[Lattice, CatEye | None]:
    """Lattice and cat-eye after a step."""
    by = {name: change[[k for k, other in enumerate(names) if other == name]] for name in names}
    old = state.lattice
    bend = old.distortion
    if bend is not None and "k1" in by:
        bend = Distortion(
            bend.centre + np.clip(by.get("centre", np.zeros(2)), -0.1 * bend.reach, 0.1 * bend.reach),
            bend.k1 + float(by["k1"][0]), bend.k2 + float(by.get("k2", [0.0])[0]), bend.reach,
        )  # fmt: skip
    lattice = replace(
        old, origin=old.origin + by["origin"], basis=old.basis + np.array([by["a1"], by["a2"]]), distortion=bend
    )
    eye = state.cat_eye
    if eye is not None:
        most = 0.1 * eye.radius
        soft = float(np.clip(eye.soft + np.clip(by["soft"][0], -0.3 * eye.soft, 0.3 * eye.soft), 0.2, most + 0.2))
        eye = CatEye(
            eye.shift + np.clip(by["shift"], -most, most), eye.growth + float(np.clip(by["growth"][0], -most, most)),
            eye.radius + float(np.clip(by["radius"][0], -most, most)), soft,
        )  # fmt: skip
    return lattice, eye


def _without_gain(steps: DiscSteps) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Normal matrices and right sides with the gain of each lens eliminated, and the steps of the gains."""
    own = np.maximum(steps.normal[:, -1, -1], 1e-30)
    mixed = steps.normal[:, :-1, -1]
    normal = steps.normal[:, :-1, :-1] - mixed[:, :, None] * mixed[:, None, :] / own[:, None, None]
    right = steps.right[:, :-1] - mixed * (steps.right[:, -1] / own)[:, None]
    return normal, right, steps.right[:, -1] / own


def _pooled(
    design: NDArray[np.float64], normal: NDArray[np.float64], right: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Robust least squares: change (p,), covariance (p, p) and weights (n,) of the lenses."""
    places = normal[:, :2, :2] + 1e-9 * np.trace(normal[:, :2, :2].sum(0)) / len(normal) * np.eye(2)
    inverse = np.linalg.inv(places)
    matter = np.einsum("nap,nab,nbq->npq", design, normal, design, optimize=True)
    force = np.einsum("nap,na->np", design, right)
    weight = np.ones(len(design))
    for _ in range(5):
        information = (weight[:, None, None] * matter).sum(0)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
        change = covariance @ (weight @ force)
        left = (right - np.einsum("nab,nb->na", normal, design @ change))[:, :2]
        far = np.einsum("na,nab,nb->n", left, inverse, left)
        spread = float(np.median(far)) / 1.386 + 1e-30
        weight = np.clip(1 - far / (spread * _OUTLIER**2), 0, None) ** 2
    return change, covariance * spread, weight
