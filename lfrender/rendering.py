"""A rendered picture and where its pixels lie on the microlens plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rendering"]


@dataclass(frozen=True)
class Rendering:
    """A picture drawn from a flat.

    Parameters
    ----------
    image : (h, w) or (h, w, C) array
        Of the flat's dtype and number of channels; 0 where nothing was seen.
    affine : (2, 3) float64
        From output pixel `(u, v, 1)` to scene coordinates `X` of GEOMETRY.md [flat px].
    valid : (h, w) bool
        Pixels that at least one lens has seen.
    scale : float
        Output pixels per microlens pitch, `P`.
    """

    image: NDArray
    affine: NDArray[np.float64]
    valid: NDArray[np.bool_]
    scale: float
