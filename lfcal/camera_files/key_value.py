"""Camera files of lines `key : value`: hexagonal lattices, by four corner centres or by the central one."""

from __future__ import annotations

import numpy as np

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError
from .published_lattice import calibration_from_corners, published_calibration, require_positive

__all__ = ["format_key_value", "parse_key_value"]

_CORNERS = ("LeftTop", "RightTop", "LeftBottom", "RightBottom")


def parse_key_value(text: str, image_size: tuple[int, int] | None) -> Calibration:
    """The camera in such lines; `MLADirection` 1 has hexagons in upright rows."""
    pairs: dict[str, float] = {}
    for row, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        key, _, value = line.partition(":")
        try:
            pairs[key.strip()] = float(value)
        except ValueError:
            pairs[key.strip()] = np.nan
        if not np.isfinite(pairs[key.strip()]):
            raise CameraFileError(f"line {row} is not 'key : number'; is this a camera file?")

    def get(key: str) -> float:
        if key not in pairs:
            raise CameraFileError(f"'{key}' is missing")
        return pairs[key]

    size = (int(get("LensletWidth")), int(get("LensletHeight")))
    if image_size is not None and tuple(image_size) != size:
        raise CameraFileError(f"is for flats of {size[0]} x {size[1]} px, not of {image_size[0]} x {image_size[1]} px")
    pitch = require_positive(get("MIDiameter"), "MIDiameter")
    upright = get("MLADirection") == 1
    if "LeftTopMICenterX" in pairs:
        corners = [np.array([get(f"{name}MICenterX"), get(f"{name}MICenterY")]) for name in _CORNERS]
        return calibration_from_corners(corners, pitch, upright, size)
    origin = (np.array(size) - 1) / 2 + np.array([get("CentralMIOffsetX"), -get("CentralMIOffsetY")])
    basis = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    warnings = ["the file gives no angle finer than upright or level rows"]
    return published_calibration(origin, (basis[:, ::-1] if upright else basis) * pitch, size, pitch / 2, warnings)


def format_key_value(lattice: Lattice) -> str:
    """Key : value lines with the centres of four microimages at the corners of a parallelogram."""
    if len(lattice.steps) != 6:
        raise CameraFileError("the key : value format holds hexagonal lattices only; write .xml, .csv or .json")
    steps = lattice.steps @ lattice.basis
    upright = np.abs(steps[:, 1]).max() > np.abs(steps[:, 0]).max()
    axis = 1 if upright else 0
    along = steps[steps[:, axis].argmax()]
    # Two rows further the microimages stand side by side again.
    sideways = max((2 * step - along for step in steps), key=lambda v: v[1 - axis] / np.hypot(*v))
    across, down = (sideways, along) if upright else (along, sideways)
    width, height = lattice.image_size
    columns, rows = (max(1, int(size / np.hypot(*v)) - 1) for size, v in ((width, across), (height, down)))
    first = lattice.origin + lattice.middle @ lattice.basis - (columns // 2) * across - (rows // 2) * down
    corners = (first, first + columns * across, first + rows * down, first + columns * across + rows * down)
    lines = [f"LensletWidth : {width}", f"LensletHeight : {height}", f"MIDiameter : {lattice.pitch:.12f}"]
    lines.append(f"MLADirection : {int(upright)}")
    for name, corner in zip(_CORNERS, corners, strict=True):
        lines += [f"{name}MICenterX : {corner[0]:.9f}", f"{name}MICenterY : {corner[1]:.9f}"]
    return "\n".join(lines) + "\n"
