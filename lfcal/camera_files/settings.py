"""Tuned values of the camera file formats."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["DEFAULT", "CameraFileSettings"]


@dataclass(frozen=True)
class CameraFileSettings:
    """Tolerances in reading and writing camera files."""

    centre_tolerance: float = 1e-3  # [px] a format that moves centres further cannot hold the lattice; set by hand
    same_angle: float = math.radians(1.0)  # [rad] files give six digits: angles further apart are not rounding
    type_index_tolerance: float = 0.2  # [lattice steps] lens types further from whole indices are of another lattice
    nearest_depth: float = 1.0  # [virtual depth] least depth that Raytrix files give
    farthest_depth: float = 100.0  # [virtual depth] largest depth that Raytrix files give


DEFAULT = CameraFileSettings()
