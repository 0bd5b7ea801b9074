"""Calibration of focused plenoptic cameras: find the microimages on a flat."""

from . import console
from .calibrate import calibrate
from .calibration import Calibration, load
from .errors import CalibrationError, CameraFileError, FlatError, LightFieldError
from .flat import read_flat
from .lattice import Lattice
from .outfile import OutputError, check_output, whole_file
from .published import read_published
from .vignetting import Vignetting

__all__ = [
    "Calibration",
    "CalibrationError",
    "CameraFileError",
    "FlatError",
    "Lattice",
    "LightFieldError",
    "OutputError",
    "Vignetting",
    "calibrate",
    "check_output",
    "console",
    "load",
    "read_flat",
    "read_published",
    "whole_file",
]
