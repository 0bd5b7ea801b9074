"""The calibration that a published file describes: the lattice as it stands there, with warnings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.errors import CameraFileError

__all__ = ["calibration_from_corners", "published_calibration", "require_positive"]


def require_positive(value: float, name: str) -> float:
    """The value, or a CameraFileError where it is not positive."""
    if value <= 0:
        raise CameraFileError(f"{name} must be positive, got {value}")
    return value


def published_calibration(
    origin: NDArray[np.float64],
    basis: NDArray[np.float64],
    image_size: tuple[int, int],
    radius: float,
    warnings: list[str],
) -> Calibration:
    """Calibration with the reduced basis of that lattice."""
    lattice = Lattice(origin, reduce_basis(basis), image_size, radius)
    return Calibration(lattice, None, "published", warnings=tuple(warnings))


def calibration_from_corners(
    corners: list[NDArray[np.float64]], pitch: float, upright: bool, image_size: tuple[int, int]
) -> Calibration:
    """Hexagonal lattice through the outermost centres: left top, right top, left bottom, right bottom.

    `upright` lattices have rows of nearest neighbours that run down the flat.
    """
    left_top, right_top, left_low, right_low = corners
    down = ((left_low - left_top) + (right_low - right_top)) / 2
    across = ((right_top - left_top) + (right_low - left_low)) / 2
    along, sideways = (down, across) if upright else (across, down)
    rows = round(float(np.hypot(*sideways)) / (pitch * np.sqrt(0.75)))
    steps = round(float(np.hypot(*along)) / pitch)
    if rows < 1 or steps < 1:
        raise CameraFileError("the corner centres are less than a pitch apart")
    along, sideways = along / steps, sideways / rows
    if rows % 2:
        # The last row is shifted by half a step, to whichever side leaves the axes perpendicular.
        square = sideways - (sideways @ along) / (along @ along) * along
        slip = np.sign(float((sideways - square) @ along)) or 1.0
        sideways = sideways - slip * 0.5 * along / rows
    first = np.mean(corners, axis=0) - (down + across) / 2
    warning = "only the corner centres are published, good to a few pixels; calibrate on a flat for better"
    return published_calibration(first, np.array([along, sideways + along / 2]), image_size, pitch / 2, [warning])
