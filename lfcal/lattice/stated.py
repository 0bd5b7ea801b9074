"""Lattices that are stated instead of found: as a hint for the search, or all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..runtime.arrays import Floats
from ..runtime.errors import check_number, check_numbers
from .lattice import Lattice, describe_orientation, reduce_basis

__all__ = ["ARRANGEMENTS", "LatticeHint", "state_lattice"]

_ROOT = 0.75**0.5
#: Bases of pitch 1 by the name of their arrangement; rows of hexagonal arrays are those of nearest
#: neighbours.
ARRANGEMENTS = {
    "hexagonal": ((1.0, 0.0), (0.5, _ROOT)),
    "hexagonal-vertical": ((0.0, 1.0), (-_ROOT, 0.5)),
    "square": ((1.0, 0.0), (0.0, 1.0)),
}


@dataclass(frozen=True)
class LatticeHint:
    """What is known of a lattice beforehand.

    Parameters
    ----------
    pitch : float [px]
        Mean distance between neighbouring centres, right to a tenth.
    rotation : float or None [degrees]
        Clockwise on the screen, of rows from the horizontal, or of vertical rows from the vertical;
        right to 2 degrees.
    """

    pitch: float
    rotation: float | None = None

    def __post_init__(self) -> None:
        if not 0 < check_number(self.pitch, "pitch") < np.inf:
            raise ValueError(f"pitch must be a positive number of px, got {self.pitch!r}")
        if self.rotation is not None and not np.isfinite(check_number(self.rotation, "rotation")):
            raise ValueError(f"rotation must be a number of degrees, got {self.rotation!r}")

    def bases(self) -> list[Floats]:
        """Bases (2, 2) [px] of the usual arrangements, those of the pitch as stated first."""
        steps = sorted(np.arange(-2, 3) * 0.025, key=abs)
        turned = self.rotation or 0.0
        return [
            turned_basis(name, self.pitch * (1 + step), turned)
            for step in steps
            for name in ARRANGEMENTS
        ]

    def allows(self, lattice: Lattice) -> bool:
        """Whether a lattice is as stated."""
        if abs(lattice.pitch / self.pitch - 1) > 0.1:
            return False
        if self.rotation is None:
            return True
        period = 60.0 if len(lattice.steps) == 6 else 90.0
        off = (describe_orientation(lattice)[2] - self.rotation + period / 2) % period - period / 2
        # Of a hexagonal array, rows along one axis are 30 degrees from those along the other.
        return min(abs(off), abs(abs(off) - 30.0) if period == 60.0 else abs(off)) <= 2

    def scaled(self, factor: float) -> LatticeHint:
        """For a flat of which `factor` x `factor` pixels were averaged."""
        return LatticeHint(self.pitch / factor, self.rotation)


def turned_basis(arrangement: str, pitch: float, rotation: float) -> Floats:
    """Basis (2, 2) [px] of an arrangement, turned clockwise by `rotation` [degrees]."""
    angle = np.radians(rotation)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    basis: Floats = pitch * np.array(ARRANGEMENTS[arrangement]) @ turn
    return basis


def state_lattice(
    image_size: tuple[int, int],
    pitch: float,
    arrangement: Literal["hexagonal", "hexagonal-vertical", "square"] = "hexagonal",
    rotation: float = 0.0,
    centre: tuple[float, float] | None = None,
    radius: float | None = None,
) -> Lattice:
    """A lattice by its figures alone.

    Parameters
    ----------
    image_size : (int, int) [px]
    pitch : float [px]
    arrangement : {"hexagonal", "hexagonal-vertical", "square"}
    rotation : float [degrees]
        Clockwise on the screen.
    centre : (float, float), optional [px]
        Of any microimage; by default the middle of the flat.
    radius : float, optional [px]
        Usable one; by default half the pitch.

    Raises
    ------
    ValueError
        If a figure has no meaning.

    Examples
    --------
    >>> lattice = state_lattice((400, 300), 20.0, "square")
    >>> lattice.pitch, lattice.origin.tolist()
    (20.0, [199.5, 149.5])
    """
    if arrangement not in ARRANGEMENTS:
        raise ValueError(
            f"arrangement must be one of {', '.join(ARRANGEMENTS)}, got {arrangement!r}"
        )
    hint = LatticeHint(pitch, rotation)
    middle = (check_numbers(image_size, "image_size") - 1) / 2
    basis = reduce_basis(turned_basis(arrangement, hint.pitch, check_number(rotation, "rotation")))
    radius = hint.pitch / 2 if radius is None else radius
    return Lattice(middle if centre is None else np.array(centre), basis, image_size, radius)
