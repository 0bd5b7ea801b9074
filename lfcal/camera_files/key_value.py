"""Camera files of lines `key : value`: hexagonal lattices, by four corner centres or by the central one.

They are those of the converters for lenslet video (TLCT, RLC 4.0), whose programs expect `IsKepler` and, for three lens
types, `NearFocalLenType`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

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

    for key in ("LensletWidth", "LensletHeight"):
        if get(key) % 1 != 0 or get(key) < 1:
            raise CameraFileError(f"'{key}' must be a whole number of px, got {get(key)}")
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


def format_key_value(calibration: Calibration, mode: Literal["telescopic", "binocular"] | None = None) -> str:
    """Key : value lines with the centres of four microimages at the corners of a parallelogram.

    `IsKepler` is 1 for binocular captures: the flag names the modes the other way round. Without a `mode` it follows
    from the focus of the lens types, and is 1, which its readers take for granted, where that is not known. A camera of
    three lens types also gets the central microimage and `NearFocalLenType`, which its readers need together.
    """
    lattice = calibration.lattice
    if len(lattice.steps) != 6:
        raise CameraFileError("the key : value format holds hexagonal lattices only; write .xml, .csv or .json")
    steps = lattice.steps @ lattice.basis
    upright = bool(np.abs(steps[:, 1]).max() > np.abs(steps[:, 0]).max())
    axis = 1 if upright else 0
    along = steps[steps[:, axis].argmax()]
    # Two rows further the microimages stand side by side again.
    sideways = max((2 * step - along for step in steps), key=lambda v: v[1 - axis] / np.hypot(*v))
    across, down = (sideways, along) if upright else (along, sideways)
    middle = lattice.origin + lattice.middle @ lattice.basis
    first, columns, rows = _outermost(lattice, across, down)
    corners = (first, first + columns * across, first + rows * down, first + columns * across + rows * down)
    width, height = lattice.image_size
    mode = mode or _mode_of_types(calibration)
    lines = [f"IsKepler : {int(mode != 'telescopic')}"]
    lines += [f"LensletWidth : {width}", f"LensletHeight : {height}", f"MIDiameter : {lattice.pitch:.12f}"]
    lines.append(f"MLADirection : {int(upright)}")
    for name, corner in zip(_CORNERS, corners, strict=True):
        lines += [f"{name}MICenterX : {corner[0]:.9f}", f"{name}MICenterY : {corner[1]:.9f}"]
    near = _near_type(calibration, mode, middle, upright)
    if near is not None:
        offset = (middle - (np.array(lattice.image_size) - 1) / 2) * [1, -1]
        lines += [f"CentralMIOffset{name} : {value:.9f}" for name, value in zip("XY", offset, strict=True)]
        lines.append(f"NearFocalLenType : {near}")
    return "\n".join(lines) + "\n"


def _outermost(
    lattice: Lattice, across: NDArray[np.float64], down: NDArray[np.float64]
) -> tuple[NDArray[np.float64], int, int]:
    """The whole microimage at the top left, and how many steps `across` and `down` lead to the last whole ones.

    Readers take the first one for the first of its row and begin with its row.
    """
    low, high = lattice.pitch / 2 - 0.5, np.array(lattice.image_size) - 0.5 - lattice.pitch / 2
    middle = lattice.origin + lattice.middle @ lattice.basis
    straight = lattice.origin + lattice.indices() @ lattice.basis
    whole = straight[((straight >= low) & (straight <= high)).all(1)]
    first = whole[whole.sum(1).argmin()] if len(whole) else middle
    # In a turned lattice, the last ones may be beyond the border: at least one step is needed each way.
    steps = [max(1, int(np.min((high - first)[axis] / step[axis]))) for axis, step in ((0, across), (1, down))]
    return first, steps[0], steps[1]


def _mode_of_types(calibration: Calibration) -> Literal["telescopic", "binocular"] | None:
    """The mode that all lens types are focused at, None where that is not known."""
    focus = calibration.lens_types.focus if calibration.lens_types is not None else None
    if focus is None or not (np.isfinite(focus).all() and abs(np.sign(focus).sum()) == len(focus)):
        return None
    return "telescopic" if focus[0] > 0 else "binocular"


def _near_type(calibration: Calibration, mode: str | None, middle: NDArray[np.float64], upright: bool) -> int | None:
    """Number that such files give the lens type that is focused nearest, None where it is not known.

    They count the types along the first row of whole microimages, which runs down the flat if `upright`.
    """
    types, lattice = calibration.lens_types, calibration.lattice
    if types is None or types.count != 3 or not types.ordered:
        return None
    # Nearer objects have larger `s` of either sign.
    nearest = 0 if mode == "telescopic" else 2
    x, y = middle[::-1] + 0.5 if upright else middle + 0.5
    pitch, row = lattice.pitch, lattice.pitch * np.sqrt(0.75)
    start = x - pitch * int((x - pitch / 2) / pitch)
    if int((y - pitch / 2) / row) % 2:
        start += pitch / 2 if start <= pitch else -pitch / 2
    top = y - np.floor((y - row / 2) / row) * row
    places = np.array([(start + k * pitch, top) for k in range(3)]) - 0.5
    index = np.rint(lattice.to_index(places[:, ::-1] if upright else places)).astype(int)
    found = np.flatnonzero(types.of(index) == nearest)
    return int(found[0]) if len(found) == 1 else None
