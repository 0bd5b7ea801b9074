"""Robust Gauss-Newton fit of a lattice together with the light of its microimages.

Any model of the light of a microimage can be fitted: a radial profile, straight edges, a mean
microimage, or two discs (`LightModel`). All lenses share one lattice and the parameters of the
light; each lens has its own gain, which is eliminated from the equations (Schur complement).
Weights of lenses follow their distance from the lattice (IRLS); models weigh their pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from ..lattice.distortion import GENERAL_TERMS, Distortion
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import SIGNIFICANT, field_rms, tukey_weights
from ..runtime.arrays import Floats, Integers
from ..runtime.errors import CalibrationError

__all__ = [
    "NEGLIGIBLE",
    "Fit",
    "LightModel",
    "Step",
    "Sums",
    "add_distortion",
    "converge",
    "eliminate_gains",
    "select_orders",
]

#: [px] Movements of the centres that matter to no picture.
NEGLIGIBLE = 0.01
# Damping of a step by robust weights: for Tukey's biweight and normal residuals the ratio of the
# means of second and first derivative is 0.76 / 0.91, a little more as pixels of several lenses
# have one variance.
_STEP_SCALE = 0.86
# [standard errors] A fit has converged if its step is shorter.
_CONVERGED = 0.3
# Change of the basis, relative to its start, beyond which the fit has lost the lattice.
_LARGEST_CHANGE = 0.05
_NO_LATTICE = "the microimages do not keep to one lattice; give a sharper flat or a white image"


class Sums(NamedTuple):
    """Normal equations of `n` lenses.

    Unknown are the change of the place x, y of a lens [px], of `s` parameters of the light that all
    lenses share, and of the gain of the lens, relative to the gain.
    """

    normal: Floats  # (n, 3 + s, 3 + s) upper halves
    right: Floats  # (n, 3 + s)
    # (chunks, r, 6) of the pixels nearest to a ring: weight, weighted residual, the same times
    # `cos(4 * direction)`, weight times its square, squared residual, number; (0, 0, 6) where a
    # model has no rings.
    band: Floats


class LightModel(Protocol):
    """Light of the microimages of `n` lenses."""

    @property
    def indices(self) -> Integers:
        """(n, 2) of the lenses on the lattice."""

    @property
    def parameters(self) -> Floats:
        """(s,) of the light, that are fitted along with the lattice."""

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """(s,) inverse variances of the shared parameters, and expected changes over variances."""

    def sums(self) -> Sums:
        """Normal equations about this model."""

    def learn(self, sums: Sums, step: Step, lattice: Lattice) -> Self:
        """The model after a step to the centres of `lattice`."""


Model = TypeVar("Model", bound=LightModel)


@dataclass(frozen=True)
class Equations:
    """Equations of `n` lenses for `p` parameters of the lattice and `s` of the light, no gains."""

    names: list[str]  # (p,)
    jacobian: Floats  # (n, 2 + s, p + s) of places of lenses and of the light with the parameters
    normal: Floats  # (n, 2 + s, 2 + s)
    right: Floats  # (n, 2 + s)
    known: Floats  # (p + s,) inverse variances that are known beforehand
    pull: Floats  # (p + s,) expected changes over these variances

    @classmethod
    def of(
        cls,
        model: LightModel,
        lattice: Lattice,
        orders: tuple[str, ...],
        lenses: tuple[Floats, Floats],
    ) -> Equations:
        """Those of a model for the lattice with these `orders` of its distortion.

        `lenses` are the matrices and right sides of `eliminate_gains`.
        """
        names, places = lattice.derivatives(model.indices, orders)
        known, pull = model.prior
        jacobian = np.zeros((len(places), 2 + len(known), len(names) + len(known)))
        jacobian[:, :2, : len(names)] = places
        jacobian[:, 2:, len(names) :] = np.eye(len(known))
        known = np.concatenate([np.zeros(len(names)), known])
        pull = np.concatenate([np.zeros(len(names)), pull])
        return cls(names, jacobian, lenses[0], lenses[1], known, pull)

    def half(self, first: int) -> Equations:
        """Those of every other lens."""
        return replace(
            self,
            jacobian=self.jacobian[first::2],
            normal=self.normal[first::2],
            right=self.right[first::2],
        )

    def solve(self, weight: Floats | None = None) -> Step:
        """The next step; CalibrationError where the lenses keep to no lattice.

        Weights of lenses are Tukey's, of their distance from the common change; those that are
        nearly known need only one pass.
        """
        lenses, size, count = self.jacobian.shape
        matter = (self.normal @ self.jacobian).reshape(-1, count)
        columns = self.jacobian.reshape(-1, count)
        passes = 3 if weight is None else 1
        weight = np.ones(lenses) if weight is None else weight
        try:
            of_place = np.linalg.inv(self.normal[:, :2, :2])
            for _ in range(passes):
                weighted = (np.repeat(weight, size)[:, None] * columns).T
                information = weighted @ matter + np.diag(self.known)
                scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
                pair = np.outer(scale, scale)
                covariance = np.linalg.pinv(information / pair, rcond=1e-12) / pair
                change = covariance @ (weighted @ self.right.ravel() + self.pull)
                rest = self.right - (matter @ change).reshape(lenses, size)
                left = (of_place @ rest[:, :2, None])[..., 0]
                weight, variance = tukey_weights((left * rest[:, :2]).sum(1))
        except np.linalg.LinAlgError as error:
            raise CalibrationError(_NO_LATTICE) from error
        return Step(
            self,
            change / _STEP_SCALE,
            covariance * variance / _STEP_SCALE**2,
            weight,
            left / _STEP_SCALE,
        )


def eliminate_gains(sums: Sums) -> tuple[Floats, Floats]:
    """Matrices (n, 2 + s, 2 + s) and right sides (n, 2 + s) of lenses without their gains."""
    normal = np.triu(sums.normal) + np.triu(sums.normal, 1).transpose(0, 2, 1)
    share = normal[:, :-1, -1] / np.maximum(normal[:, -1, -1], 1e-30)[:, None]
    normal = normal[:, :-1, :-1] - share[:, :, None] * normal[:, None, :-1, -1]
    # So that those of blank lenses can be inverted.
    place = normal[:, :2, :2]
    place += 1e-9 * np.trace(place.sum(0)) / len(place) * np.eye(2)
    return normal, sums.right[:, :-1] - share * sums.right[:, [-1]]


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step of the lattice and the light, and how lenses lie to it."""

    equations: Equations
    change: Floats  # (p + s,)
    covariance: Floats  # (p + s, p + s)
    weight: Floats  # (n,) of the lenses
    offsets: Floats  # (n, 2) [px] from the centres after the step to those of single microimages

    @property
    def names(self) -> list[str]:
        """Names (p,) of the parameters of the lattice."""
        return self.equations.names

    @property
    def of_lattice(self) -> Floats:
        """(p,) change of the parameters of the lattice."""
        return self.change[: len(self.names)]

    @property
    def of_light(self) -> Floats:
        """(s,) change of the shared parameters of the light."""
        return self.change[len(self.names) :]

    @property
    def jacobian(self) -> Floats:
        """(n, 2, p + s) of the centres with the parameters."""
        return self.equations.jacobian[:, :2]

    @property
    def shift_rms(self) -> float:
        """Movement of the centres, RMS [px]."""
        return field_rms(self.jacobian, self.change)

    def is_short(self, of_light: Floats) -> bool:
        """Whether centres, and parameters of the light (s,), have moved by less than `_CONVERGED`."""
        errors = np.sqrt(np.diag(self.covariance)[len(self.names) :])
        small = bool((np.abs(of_light) < _CONVERGED * errors).all())
        return small and self.shift_rms < _CONVERGED * self.uncertainty

    @property
    def uncertainty(self) -> float:
        """Standard error of a centre, RMS [px]."""
        spread = np.einsum(
            "nap,pq,naq->n", self.jacobian, self.covariance, self.jacobian, optimize=True
        )
        return float(np.sqrt(max(spread.mean(), 0.0)))

    @property
    def residual_rms(self) -> float:
        """Distance of single microimages from the lattice, robust RMS [px]."""
        return float(np.sqrt(np.average((self.offsets**2).sum(1), weights=self.weight)))

    def half_difference(self) -> float:
        """RMS distance [px] over the flat between the steps of two halves of the microimages.

        The halves are every other microimage and the rest.
        """
        one, two = (self.equations.half(k).solve(self.weight[k::2]).change for k in (0, 1))
        return field_rms(self.jacobian, one - two)

    def gains(self, sums: Sums) -> Floats:
        """(n,) relative change of the gains of lenses."""
        moved = self.equations.jacobian @ self.change
        explained = (sums.normal[:, :-1, -1] * moved).sum(1)
        gain = (sums.right[:, -1] - explained) / np.maximum(sums.normal[:, -1, -1], 1e-30)
        return np.clip(gain, -0.5, 1)


