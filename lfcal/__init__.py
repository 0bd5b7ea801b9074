"""Calibration of focused plenoptic cameras: find the microimages on a flat, measure the optics on a
board.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .assessment.result import Assessment, Finding
    from .assessment.white import assess
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
    from .lens_blur.captures import measure_lens_blur
    from .metric.calibrate import calibrate_metric, locate_board
    from .metric.result import BoardPose, MetricCalibration
    from .pipeline import calibrate
    from .runtime.errors import (
        BoardError,
        CalibrationError,
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
]

# Imported at first use, since `--help` needs none of it. No module may bear the name of a function
# here, or importing the one would hide the other.
_HOMES = {
    "assessment.result": ("Assessment", "Finding"),
    "assessment.white": ("assess",),
    "boards.board": ("Board",),
    "camera.calibration": ("Calibration",),
    "camera.lens_types": ("LensBlur", "LensTypes"),
    "camera.optics": ("Optics",),
    "camera_files.read_write": ("load",),
    "display.compare": ("compare",),
    "display.fit_check": ("CameraCheck", "check_camera", "check_fit"),
    "display.overlay": ("show",),
    "images.read": ("count_pages", "read_flat"),
    "images.stream": ("FlatSource", "open_flat", "subtract_dark"),
    "lattice.lattice": ("Lattice",),
    "lattice.stated": ("state_lattice",),
    "lens_blur.captures": ("measure_lens_blur",),
    "metric.calibrate": ("calibrate_metric", "locate_board"),
    "metric.result": ("BoardPose", "MetricCalibration"),
    "pipeline": ("calibrate",),
    "runtime.errors": (
        "BoardError",
        "CalibrationError",
        "CameraFileError",
        "FlatError",
        "LightFieldError",
    ),
    "runtime.output_file": ("OutputError",),
}


def __getattr__(name: str) -> Any:
    home = next((home for home, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f".{home}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
