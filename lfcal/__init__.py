"""Calibration of focused plenoptic cameras: find the microimages on a flat, measure the optics on a board."""

from typing import TYPE_CHECKING, Any

from .calibrate import calibrate
from .camera.calibration import Calibration
from .camera.lens_types import LensTypes
from .camera.optics import Optics
from .camera_files.read_write import load
from .display.camera_check import CameraCheck, check_camera
from .display.compare import compare
from .display.fit_check import check_fit
from .display.overlay import show
from .images.read import count_pages, read_flat
from .images.stream import FlatSource, open_flat
from .lattice.lattice import Lattice
from .runtime import openmp_spin as openmp_spin
from .runtime.errors import BoardError, CalibrationError, CameraFileError, FlatError, LightFieldError
from .runtime.output_file import OutputError

if TYPE_CHECKING:
    from .boards.board import Board
    from .metric.calibrate import calibrate_metric, locate_board
    from .metric.result import BoardPose, MetricCalibration

__all__ = [
    "Board",
    "BoardError",
    "BoardPose",
    "Calibration",
    "CalibrationError",
    "CameraCheck",
    "CameraFileError",
    "FlatError",
    "FlatSource",
    "Lattice",
    "LensTypes",
    "LightFieldError",
    "MetricCalibration",
    "Optics",
    "OutputError",
    "calibrate",
    "calibrate_metric",
    "check_camera",
    "check_fit",
    "compare",
    "count_pages",
    "load",
    "locate_board",
    "open_flat",
    "read_flat",
    "show",
]

# Imported at first use: calibrating an array needs none of it.
_HOMES = {
    "Board": "boards.board",
    "BoardPose": "metric.result",
    "MetricCalibration": "metric.result",
    "calibrate_metric": "metric.calibrate",
    "locate_board": "metric.calibrate",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value
