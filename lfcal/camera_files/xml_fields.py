"""Numbers of published camera files, and the camera they make."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.errors import CameraFileError

__all__ = ["make_camera", "read_number", "read_point", "require_positive"]


def read_number(root: Any, name: str, where: str) -> float:
    text = root.findtext(name)
    if text is None:
        raise CameraFileError(f"{where}: <{name}> is missing")
    try:
        value = float(text)
    except ValueError:
        raise CameraFileError(f"{where}: <{name}> is {text.strip()!r}, not a number") from None
    if not np.isfinite(value):
        raise CameraFileError(f"{where}: <{name}> is not finite")
    return value


def read_point(root: Any, name: str, where: str) -> NDArray[np.float64]:
    return np.array([read_number(root, f"{name}/x", where), read_number(root, f"{name}/y", where)])


def require_positive(value: float, name: str, where: str) -> float:
    if value <= 0:
        raise CameraFileError(f"{where}: {name} must be positive, got {value}")
    return value


def make_camera(
    origin: NDArray[np.float64],
    basis: NDArray[np.float64],
    image_size: tuple[int, int],
    radius: float,
    warnings: list[str],
) -> Calibration:
    """Camera with the smallest basis of that lattice."""
    lattice = Lattice(origin, reduce_basis(basis), image_size, radius)
    return Calibration(lattice, None, "published", warnings=tuple(warnings))
