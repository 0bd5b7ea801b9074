"""The blur of the microlenses of a camera: the disc over which each type blurs, by depth."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Frozen

__all__ = ["LensBlur"]


@dataclass(frozen=True, eq=False)
class LensBlur(Frozen):
    """Discs of defocus of the microlenses at some depths, and the aperture and focus that explain them.

    A microlens blurs a place of patch size `s` over a disc of `A |s / D - f|`. On a flat of one depth the disc is known
    much better than aperture and focus.

    Parameters
    ----------
    aperture, aperture_error : float [px]
        Diameter `A` of a microlens and its standard error.
    focus, focus_error : (types,) float64 [s / D]
        Where each type is in focus, `f`.
    ratios : (depths,) float64
        `s / D` at which discs were measured.
    discs, disc_errors : (types, depths) float64 [px]
        Diameters of the discs and their standard errors.

    Examples
    --------
    >>> blur = LensBlur(6.0, 1.2, [0.1], [0.1], [-0.3], [[2.4]], [[0.2]])
    >>> blur.discs.shape
    (1, 1)
    """

    aperture: float
    aperture_error: float
    focus: NDArray[np.float64]
    focus_error: NDArray[np.float64]
    ratios: NDArray[np.float64]
    discs: NDArray[np.float64]
    disc_errors: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not 0 < self.aperture < np.inf or not 0 <= self.aperture_error < np.inf:
            raise ValueError(f"aperture of the microlenses must be positive, got {self.aperture!r}")
        self._set(aperture=float(self.aperture), aperture_error=float(self.aperture_error))
        (types,), (depths,) = np.shape(self.focus), np.shape(self.ratios)
        shapes = {"focus": (types,), "focus_error": (types,), "ratios": (depths,)}
        for name, shape in (shapes | dict.fromkeys(("discs", "disc_errors"), (types, depths))).items():
            values = np.array(getattr(self, name), np.float64)
            if values.shape != shape or not np.isfinite(values).all() or (name == "disc_errors" and values.min() <= 0):
                raise ValueError(f"{name} of the blur must be {shape} finite numbers, errors positive, got {values}")
            self._set(**{name: values})

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        return {field.name: np.asarray(getattr(self, field.name)).tolist() for field in fields(self)}

    @classmethod
    def from_dict(cls, data: Any) -> LensBlur:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        return cls(**{field.name: data[field.name] for field in fields(cls)})
