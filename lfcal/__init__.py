"""Calibration of focused plenoptic cameras: find the microimages on a flat, measure the optics on a board."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .boards.board import Board
    from .camera.calibration import Calibration
    from .camera.lens_types import LensBlur, LensTypes
    from .camera.optics import Optics
    from .camera_files.read_write import load
    from .display.compare import compare
    from .display.fit_check import CameraCheck, check_camera, check_fit
    from .display.overlay import show
    from .images.read import count_pages, read_flat
    from .images.stream import FlatSource, open_flat, subtract_dark
    from .lattice.lattice import Lattice
    from .lattice.stated import state_lattice
    from .metric.calibrate import calibrate_metric, locate_board
    from .metric.result import BoardPose, MetricCalibration
    from .pipeline import calibrate
    from .runtime.errors import BoardError, CalibrationError, CameraFileError, FlatError, LightFieldError
    from .runtime.output_file import OutputError

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
    "LensBlur",
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
    "state_lattice",
    "subtract_dark",
]

# Imported at first use, since `--help` needs none of it. No module may bear the name of a function here, or importing
# the one would hide the other.
_HOMES = {
    "Board": "boards.board",
    "BoardError": "runtime.errors",
    "BoardPose": "metric.result",
    "Calibration": "camera.calibration",
    "CalibrationError": "runtime.errors",
    "CameraCheck": "display.fit_check",
    "CameraFileError": "runtime.errors",
    "FlatError": "runtime.errors",
    "FlatSource": "images.stream",
    "Lattice": "lattice.lattice",
    "LensBlur": "camera.lens_types",
    "LensTypes": "camera.lens_types",
    "LightFieldError": "runtime.errors",
    "MetricCalibration": "metric.result",
    "Optics": "camera.optics",
    "OutputError": "runtime.output_file",
    "calibrate": "pipeline",
    "calibrate_metric": "metric.calibrate",
    "check_camera": "display.fit_check",
    "check_fit": "display.fit_check",
    "compare": "display.compare",
    "count_pages": "images.read",
    "load": "camera_files.read_write",
    "locate_board": "metric.calibrate",
    "open_flat": "images.stream",
    "read_flat": "images.read",
    "show": "display.overlay",
    "state_lattice": "lattice.stated",
    "subtract_dark": "images.stream",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
