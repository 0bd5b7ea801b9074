"""Camera files of lines `key : value`, for hexagonal lattices.

They are those of the converters for lenslet video (TLCT, RLC 4.0), whose programs expect `IsKepler`
and, for three lens types, `NearFocalLenType`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.arrays import Floats
from ..runtime.errors import CameraFileError
from ..runtime.types import Size

__all__ = [
    "LARGEST",
    "Mode",
    "PublishedNumbers",
    "calibration_from_corners",
    "format_key_value",
    "parse_key_value",
]

_CORNERS = ("LeftTop", "RightTop", "LeftBottom", "RightBottom")

#: Of the numbers of any camera file.
LARGEST = 1e9
#: [pitch] Distance of the rows of a hexagonal lattice.
ROW_SPACING = 0.75**0.5
# Relative difference of the pitch from the one that the file states.
_MOST_STRETCH = 0.1

Mode = Literal["telescopic", "binocular"]


class PublishedNumbers(dict[str, str]):
    """Texts of a file by their names, read as finite numbers.

    CameraFileError, with the name, if a text is no finite number.
    """

    def number(self, name: str, above: float = -np.inf) -> float:
        if name not in self:
            raise CameraFileError(f"'{name}' is missing")
        try:
            value = float(self[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise CameraFileError(f"'{name}' is {self[name].strip()!r}, not a number")
        if abs(value) > LARGEST:
            raise CameraFileError(f"'{name}' is {value:g}: larger than {LARGEST:g}")
        if value <= above:
            raise CameraFileError(f"{name} must be positive, got {value}")
        return value

    def positive(self, name: str) -> float:
        return self.number(name, above=0)

    def point(self, x: str, y: str) -> Floats:
        return np.array([self.number(x), self.number(y)])


def calibration_from_corners(
    corners: list[Floats], pitch: float, upright: bool, image_size: Size
) -> Calibration:
    """Hexagonal lattice through the centres of the four outermost microimages.

    Their order is left top, right top, left bottom, right bottom.

    `upright` lattices have rows of nearest neighbours that run down the flat.
    """
    left_top, right_top, left_low, right_low = corners
    down = ((left_low - left_top) + (right_low - right_top)) / 2
    across = ((right_top - left_top) + (right_low - left_low)) / 2
    along, sideways = (down, across) if upright else (across, down)
    rows = round(float(np.hypot(*sideways)) / (pitch * ROW_SPACING))
    steps = round(float(np.hypot(*along)) / pitch)
    if rows < 1 or steps < 1:
        raise CameraFileError("the corner centres are less than a pitch apart")
    along = along / steps
    sideways = sideways / rows
    if rows % 2:
        # The last row is shifted by half a step, to whichever side leaves the axes perpendicular.
        slip = np.sign(float(sideways @ along)) or 1.0
        sideways = sideways - slip * 0.5 * along / rows
    first = np.mean(corners, axis=0) - (down + across) / 2
    lattice = Lattice(first, reduce_basis([along, sideways + along / 2]), image_size, pitch / 2)
    apart = np.hypot(*(lattice.steps @ lattice.basis).T)
    gap = float(np.hypot(*(right_top - left_top - right_low + left_low)))
    # Published corners are good to a few pixels: those of real cameras leave 9 px of 70 px, and
    # lattices off by 0.6 %.
    if gap > pitch / 2 or np.abs(apart / pitch - 1).max() > _MOST_STRETCH:
        found = (
            f"microimages {apart.min():.4g} to {apart.max():.4g} px apart, and a gap of "
            f"{gap:.4g} px"
        )
        raise CameraFileError(
            f"the corner centres do not fit a diameter of {pitch:.4g} px: they give {found}"
        )
    warning = (
        "only the corner centres are published, good to a few pixels; calibrate on a flat for "
        "better"
    )
    return Calibration(lattice, warnings=(warning,))


def parse_key_value(text: str, _image_size: Size | None) -> Calibration:
    """The camera in lines `key : value`; `MLADirection` 1 has hexagons in upright rows."""
    numbers = PublishedNumbers()
    for row, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            key, colon, value = line.partition(":")
            if not colon:
                raise CameraFileError(f"line {row} is not 'key : number'; is this a camera file?")
            numbers[key.strip()] = value
    width, height = (numbers.positive(f"Lenslet{side}") for side in ("Width", "Height"))
    if width % 1 or height % 1:
        raise CameraFileError(
            f"LensletWidth and LensletHeight must be whole numbers of px, got {width} and {height}"
        )
    size = int(width), int(height)
    pitch = numbers.positive("MIDiameter")
    upright = numbers.number("MLADirection") == 1
    if "LeftTopMICenterX" in numbers:
        corners = [numbers.point(f"{name}MICenterX", f"{name}MICenterY") for name in _CORNERS]
        return calibration_from_corners(corners, pitch, upright, size)
    origin = (np.array(size) - 1) / 2 + numbers.point("CentralMIOffsetX", "CentralMIOffsetY") * [
        1,
        -1,
    ]
    basis = pitch * np.array([[1.0, 0.0], [0.5, ROW_SPACING]])
    warning = "the file gives no angle finer than upright or level rows"
    lattice = Lattice(origin, reduce_basis(basis[:, ::-1] if upright else basis), size, pitch / 2)
    return Calibration(lattice, warnings=(warning,))


def format_key_value(calibration: Calibration, mode: Mode | None = None) -> str:
    """Key : value lines with the centres of four microimages at the corners of a parallelogram.

    `IsKepler` is 1 for binocular captures: the flag names the modes the other way round. Without a
    `mode` it follows from the focus of the lens types, and is 1, which its readers take for
    granted, where that is not known. A camera of three lens types also gets the central microimage
    and `NearFocalLenType`, which its readers need together.
    """
    lattice = calibration.lattice
    if len(lattice.steps) != 6:
        raise CameraFileError(
            "the key : value format holds hexagonal lattices only; write .xml, .csv or .json"
        )
    steps = lattice.steps @ lattice.basis
    upright = bool(np.abs(steps[:, 1]).max() > np.abs(steps[:, 0]).max())
    axis = 0
    if upright:
        axis = 1
    along = steps[steps[:, axis].argmax()]
    # Two rows further the microimages stand side by side again.
    sideways = max((2 * step - along for step in steps), key=lambda v: v[1 - axis] / np.hypot(*v))
    across, down = (sideways, along) if upright else (along, sideways)
    middle = lattice.origin + lattice.middle @ lattice.basis
    first, columns, rows = _outermost(lattice, middle, across, down)
    mode = mode or _mode_of_types(calibration)
    width, height = lattice.image_size
    values: dict[str, object] = {
        "IsKepler": int(mode != "telescopic"),
        "LensletWidth": width,
        "LensletHeight": height,
        "MIDiameter": f"{lattice.pitch:.12f}",
        "MLADirection": int(upright),
    }
    for k, name in enumerate(_CORNERS):
        corner = first + k % 2 * columns * across + k // 2 * rows * down
        values |= {
            f"{name}MICenter{axis}": f"{value:.9f}"
            for axis, value in zip("XY", corner, strict=True)
        }
    near = _near_type(calibration, mode, middle, upright)
    if near is not None:
        offset = (middle - (np.array([width, height]) - 1) / 2) * [1, -1]
        values |= {
            f"CentralMIOffset{axis}": f"{value:.9f}"
            for axis, value in zip("XY", offset, strict=True)
        }
        values["NearFocalLenType"] = near
    return "".join(f"{key} : {value}\n" for key, value in values.items())


def _outermost(
    lattice: Lattice, middle: Floats, across: Floats, down: Floats
) -> tuple[Floats, int, int]:
    """The first whole microimage, and the steps `across` and `down` to the last whole ones.

    Readers take it for the first one of its row, and begin with its row.
    """
    low = lattice.pitch / 2 - 0.5
    high = np.array(lattice.image_size) - 0.5 - lattice.pitch / 2
    straight = lattice.origin + lattice.indices() @ lattice.basis
    whole = straight[((straight >= low) & (straight <= high)).all(1)]
    first = middle
    if len(whole):
        first = whole[whole.sum(1).argmin()]
    # In a turned lattice, the last ones may be beyond the border: at least one step is needed each
    # way.
    columns, rows = (
        max(1, int((high - first)[axis] / step[axis])) for axis, step in ((0, across), (1, down))
    )
    return first, columns, rows


def _mode_of_types(calibration: Calibration) -> Mode | None:
    focus = calibration.lens_types.focus if calibration.lens_types is not None else None
    if focus is None or not (np.isfinite(focus).all() and abs(np.sign(focus).sum()) == len(focus)):
        return None
    if focus[0] > 0:
        return "telescopic"
    return "binocular"


def _near_type(
    calibration: Calibration, mode: str | None, middle: Floats, upright: bool
) -> int | None:
    """Number of the lens type that is focused nearest, None if it is not known.

    They count the types along the first row of whole microimages, which runs down the flat if
    `upright`.
    """
    types = calibration.lens_types
    lattice = calibration.lattice
    if types is None or types.count != 3 or not types.ordered:
        return None
    # Nearer objects have larger `s` of either sign.
    nearest = 2
    if mode == "telescopic":
        nearest = 0
    x, y = middle[::-1] + 0.5 if upright else middle + 0.5
    pitch = lattice.pitch
    row = lattice.pitch * ROW_SPACING
    start = x - pitch * int((x - pitch / 2) / pitch)
    if int((y - pitch / 2) / row) % 2:
        start += pitch / 2 if start <= pitch else -pitch / 2
    top = y - np.floor((y - row / 2) / row) * row
    places = np.array([(start + k * pitch, top) for k in range(3)]) - 0.5
    index = np.rint(lattice.to_index(places[:, ::-1] if upright else places)).astype(int)
    found = np.flatnonzero(types.of(index) == nearest)
    if len(found) == 1:
        return int(found[0])
    return None
