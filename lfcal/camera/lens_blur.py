"""The blur of the microlenses of a camera: their aperture, and where each type is in focus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.frozen import Frozen

__all__ = ["LensBlur"]


@dataclass(frozen=True)
class LensBlur(Frozen):
    """Aperture and focus of the microlenses, which blur a place of patch size `s` over a disc of `A |s / D - f|`.

    Parameters
    ----------
    aperture : float [px]
        Diameter `A` of a microlens.
    focus : (types,) float64 [s / D]
        Where each type is in focus, `f`.
    covariance : (1 + types, 1 + types) float64
        Of the logarithm of the aperture and the foci.

    Examples
    --------
    >>> blur = LensBlur(6.0, [0.1], [[0.04, 0], [0, 0.01]])
    >>> round(blur.aperture_error, 3), blur.focus_error
    (1.2, (0.1,))
    """

    aperture: float
    focus: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def __post_init__(self) -> None:
        focus, covariance = np.array(self.focus, float), np.array(self.covariance, float)
        if not 0 < self.aperture < np.inf:
            raise ValueError(f"aperture of the microlenses must be positive, got {self.aperture!r}")
        if focus.ndim != 1 or not len(focus) or not np.isfinite(focus).all():
            raise ValueError(f"focus must be one number for each type, got {self.focus!r}")
        size = len(focus) + 1
        if covariance.shape != (size, size) or not np.isfinite(covariance).all() or (covariance.diagonal() < 0).any():
            raise ValueError(f"covariance of {size} values must be ({size}, {size}), got {self.covariance!r}")
        self._set(aperture=float(self.aperture), focus=focus, covariance=covariance)

    @property
    def aperture_error(self) -> float:
        """Standard error of the aperture [px]."""
        return float(self.aperture * np.sqrt(self.covariance[0, 0]))

    @property
    def focus_error(self) -> tuple[float, ...]:
        """Standard errors of the foci [s / D]."""
        return tuple(float(f) for f in np.sqrt(self.covariance.diagonal()[1:]))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        return {"aperture": self.aperture, "focus": self.focus.tolist(), "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, data: Any) -> LensBlur:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        return cls(float(data["aperture"]), np.array(data["focus"], float), np.array(data["covariance"], float))
