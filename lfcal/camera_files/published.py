"""What the published files share: numbers by their names, and lattices of which they name the corner centres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.errors import CameraFileError

__all__ = ["PublishedNumbers", "calibration_from_corners"]


class PublishedNumbers(dict[str, str]):
    """The texts of a file by their names, read as finite numbers; CameraFileError with the name where one is none."""

    def number(self, name: str) -> float:
        """A finite number."""
        if name not in self:
            raise CameraFileError(f"'{name}' is missing")
        try:
            value = float(self[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise CameraFileError(f"'{name}' is {self[name].strip()!r}, not a number")
        return value

    def positive(self, name: str) -> float:
        """A positive number."""
        value = self.number(name)
        if value <= 0:
            raise CameraFileError(f"{name} must be positive, got {value}")
        return value

    def point(self, x: str, y: str) -> NDArray[np.float64]:
        """(2,) two numbers."""
        return np.array([self.number(x), self.number(y)])


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
        slip = np.sign(float(sideways @ along)) or 1.0
        sideways = sideways - slip * 0.5 * along / rows
    first = np.mean(corners, axis=0) - (down + across) / 2
    lattice = Lattice(first, reduce_basis([along, sideways + along / 2]), image_size, pitch / 2)
    warning = "only the corner centres are published, good to a few pixels; calibrate on a flat for better"
    return Calibration(lattice, warnings=(warning,))
