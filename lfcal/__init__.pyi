from .assessment.result import Assessment, Finding
from .assessment.white import assess
from .boards.board import Board
from .camera.calibration import Calibration
from .camera.lens_types import LensBlur, LensTypes
from .camera.optics import Optics
from .camera_files.read_write import load
from .display.camera_check import CameraCheck, check_camera
from .display.compare import compare
from .display.fit_check import check_fit
from .display.overlay import show
from .illumination.aperture import widen_microimages
from .images.pixels import check_pixels
from .images.read import count_pages, read_flat
from .images.stream import FlatSource, open_flat, subtract_dark
from .lattice.lattice import Lattice
from .lattice.stated import state_lattice
from .lens_blur.captures import measure_lens_blur
from .metric.calibrate import calibrate_metric, locate_board
from .metric.result import BoardPose, MetricCalibration
from .pipeline import calibrate
from .runtime.errors import (
    BoardError,
    CalibrationError,
    CameraError,
    CameraFileError,
    FlatError,
    LightFieldError,
)
from .runtime.output_file import OutputError

__all__ = [
    "Assessment",
    "Board",
    "BoardError",
    "BoardPose",
    "Calibration",
    "CalibrationError",
    "CameraCheck",
    "CameraError",
    "CameraFileError",
    "Finding",
    "FlatError",
    "FlatSource",
    "Lattice",
    "LensBlur",
    "LensTypes",
    "LightFieldError",
    "MetricCalibration",
    "Optics",
    "OutputError",
    "assess",
    "calibrate",
    "calibrate_metric",
    "check_camera",
    "check_fit",
    "check_pixels",
    "compare",
    "count_pages",
    "load",
    "locate_board",
    "measure_lens_blur",
    "open_flat",
    "read_flat",
    "show",
    "state_lattice",
    "subtract_dark",
    "widen_microimages",
]
