"""Calibration of focused plenoptic cameras: find the microimages on a flat."""

from .calibrate import calibrate
from .camera.calibration import Calibration
from .camera.lens_types import LensTypes
from .camera.optics import Optics
from .camera_files.read_write import load
from .display.compare import compare
from .display.fit_check import check_fit
from .display.overlay import show
from .images.read import count_pages, read_flat
from .images.stream import FlatSource, open_flat
from .lattice.lattice import Lattice
from .runtime import openmp_spin as openmp_spin
from .runtime.errors import CalibrationError, CameraFileError, FlatError, LightFieldError
from .runtime.output_file import OutputError

__all__ = [
    "Calibration",
    "CalibrationError",
    "CameraFileError",
    "FlatError",
    "FlatSource",
    "Lattice",
    "LensTypes",
    "LightFieldError",
    "Optics",
    "OutputError",
    "calibrate",
    "check_fit",
    "compare",
    "count_pages",
    "load",
    "open_flat",
    "read_flat",
    "show",
]
