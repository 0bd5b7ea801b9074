"""Optics and poses for other programs: `.js` of libpleno, and a pinhole camera of OpenCV.

libpleno (github.com/comsee-research/libpleno) is the library of the toolbox COMPOTE (Labussiere et
al. 2022). The pinhole camera is equivalent for all-in-focus pictures. It has `K` and the five
coefficients of OpenCV, which are fitted over the field of the flat because OpenCV distorts in the
other direction.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from ..camera.calibration import Calibration
from ..camera.optics import Optics, object_slopes, turn_to_array
from ..runtime.arrays import Array
from ..runtime.errors import CameraFileError
from ..runtime.input_file import read_text
from ..runtime.output_file import atomic_write
from .result import MetricCalibration

__all__ = ["Pinhole", "equivalent_pinhole", "read_libpleno", "write_libpleno", "write_pinhole"]

# Points across and down a flat to which the distortion of the pinhole is fitted.
_GRID = (25, 19)


class Pinhole(NamedTuple):
    """OpenCV's model of a camera."""

    matrix: Array  # (3, 3) [px] `K`
    distortion: Array  # (5,) `k1, k2, p1, p2, k3`
    size: tuple[int, int]  # [px] width and height of the picture
    error: float  # [px] largest difference from the optics over the field


def equivalent_pinhole(calibration: Calibration) -> Pinhole:
    """The pinhole camera of all-in-focus pictures, in pixels of the flat.

    The pinhole is the centre of the entrance pupil of the main lens. CameraFileError if the camera
    has no optics.
    """
    from scipy.optimize import least_squares

    optics = calibration.optics
    if optics is None or optics.principal_point is None:
        raise CameraFileError(
            "the camera holds no measured optics; make them with 'lfcal metric FLAT...'"
        )
    width, height = calibration.image_size
    focal = (optics.mla_distance + optics.sensor_distance) / optics.pixel
    across, down = _GRID
    x, y = np.meshgrid(np.linspace(0, width - 1, across), np.linspace(0, height - 1, down))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    bent = (*optics.radial, *optics.tangential)
    slopes = object_slopes((pixels - optics.principal_point) / focal, bent)
    points = np.column_stack([slopes, np.ones(len(slopes))])

    def matrix(p: Array) -> Array:
        return np.array([[p[0], 0, p[1]], [0, p[0], p[2]], [0, 0, 1.0]])

    def off(p: Array) -> Array:
        seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(p), p[3:])
        return seen.ravel() - pixels.ravel()

    found = np.array([focal, *optics.principal_point, 0, 0, 0, 0, 0])
    if any(bent):
        # Tangential coefficients are a thousandth of the radial ones.
        found = least_squares(off, found, x_scale=[focal, 1, 1, 1, 1, 1e-3, 1e-3, 1]).x
    error = float(np.hypot(*off(found).reshape(-1, 2).T).max())
    return Pinhole(matrix(found), found[3:], (width, height), error)


