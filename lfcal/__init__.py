"""Calibration of focused plenoptic cameras: find the microimages on a flat."""

from . import console, notebook
from . import waiting as waiting
from .agreement import Agreement, agreement
from .calibrate import calibrate
from .calibration import Calibration, load
from .compare import LatticeDifference, compare
from .errors import CalibrationError, CameraFileError, FlatError, LightFieldError
from .exchange import convert, read_camera
from .flat import count_pages, read_flat
from .flat_source import FlatSource, open_flat
from .lattice import Lattice
from .lattice_errors import LatticeErrors
from .lens_types import LensTypes
from .outfile import OutputError, check_output, whole_file
from .published import read_published
from .residuals import Residuals
from .show import show
from .vignetting import Vignetting

__all__ = [
    "Agreement",
    "Calibration",
    "CalibrationError",
    "CameraFileError",
    "FlatError",
    "FlatSource",
    "Lattice",
    "LatticeDifference",
    "LatticeErrors",
    "LensTypes",
    "LightFieldError",
    "OutputError",
    "Residuals",
    "Vignetting",
    "agreement",
    "calibrate",
    "check_output",
    "compare",
    "console",
    "convert",
    "count_pages",
    "load",
    "notebook",
    "open_flat",
    "read_camera",
    "read_flat",
    "read_published",
    "show",
    "whole_file",
]
