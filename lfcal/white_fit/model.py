"""Global parameters of a white image's model: lattice, distortion and the disc that cuts the microimages (cat-eye).

A stop in front of or behind the pupil of the main lens cuts microimages off the optical axis to lens shapes (mechanical
vignetting). The cut is a disc whose offset from the microimage depends on the position in the field.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from .settings import SOLVER, TWO_DISCS

__all__ = [
    "LOCAL_PARAMETERS",
    "CatEye",
    "TwoDiscs",
    "WhiteModel",
    "apply_step",
    "build_jacobian",
    "field_position",
    "step_limits",
]

# Parameters of a cut lens: x, y; offset of the cutting disc (2), its radius; correlation of the blur; gain.
LOCAL_PARAMETERS = 7


@dataclass(frozen=True)
class CatEye:
    """Disc that cuts the microimages, at `shift + field * (g1 + g2 * |field| + g3 * |field|**2)` from their centres.

    `field` is the position in the field, of length 1 in the corners (`field_position`).
    """

    shift: NDArray[np.float64]  # (2,) [px] offset in the middle of the flat
    growth: NDArray[np.float64]  # (3,) [px] `g1, g2, g3`, positive outwards
    radius: float  # [px]
    blur: float  # [px] standard deviation of its edge
    tail: float = 0.0  # of that blur (`edge_profile.estimate_edge_blur`)
    # Of the blur of the two edges where they run alike, 0..1: 1 if light passes both discs before anything blurs it.
    correlation: float = 0.7

    def displacement(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) offset [px] of the cutting disc at positions (n, 2) in the field."""
        far = np.hypot(*field.T)[:, None]
        return self.shift + field * (self.growth[0] + self.growth[1] * far + self.growth[2] * far**2)


@dataclass(frozen=True)
class TwoDiscs:
    """A lens (first) and the disc that cuts it (second), relative to the lattice that they were fitted on."""

    offset: NDArray[np.float64]  # (2, 2) [px] of their centres in the middle of the field
    growth: NDArray[np.float64]  # (2,) [px] further displacement in the corners, positive outwards
    bend: float  # [px] of both, in the corners, with the third power of the position
    radius: NDArray[np.float64]  # (2,) [px]
    blur: NDArray[np.float64]  # (2,) [px] standard deviation
    shading: NDArray[np.float64]  # (2,) share of light lost at `scale` from the centre of each
    gap: float  # light between microimages over that in their middle
    tail: float  # of the blur (`edge_profile.estimate_edge_blur`)
    correlation: float  # of the blur of edges that run alike
    # (3,) [px] of both, in the corners: x and y stretched unlike, sheared, turned
    shear: NDArray[np.float64]
    scale: float  # [px] about the radius of both
    radius_error: float  # [px] standard error of the difference of the radii
    shading_error: float  # of the difference of the shadings
    bend_error: float  # [px]
    correlation_error: float
    doubt: str | None = None  # why the second disc may be the lens

    @property
    def radius_variance(self) -> float:
        """Of one radius [px^2], that of the model of its edge included."""
        return 0.5 * (self.radius_error**2 + (TWO_DISCS.radius_fault * float(self.blur.mean())) ** 2)

    def interchanged(self) -> TwoDiscs:
        """With the other disc as the lens."""
        turned = {name: getattr(self, name)[::-1] for name in ("offset", "growth", "radius", "blur", "shading")}
        return replace(self, **turned)


@dataclass(frozen=True)
class WhiteModel:
    """Lattice and cat-eye (None where microimages are whole)."""

    lattice: Lattice
    cat_eye: CatEye | None
    discs: TwoDiscs | None = None  # edges from which the light of neighbours is known, where there is a cat-eye


def field_position(centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) position in the field, of length 1 in the corners of the flat."""
    size = np.array(lattice.image_size)
    return (centres - (size - 1) / 2) / (np.hypot(*size) / 2)


def build_jacobian(
    model: WhiteModel, indices: NDArray[np.int64], orders: tuple[str, ...]
) -> tuple[NDArray[np.float64], list[str]]:
    """Derivatives of the local parameters of lenses `indices` (n, 2) with the global ones, (n, 6, p), and p names.

    Only the two of the position, (n, 2, p), where the model has no cat-eye. `orders` are the parameters beyond origin,
    basis and a cat-eye that grows in proportion to the field: "k1", "centre", "k2", "general", "growth2", "growth3".
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
        add("correlation", 5, np.ones((n, 1)))
    return np.stack(columns, axis=2), names


def step_limits(eye: CatEye, names: list[str]) -> NDArray[np.float64]:
    """(p,) longest step of each of the parameters `names`; infinite for those of the lattice."""
    most = SOLVER.most_move * eye.radius
    limits = {"radius": most, "shift": most, "correlation": SOLVER.most_correlation_change}
    return np.array([most if name.startswith("growth") else limits.get(name, np.inf) for name in names])


def apply_step(model: WhiteModel, change: NDArray[np.float64], names: list[str]) -> WhiteModel:
    """The model after a step `change` (p,) of the parameters `names`."""
    by = {name: change[[k for k, other in enumerate(names) if other == name]] for name in names}
    old = model.lattice
    bend = old.distortion if old.distortion is None else old.distortion.updated(by)
    lattice = replace(
        old, origin=old.origin + by["origin"], basis=old.basis + np.array([by["a1"], by["a2"]]), distortion=bend
    )
    eye = model.cat_eye
    if eye is None:
        return WhiteModel(lattice, None)
    most, most_turn = SOLVER.most_move * eye.radius, SOLVER.most_correlation_change
    growth = np.array([float(by.get(name, [0.0])[0]) for name in ("growth", "growth2", "growth3")])
    correlation = eye.correlation + np.clip(by["correlation"][0], -most_turn, most_turn)
    return replace(
        model,
        lattice=lattice,
        cat_eye=CatEye(
            eye.shift + np.clip(by["shift"], -most, most),
            eye.growth + np.clip(growth, -most, most),
            eye.radius + float(np.clip(by["radius"][0], -most, most)),
            eye.blur,
            eye.tail,
            float(np.clip(correlation, 0.0, SOLVER.most_correlation)),
        ),
    )