def write_pinhole(path: str | os.PathLike[str], calibration: Calibration) -> None:
    """Write `equivalent_pinhole` as `.yml`, `.xml` or `.json`, which `cv2.FileStorage` reads."""
    pinhole = equivalent_pinhole(calibration)
    suffix = Path(path).suffix.lower()
    known = (".yml", ".yaml", ".xml", ".json")
    if suffix not in known:
        raise CameraFileError(f"{path}: unknown format of a pinhole camera; use {', '.join(known)}")
    # OpenCV would write into the final file; the text is written to a temporary file instead.
    storage = cv2.FileStorage(f"camera{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    width, height = pinhole.size
    figures: dict[str, Any] = {
        "image_width": width,
        "image_height": height,
        "camera_matrix": pinhole.matrix,
        "distortion_coefficients": pinhole.distortion[None],
    }
    for name, value in figures.items():
        storage.write(name, value)
    text = storage.releaseAndGetString()
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_libpleno(path: str | os.PathLike[str], result: MetricCalibration) -> None:
    """Write an `intrinsics.js` of libpleno, and the poses as `NAME-poses.js` beside it.

    Numbers are written as strings, as libpleno does. Poses are those of the camera in the frame of
    the board. `distortions` leads from the ideal image point [mm] to the real one, and
    `distortions_inverse` back. The grid of the microimages (`mia`) is not written: libpleno
    calibrates it itself.
    """
    calibration = result.calibration
    optics = result.optics
    inverse = equivalent_pinhole(calibration).distortion[[0, 1, 4, 2, 3]]
    far = optics.mla_distance
    near = optics.sensor_distance
    pixel = optics.pixel
    principal = optics.principal_point
    assert principal is not None
    width, height = calibration.image_size
    pitch = calibration.lattice.pitch * pixel / (1 + near / far)
    # A rotation stays the same if both frames are turned upside down.
    axes = turn_to_array(optics.tilt).T
    start = [-(size - 1 - at) * pixel for size, at in zip((width, height), principal, strict=True)]
    types = calibration.lens_types
    # Mode 1: microlenses focus images in front of them; mode 2, also if unknown: behind them.
    front = False
    if types is not None and types.focus is not None and np.isfinite(types.focus).any():
        front = float(np.nanmedian(types.focus)) >= 0
    data = {
        "D": far,
        "d": near,
        "I": len(optics.microlens_focal_lengths),
        "distortions": _distortion_mm(inverse, far),
        "distortions_inverse": _distortion_mm(np.array([*optics.radial, *optics.tangential]), far),
        "main_lens": {"f": optics.focal_length, "pose": _pose(np.eye(3), np.zeros(3))},
        "mla": {
            "focal_lengths": list(optics.microlens_focal_lengths),
            "mesh": {
                "geometry": int(len(calibration.lattice.steps) == 6),
                "pitch": [[pitch, pitch]],
                "pose": _pose(axes, [*start, -far]),
            },
        },
        "mode": 1 if front else 2,
        "pp": [list(principal)],
        "sensor": {
            "width": width,
            "height": height,
            "scale": pixel,
            "pose": _pose(axes, [*start, -(far + near)]),
        },
    }
    _write_js(Path(path), data)
    poses = [
        {"frame": p.name, "pose": _pose(p.rotation.T, -p.rotation.T @ p.translation)}
        for p in result.poses
    ]
    _write_js(Path(path).with_stem(f"{Path(path).stem}-poses"), {"poses": poses})


def read_libpleno(path: str | os.PathLike[str]) -> Optics:
    """The optics in an `intrinsics.js` of libpleno; CameraFileError if it is not readable."""

    def row(values: Any) -> list[float]:
        """The numbers of a vector, which libpleno writes as a matrix of one row."""
        return [float(v) for v in np.ravel(values)]

    try:
        data = json.loads(read_text(path))
        far = float(data["D"])
        bent = data.get("distortions_inverse", {})
        k1, k2, k3 = row(bent.get("radial", (0, 0, 0)))
        along, across = (-p * far for p in row(bent.get("tangential", (0, 0))))
        x, y, *_ = row(data["pp"]) if "pp" in data else (None, None)
        return Optics(
            float(data["main_lens"]["f"]),
            far,
            float(data["d"]),
            float(data["sensor"]["scale"]),
            principal_point=None if x is None or y is None else (x, y),
            radial=(k1 * far**2, k2 * far**4, k3 * far**6),
            tangential=(across, along),
            microlens_focal_lengths=tuple(row(data.get("mla", {}).get("focal_lengths", ()))),
        )
    except OSError as error:
        raise CameraFileError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise CameraFileError(
            f"{path}: not the intrinsics of libpleno ({type(error).__name__}: {error}); give its "
            "intrinsics.js"
        ) from error


def _distortion_mm(coefficients: Array, far: float) -> dict[str, Any]:
    """Coefficients `k1, k2, k3, p1, p2` for lengths [mm] in an image plane at `far` [mm].

    The frame is turned by 180 degrees.
    """
    k1, k2, k3, p1, p2 = coefficients
    radial = [k1 / far**2, k2 / far**4, k3 / far**6]
    tangential = [-p2 / far, -p1 / far]
    return {"model": 0, "radial": [radial], "tangential": [tangential], "depth": [[0.0, 0.0, 0.0]]}


def _pose(rotation: Array, translation: Sequence[float] | Array) -> dict[str, Any]:
    return {
        "rotation": np.asarray(rotation).tolist(),
        "translation": [np.asarray(translation).tolist()],
    }


def _write_js(path: Path, data: dict[str, Any]) -> None:
    def as_strings(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: as_strings(one) for name, one in value.items()}
        if isinstance(value, list):
            return [as_strings(one) for one in value]
        if isinstance(value, float):
            return f"{value:.17g}"
        return str(value)

    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(as_strings(data), indent=4) + "\n", encoding="utf-8")
