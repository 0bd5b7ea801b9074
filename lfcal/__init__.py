"""Calibration of focused plenoptic cameras: find the microimages on a flat."""

from .calibration import Calibration, load
from .errors import CalibrationError, CameraFileError, FlatError, LightFieldError
from .lattice import Lattice
from .vignetting import Vignetting

__all__ = [
    "Calibration",
    "CalibrationError",
    "CameraFileError",
    "FlatError",
    "Lattice",
    "LightFieldError",
    "Vignetting",
    "load",
]
