"""Standard errors of a fitted lattice: of its parameters, and of each centre."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Frozen
from .lattice import Lattice

__all__ = ["LatticeErrors", "equal_weight_errors"]

_STRAIGHT_NAMES = ("origin", "origin", "a1", "a1", "a2", "a2")
_DISTORTION_NAMES = ("k1", "k2", "centre", "general")


@dataclass(frozen=True, eq=False)
class LatticeErrors(Frozen):
    """Covariance of the fitted parameters of a lattice.

    Parameters
    ----------
    names : tuple of p str
        `"origin"`, `"a1"`, `"a2"`, each for x and y [px]; then `"k1"`, `"k2"`, `"centre"` (twice, [px]) or `"general"`
        (14 times, [px]) as far as they were fitted.
    covariance : (p, p) float64

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> camera = lfcal.calibrate(sample.white, kind="white")
    >>> bool((camera.errors.of_centres(camera.lattice) < 0.1).all())
    True
    """

    names: tuple[str, ...]
    covariance: NDArray[np.float64]

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, dtype=np.float64)
        if covariance.shape != (len(self.names),) * 2 or not np.isfinite(covariance).all():
            raise ValueError(f"covariance must be finite, one row per name, got shape {covariance.shape}")
        if self.names[:6] != _STRAIGHT_NAMES or not set(self.names[6:]) <= set(_DISTORTION_NAMES):
            raise ValueError(f"names of fitted parameters are not known: {self.names}")
        self._set(covariance=covariance)

    @property
    def standard_errors(self) -> NDArray[np.float64]:
        """(p,) standard errors of the parameters."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0))

    @property
    def condition(self) -> float:
        """Condition number of the fit, 1 and more; infinite where the parameters cannot be told apart.

        Of the least-squares design with columns of unit length, so that units and the number of lenses do not matter.
        A flat of 33 x 29 lenses has 1.6, a strip of 70 x 9 whose radial distortion is fitted as well has 18.
        """
        errors = self.standard_errors
        if not (errors > 0).all():
            return float("inf")
        # Unit columns are those of the design, so the information matrix is scaled, not the covariance.
        information = np.linalg.pinv(self.covariance / np.outer(errors, errors))
        scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        values = np.linalg.eigvalsh(information / np.outer(scale, scale))
        return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")

    def of_centres(self, lattice: Lattice) -> NDArray[np.float64]:
        """(n,) standard errors [px] of the centres, in the order of `lattice.centres()`.

        Expected RMS distance of a centre from its true position, propagated from the covariance.
        """
        index = lattice.indices()
        straight = lattice.origin + index @ lattice.basis
        factors = np.column_stack([np.ones(len(index)), index])
        columns = [factors[:, [k]] * np.eye(2)[axis] for k in range(3) for axis in (0, 1)]
        if lattice.distortion is not None:
            columns += [values for name, values in lattice.distortion.derivatives(straight) if name in self.names]
        design = np.stack(columns, axis=2)
        spread = (design.reshape(-1, len(self.names)) @ self.covariance).reshape(design.shape)
        errors: NDArray[np.float64] = np.sqrt(np.maximum((design * spread).sum((1, 2)), 0))
        return errors

    def scaled(self, block: float) -> LatticeErrors:
        """The errors in units of pixels smaller by the factor `block`."""
        unit = np.array([1.0 if name in ("k1", "k2") else block for name in self.names])
        return LatticeErrors(self.names, self.covariance * np.outer(unit, unit))

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers and strings."""
        return {"names": list(self.names), "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, data: Any) -> LatticeErrors:
        """From `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        return cls(tuple(str(name) for name in data["names"]), np.array(data["covariance"], dtype=np.float64))


def equal_weight_errors(lattice: Lattice, uncertainty: float) -> LatticeErrors:
    """Errors of a straight lattice fitted to all its lenses with equal weights.

    `uncertainty` is the standard error of a centre, RMS over the flat [px].
    """
    index = lattice.indices()
    table = np.column_stack([np.ones(len(index)), index])
    per_axis: NDArray[np.float64] = uncertainty**2 * len(index) / 6 * np.linalg.inv(table.T @ table)
    return LatticeErrors(_STRAIGHT_NAMES, np.asarray(np.kron(per_axis, np.eye(2)), dtype=np.float64))