@dataclass(frozen=True)
class Fit(Generic[Model]):
    """A lattice with the fitted distortion `orders`, the light of its lenses, and the last step."""

    lattice: Lattice
    orders: tuple[str, ...]
    lenses: Model
    step: Step


def converge(
    lattice: Lattice, lenses: Model, orders: tuple[str, ...], weigh_lenses: bool = True
) -> Fit[Model]:
    """Gauss-Newton passes until a step is shorter than `_CONVERGED`.

    With `weigh_lenses`, lenses far from the lattice count less. Raises `CalibrationError` if the
    microimages show no edges, or keep to no lattice.
    """
    start = lattice.basis
    weight = None if weigh_lenses else np.ones(len(lenses.indices))
    for _ in range(10):
        sums = lenses.sums()
        before = lenses.parameters
        step = Equations.of(lenses, lattice, orders, eliminate_gains(sums)).solve(weight)
        lattice = lattice.moved(step.of_lattice, step.names)
        if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _LARGEST_CHANGE:
            raise CalibrationError(_NO_LATTICE)
        lenses = lenses.learn(sums, step, lattice)
        if step.is_short(lenses.parameters - before):
            break
    return Fit(lattice, orders, lenses, step)


def select_orders(fit: Fit[Model]) -> Fit[Model]:
    """The fit with a radial distortion, and a general one, as far as they are significant."""
    return _try(_try(fit, ("k1",)) if not fit.orders else fit, ("general",))


