"""Transfer function of the disc over which a microlens out of focus blurs."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats

__all__ = ["disc_transfer"]


def disc_transfer(periods: Floats) -> Floats:
    """Transfer function of a uniform disc, `2 J1(x) / x`, at `periods` (...) across its diameter.

    Summed by Gauss-Chebyshev quadrature over the profile of the disc (Abramowitz and Stegun 1964,
    25.4.40), exact to 1e-12: importing SciPy's Bessel functions takes longer than any use here.
    """
    phase = np.pi * periods
    count = 20 + int(0.7 * phase.max(initial=0.0))
    angle = np.pi * np.arange(1, count + 1) / (count + 1)
    weight = 2 / (count + 1) * np.sin(angle) ** 2
    return np.asarray(np.cos(phase[..., None] * np.cos(angle)) @ weight)
