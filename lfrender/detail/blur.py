"""What blurs a picture: the discs of microlenses out of focus, as far as the camera file tells them, and reading.

A flat alone does not tell a soft scene from a blurred one, and undoing a blur that is not there makes rings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration

__all__ = ["disc_transfer", "interpolation_transfer", "sure_discs"]


def sure_discs(calibration: Calibration, ratios: NDArray[np.float64], doubt: float = 0.84) -> NDArray[np.float64]:
    """(types, n) diameters [px of the flat] of the discs of defocus at these `s / D`, by lens type.

    They are `doubt` standard errors smaller than the camera file tells, the lower fifth. Of several types, one is near
    its focus at any depth: what it is blurred by counts as the scene's.
    """
    types, known = calibration.lens_types, calibration.lens_blur
    count = 1 if types is None else types.count
    if known is None or len(known.focus) != count:
        return np.zeros((count, len(ratios)))
    order = np.argsort(known.ratios)
    least = np.maximum(known.discs - doubt * known.disc_errors, 0)[:, order]
    discs = np.stack([np.interp(ratios, known.ratios[order], one) for one in least])
    own = discs.min(0) if count > 1 else 0.0
    return np.asarray(np.sqrt(discs**2 - own**2))


def disc_transfer(frequency: ArrayLike, diameter: ArrayLike) -> NDArray[np.float64]:
    """Transfer function at a frequency [1 / px] of a uniform disc of this diameter [px]: Gauss-Chebyshev quadrature."""
    # As many nodes are exact up to some twenty periods across the disc.
    nodes = 32
    angle = np.arange(1, nodes + 1) * np.pi / (nodes + 1)
    weight = 2 / (nodes + 1) * np.sin(angle) ** 2
    phase = np.pi * np.asarray(frequency, float) * np.asarray(diameter, float)
    return np.asarray(np.cos(phase[..., None] * np.cos(angle)) @ weight)


def interpolation_transfer(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transfer function, at cycles per pixel along one axis, of bilinear interpolation of a flat from
    `prefilter_flat`."""
    seen = np.minimum(np.abs(frequency), 1.0)
    return np.asarray(np.sinc(frequency) ** 2 * (1 + (1 - np.cos(2 * np.pi * seen)) / 6))