def _try(fit: Fit[Model], orders: tuple[str, ...]) -> Fit[Model]:
    """The fit with these `orders` of distortion if they explain it better, else as it is."""
    if set(orders) <= set(fit.orders) or not explains_better(fit, orders):
        return fit
    try:
        return converge(add_distortion(fit.lattice, "general" in orders), fit.lenses, orders)
    except (CalibrationError, ValueError):
        return fit


def explains_better(fit: Fit[Model], orders: tuple[str, ...]) -> bool:
    """Whether the distortion parameters `orders` would explain a converged fit better.

    Its last step is solved again with them: they count if they are significant, and move centres by
    more than `NEGLIGIBLE` [px, RMS].
    """
    lattice = add_distortion(fit.lattice, "general" in orders)
    last = fit.step.equations
    equations = Equations.of(fit.lenses, lattice, orders, (last.normal, last.right))
    step = equations.solve(fit.step.weight)
    new = np.array([name in orders and name not in fit.orders for name in step.names])
    change = step.of_lattice[new]
    places = np.flatnonzero(new)
    size = change @ np.linalg.pinv(step.covariance[np.ix_(places, places)]) @ change / len(places)
    return bool(size > SIGNIFICANT**2 and step.shift_rms > NEGLIGIBLE)


def add_distortion(lattice: Lattice, general: bool = False) -> Lattice:
    """The lattice with a distortion of zero strength if it has none, or with a `general` one."""
    bend = lattice.distortion or Distortion.zero(lattice.image_size)
    if general and bend.general is None:
        bend = replace(
            bend,
            general=np.zeros((2, GENERAL_TERMS)),
            middle=(np.array(lattice.image_size) - 1) / 2,
        )
    return replace(lattice, distortion=bend)
