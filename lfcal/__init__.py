"""Calibration of focused plenoptic cameras: find the microimages on a flat."""

from .calibrate import calibrate
from .camera.calibration import Calibration, load
from .camera.lens_types import LensTypes
from .camera_files.published import read_published
from .camera_files.read_write import convert, read_camera
from .display.compare import LatticeDifference, compare
from .display.fit_check import Agreement, agreement
from .display.overlay import show
from .gain.vignetting import Vignetting
from .images.read import count_pages, read_flat
from .images.stream import FlatSource, open_flat
from .lattice.lattice import Lattice
from .lattice.residuals import Residuals
from .lattice.standard_errors import LatticeErrors
from .runtime import console, notebook
from .runtime import openmp_spin as openmp_spin
from .runtime.errors import CalibrationError, CameraFileError, FlatError, LightFieldError
from .runtime.output_file import OutputError, check_output, whole_file

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
