"""Smooth distortion of a microlens lattice: how far centres lie from the straight lattice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..runtime.arrays import Floats, Frozen

__all__ = ["GENERAL_TERMS", "Distortion"]

# Beyond this share of the distance to the middle neighbouring lenses change places.
_LARGEST = 0.3
# Powers of x and y of the general part, second and third order: fixed by the file format.
_POWERS = tuple((order - q, q) for order in (2, 3) for q in range(order + 1))
#: Terms of the general part in x, and as many in y.
GENERAL_TERMS = len(_POWERS)


@dataclass(frozen=True, eq=False)
class Distortion(Frozen):
    """Displacement of straight lattice points `s`: a radial part about a centre, and a general one
    about the middle.

    Radial: `(s - centre) * (k1 * (rho**2 - 1/2) + k2 * (rho**4 - 1/4))`, with `rho` the distance to
    the centre over half the diagonal of the flat. The subtracted constants leave to the basis what
    a straight lattice can follow: without its distortion the lattice is about the best straight
    one. General, for film and scanners: `sum of general[:, k] * x**p * y**q` over the powers `p, q`
    = 20, 11, 02, 30, 21, 12, 03 of the position `x, y` relative to `middle`, in units of half the
    diagonal.

    Parameters
    ----------
    centre : (2,) float64 [px]
        Where the radial part vanishes, order x, y.
    k1, k2 : float
        Strength of third and fifth order.
    reach : float [px]
        Half the diagonal of the flat.
    general : (2, 7) float64 [px] or None
        Displacement in x and in y; None where there is none.
    middle : (2,) float64 [px] or None
        Where the general part vanishes; needed where there is one.

    Examples
    --------
    >>> import numpy as np
    >>> distortion = Distortion(np.array([200.0, 150.0]), 0.01, 0.0, 250.0)
    >>> distortion.apply(np.array([[400.0, 150.0]])).round(2).tolist()
    [[400.28, 150.0]]
    """

    centre: Floats
    k1: float
    k2: float
    reach: float
    general: Floats | None = None
    middle: Floats | None = None

    def __post_init__(self) -> None:
        centre = np.array(self.centre, dtype=np.float64)
        if (
            centre.shape != (2,)
            or not np.isfinite([*centre, self.k1, self.k2, self.reach]).all()
            or self.reach <= 0
        ):
            raise ValueError(
                f"distortion must be finite numbers with reach > 0, got {self.centre!r}, "
                f"{self.reach!r}"
            )
        if abs(self.k1) + abs(self.k2) > _LARGEST:
            raise ValueError(
                f"distortion must stay below 0.3 in the corners, got {self.k1!r} and {self.k2!r}"
            )
        self._set(centre=centre, k1=float(self.k1), k2=float(self.k2), reach=float(self.reach))
        if self.general is None:
            self._set(middle=None)
            return
        general = np.array(self.general, dtype=np.float64)
        middle = np.array(self.middle, dtype=np.float64)
        if (
            general.shape != (2, len(_POWERS))
            or middle.shape != (2,)
            or not np.isfinite(middle).all()
        ):
            raise ValueError(
                f"general distortion must be (2, {len(_POWERS)}) numbers and a middle (2,)"
            )
        if not np.abs(general).sum(1).max() <= _LARGEST * self.reach:
            raise ValueError("general distortion must stay below 0.3 of half the diagonal")
        self._set(general=general, middle=middle)

    @classmethod
    def zero(cls, image_size: tuple[int, int]) -> Distortion:
        """A distortion of zero strength about the middle of a flat of this size [px]."""
        return cls((np.array(image_size) - 1) / 2, 0.0, 0.0, float(np.hypot(*image_size) / 2))

    def apply(self, points: ArrayLike) -> Floats:
        """(n, 2) distorted positions of straight lattice points (n, 2) [px]."""
        straight = np.asarray(points, dtype=np.float64)
        offset = straight - self.centre
        return straight + offset * self._radial_scale(offset) + self._general(straight)

    def remove(self, points: ArrayLike) -> Floats:
        """(n, 2) straight positions of `points` (n, 2) on the flat [px]."""
        bent = np.asarray(points, dtype=np.float64)
        straight = bent
        rounding = np.finfo(np.float64).eps * self.reach
        # Each turn gains two digits at the distortions of real lenses.
        for _ in range(12):
            before = straight
            # Dividing by the radial scale converges in fewer iterations than subtracting the
            # displacement.
            offset = straight - self.centre
            straight = self.centre + (bent - self._general(straight) - self.centre) / (
                1 + self._radial_scale(offset)
            )
            if np.abs(straight - before).max(initial=0) <= rounding:
                break
        return straight

    def scaled(self, scale: float) -> Distortion:
        """The distortion in pixels smaller by `scale`."""
        general = None if self.general is None else self.general * scale
        middle = None if self.middle is None else (self.middle + 0.5) * scale - 0.5
        return Distortion(
            (self.centre + 0.5) * scale - 0.5, self.k1, self.k2, self.reach * scale, general, middle
        )

    def derivatives(self, straight: Floats) -> list[tuple[str, Floats]]:
        """Names of the parameters, and derivative (n, 2) of the displacement of points (n, 2) by
        each of them.

        `"centre"` comes twice, for x and y; `"general"` fourteen times, all of x first.
        """
        offset = straight - self.centre
        square = (offset**2).sum(1, keepdims=True) / self.reach**2
        unit = np.eye(2)
        columns = [("k1", offset * (square - 0.5)), ("k2", offset * (square**2 - 0.25))]
        for axis in range(2):
            along = (
                2 * offset[:, [axis]] / self.reach**2 * offset * (self.k1 + 2 * self.k2 * square)
            )
            columns.append(("centre", -(self._radial_scale(offset) * unit[axis] + along)))
        if self.general is not None:
            powers = self._powers(straight)
            columns += [("general", power[:, None] * one) for one in unit for power in powers]
        return columns

    def updated(self, names: Sequence[str], change: Floats) -> Distortion:
        """The distortion after a change (p,) of `"k1"` or `"general"`, as in `derivatives`."""
        general = self.general
        k1 = self.k1
        if "k1" in names:
            k1 += float(change[names.index("k1")])
        if general is not None and "general" in names:
            general = general + change[-general.size :].reshape(general.shape)
        return Distortion(self.centre, k1, self.k2, self.reach, general, self.middle)

    def _general(self, straight: Floats) -> Floats | float:
        """Displacement (n, 2) [px] by the general part."""
        if self.general is None:
            return 0.0
        assert self.middle is not None
        x, y = np.moveaxis((straight - self.middle) / self.reach, -1, 0)
        out = np.empty(straight.shape)
        for axis, (xx, xy, yy, xxx, xxy, xyy, yyy) in enumerate(self.general):
            out[..., axis] = x * (x * (xx + xxx * x + xxy * y) + y * (xy + xyy * y))
            out[..., axis] += y * y * (yy + yyy * y)
        return out

    def _powers(self, straight: Floats) -> Floats:
        """(7, n) monomials of the position in the field."""
        assert self.middle is not None
        x, y = np.moveaxis((straight - self.middle) / self.reach, -1, 0)
        # Powers of arrays take ten times as long as products.
        of_x, of_y = ((np.ones_like(one), one, one * one, one * one * one) for one in (x, y))
        return np.stack([of_x[p] * of_y[q] for p, q in _POWERS])

    def _radial_scale(self, offset: Floats) -> Floats:
        """(n, 1) relative displacement of points at `offset` (n, 2) [px] from the centre."""
        x, y = np.moveaxis(offset / self.reach, -1, 0)
        square = (x * x + y * y)[..., None]
        return self.k1 * (square - 0.5) + self.k2 * (square * square - 0.25)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        data: dict[str, Any] = {
            "centre": self.centre.tolist(),
            "k1": self.k1,
            "k2": self.k2,
            "reach": self.reach,
        }
        if self.general is not None and self.middle is not None:
            data |= {"general": self.general.tolist(), "middle": self.middle.tolist()}
        return data

    @classmethod
    def from_dict(cls, data: Any) -> Distortion:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        return cls(
            data["centre"],
            data["k1"],
            data["k2"],
            data["reach"],
            data.get("general"),
            data.get("middle"),
        )
