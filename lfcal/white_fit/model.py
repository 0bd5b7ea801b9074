"""Global parameters of a white image's model: how the discs of all lenses follow lattice, distortion and cat-eye."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from .normal_equations import LOCAL_PARAMETERS

__all__ = ["CatEye", "WhiteModel", "apply_step", "build_jacobian", "field_position", "step_limits"]

# No step moves a disc, or changes its radius, by more than this share of the radius.
_LONGEST = 0.1
# Nor the softness of the cut by more than this share, nor its correlation with the other edge by more than that.
_SOFTENS, _SHARES = 0.3, 0.2
# Softest edge of a cutting disc over its radius, and the sharpest edge that pixels of finite size show [px].
_SOFTEST = 0.1
_SHARPEST = 0.2
# Variance of the place in a pixel along one of its sides [px^2].
_PIXEL = 1 / 12
# Edges that run alike are never blurred quite alike.
_MOST_SHARED = 0.98


@dataclass(frozen=True)
class CatEye:
    """Disc that cuts the microimages, at `shift + field * (g1 + g2 * |field| + g3 * |field|**2)` from their centres.

    `field` is the place in the field, of length 1 in the corners (`field_position`).

    Parameters
    ----------
    shift : (2,) float64 [px]
        Displacement in the middle of the flat.
    growth : (3,) float64 [px]
        `g1, g2, g3`, positive outwards.
    radius, soft : float [px]
        Radius of the cutting disc and standard deviation of its edge.
    shared : float
        Correlation of the blur of the two edges where they run alike, 0..1: 1 where light passes both discs before
        anything blurs it.
    """

    shift: NDArray[np.float64]
    growth: NDArray[np.float64]
    radius: float
    soft: float
    shared: float = 0.7

    @property
    def least_shared(self) -> float:
        """Correlation of the blur that pixels alone give both edges: their area is the last that light meets."""
        return min(_PIXEL / self.soft**2, _MOST_SHARED)

    def blurred(self, soft: float) -> CatEye:
        """With the softness of its edge on the way to another [px], as far as one step goes and pixels can show."""
        least, most = (1 - _SOFTENS) * self.soft, (1 + _SOFTENS) * self.soft
        soft = float(np.clip(np.clip(soft, least, most), _SHARPEST, _SOFTEST * self.radius + _SHARPEST))
        eye = replace(self, soft=soft)
        return replace(eye, shared=max(eye.shared, eye.least_shared))

    def displacement(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) displacement [px] of the cutting disc at places (n, 2) of the field."""
        far = np.hypot(*field.T)[:, None]
        return self.shift + field * (self.growth[0] + self.growth[1] * far + self.growth[2] * far**2)


@dataclass(frozen=True)
class WhiteModel:
    """Lattice and cat-eye (None where microimages are whole)."""

    lattice: Lattice
    cat_eye: CatEye | None


def field_position(centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) place in the field, of length 1 in the corners."""
    size = np.array(lattice.image_size)
    return (centres - (size - 1) / 2) / (np.hypot(*size) / 2)


def build_jacobian(
    model: WhiteModel, indices: NDArray[np.int64], orders: tuple[str, ...]
) -> tuple[NDArray[np.float64], list[str]]:
    """Change of the local parameters of each lens with the global ones.

    Parameters
    ----------
    model : WhiteModel
    indices : (n, 2) int64
        Lattice indices of the lenses.
    orders : tuple of {"k1", "centre", "k2", "general", "growth2", "growth3"}
        Parameters beyond origin, basis and a cat-eye that grows evenly.

    Returns
    -------
    (n, 6, p) float64, list of p names
        Only the two of the place, (n, 2, p), where the model has no cat-eye.
    """
    n, own = len(indices), 2 if model.cat_eye is None else LOCAL_PARAMETERS - 1
    columns: list[NDArray[np.float64]] = []
    names: list[str] = []

    def add(name: str, first: int, values: NDArray[np.float64]) -> None:
        column = np.zeros((n, own))
        column[:, first : first + values.shape[1]] = values
        columns.append(column)
        names.append(name)

    unit = np.eye(2)
    straight = model.lattice.origin + indices @ model.lattice.basis
    for factor, name in zip((np.ones(n), *indices.T), ("origin", "a1", "a2"), strict=True):
        for axis in range(2):
            add(name, 0, factor[:, None] * unit[axis])
    bend = model.lattice.distortion
    if bend is not None:
        for name, values in bend.derivatives(straight):
            if name in orders:
                add(name, 0, values)
    if model.cat_eye is not None:
        field = field_position(straight if bend is None else bend.apply(straight), model.lattice)
        far = np.hypot(*field.T)[:, None]
        for axis in range(2):
            add("shift", 2, np.ones((n, 1)) * unit[axis])
        add("growth", 2, field)
        for power in (2, 3):
            if f"growth{power}" in orders:
                add(f"growth{power}", 2, field * far ** (power - 1))
        add("radius", 4, np.ones((n, 1)))
        add("shared", 5, np.ones((n, 1)))
    return np.stack(columns, axis=2), names


def step_limits(eye: CatEye, names: list[str]) -> NDArray[np.float64]:
    """(p,) how far the parameters `names` of `build_jacobian` can go in one step; infinite for those of the lattice."""
    most = _LONGEST * eye.radius
    limits = {"radius": most, "shift": most, "shared": _SHARES}
    return np.array([most if name.startswith("growth") else limits.get(name, np.inf) for name in names])


def apply_step(model: WhiteModel, change: NDArray[np.float64], names: list[str]) -> WhiteModel:
    """The model after a step `change` (p,) of the parameters `names` of `build_jacobian`."""
    by = {name: change[[k for k, other in enumerate(names) if other == name]] for name in names}
    old = model.lattice
    bend = old.distortion if old.distortion is None else old.distortion.updated(by)
    lattice = replace(
        old, origin=old.origin + by["origin"], basis=old.basis + np.array([by["a1"], by["a2"]]), distortion=bend
    )
    eye = model.cat_eye
    if eye is None:
        return WhiteModel(lattice, None)
    most = _LONGEST * eye.radius
    growth = np.array([float(by.get(name, [0.0])[0]) for name in ("growth", "growth2", "growth3")])
    return WhiteModel(
        lattice,
        CatEye(
            eye.shift + np.clip(by["shift"], -most, most),
            eye.growth + np.clip(growth, -most, most),
            eye.radius + float(np.clip(by["radius"][0], -most, most)),
            eye.soft,
            float(np.clip(eye.shared + np.clip(by["shared"][0], -_SHARES, _SHARES), eye.least_shared, _MOST_SHARED)),
        ),
    )
