"""Shape and orientation of a lattice in words."""

from __future__ import annotations

import numpy as np

from .lattice import Lattice

# Share of a side, and cosine, up to which a cell counts as square.
_TOLERANCE = 0.03

__all__ = ["describe_orientation"]


def describe_orientation(lattice: Lattice) -> tuple[str, str, float]:
    """Shape, direction of the rows of nearest neighbours, and rotation from that direction [degrees]."""
    a1, a2 = lattice.basis
    lengths = np.hypot(*a1), np.hypot(*a2)
    hexagonal = len(lattice.steps) == 6
    if hexagonal:
        shape = "hexagonal"
    elif abs(a1 @ a2) > _TOLERANCE * lengths[0] * lengths[1]:
        shape = "oblique"
    else:
        shape = "square" if min(lengths) > (1 - _TOLERANCE) * max(lengths) else "rectangular"
    period = 60.0 if hexagonal else 90.0
    turned = (float(np.degrees(np.arctan2(a1[1], a1[0]))) + period / 2) % period - period / 2
    if hexagonal and abs(turned) > 15:
        return shape, "vertical", turned - np.copysign(30.0, turned)
    return shape, "horizontal" if hexagonal else "both ways", turned
