"""How much of each spatial frequency is left: of a disc of defocus, a pixel, and bilinear interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["disc_transfer", "interpolation_transfer"]

# Nodes of the quadrature: exact up to some twenty periods across the disc.
_NODES = 32


def disc_transfer(frequency: ArrayLike, diameter: ArrayLike) -> NDArray[np.float64]:
    """Transfer function of a uniform disc, the blur of a defocused lens with a round aperture.

    The disc is projected onto a line and transformed by Gauss-Chebyshev quadrature of the second kind.

    Parameters
    ----------
    frequency : array_like [1 / px]
    diameter : array_like [px]
        Of a shape that broadcasts with `frequency`.

    Examples
    --------
    >>> disc_transfer(0.0, 3.0).round(3).item()
    1.0
    """
    angle = np.arange(1, _NODES + 1) * np.pi / (_NODES + 1)
    weight = 2 / (_NODES + 1) * np.sin(angle) ** 2
    phase = np.pi * np.asarray(frequency, float) * np.asarray(diameter, float)
    return np.asarray(np.cos(phase[..., None] * np.cos(angle)) @ weight)


def interpolation_transfer(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transfer function, along one axis, of bilinear interpolation of a flat that `prefilter_flat` has sharpened.

    Parameters
    ----------
    frequency : array [1 / px of the flat]
    """
    seen = np.minimum(np.abs(frequency), 1.0)
    return np.asarray(np.sinc(frequency) ** 2 * (1 + (1 - np.cos(2 * np.pi * seen)) / 6))
