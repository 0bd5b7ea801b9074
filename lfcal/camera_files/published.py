"""Camera files published by others: `RayCalibData` and `TSPCCalibData` XML, and the key : value form of a converter.

They say where somebody else found the lattice. They contradict themselves at times (a rotation given twice) and some
are good to a few pixels only, so what is read here carries warnings; calibrating on a flat is the better choice.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..runtime.errors import CameraFileError
from .xml_fields import make_camera, read_number, read_point, require_positive

__all__ = ["parse_published", "read_published"]

_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
_COARSE = "only the corner centres are published, good to a few pixels; calibrate on a flat for better"


def read_published(path: str | os.PathLike[str], image_size: tuple[int, int] | None = None) -> Calibration:
    """Read a published camera file.

    Parameters
    ----------
    path : path-like
        `RayCalibData` or `TSPCCalibData` XML, or the key : value form, recognised by content.
    image_size : (int, int) [px]
        Width and height of the flats; may be None for the key : value form, which has it.

    Raises
    ------
    CameraFileError
        If the file is missing, damaged, of no known kind, or belongs to another image size.
    """
    source = Path(path)
    try:
        text = source.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CameraFileError(f"{source}: cannot be read as a camera file ({error})") from error
    return parse_published(text, image_size, str(source))


def parse_published(text: str, image_size: tuple[int, int] | None, where: str) -> Calibration:
    """The camera in `text`, a published file of any known kind; errors begin with `where`."""
    try:
        if text.lstrip().startswith("<"):
            return _from_xml(text, image_size, where)
        return _from_pairs(text, image_size, where)
    except CameraFileError:
        raise
    except (ValueError, ArithmeticError) as error:
        raise CameraFileError(f"{where}: {error}; calibrate on a flat instead") from error


def _from_xml(text: str, image_size: tuple[int, int] | None, where: str) -> Calibration:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(text)
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise CameraFileError(f"{where}: not valid XML ({error})") from error
    if image_size is None:
        raise CameraFileError(f"{where}: does not say how large its flats are; give image_size as (width, height)")
    if root.tag == "RayCalibData":
        from .raytrix import parse_raytrix

        return parse_raytrix(root, image_size, where)
    if root.tag == "TSPCCalibData":
        corners = [read_point(root, f"centers/{name}", where) for name in ("ltop", "rtop", "lbot", "rbot")]
        upright = abs(np.sin(read_number(root, "rotation", where))) > np.sqrt(0.5)
        return _from_corners(corners, read_number(root, "diameter", where), upright, image_size, where)
    raise CameraFileError(f"{where}: <{root.tag}> is no known camera file; known are RayCalibData and TSPCCalibData")


def _from_pairs(text: str, image_size: tuple[int, int] | None, where: str) -> Calibration:
    """The key : value form; `MLADirection` 1 has hexagons in upright rows."""
    pairs: dict[str, float] = {}
    for row, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        key, colon, value = line.partition(":")
        try:
            pairs[key.strip()] = float(value)
        except ValueError:
            raise CameraFileError(f"{where}: line {row} is not 'key : number'; is this a camera file?") from None
        if not colon or not np.isfinite(pairs[key.strip()]):
            raise CameraFileError(f"{where}: line {row} is not 'key : number'; is this a camera file?")

    def get(key: str) -> float:
        if key not in pairs:
            raise CameraFileError(f"{where}: '{key}' is missing")
        return pairs[key]

    size = (int(get("LensletWidth")), int(get("LensletHeight")))
    if image_size is not None and tuple(image_size) != size:
        raise CameraFileError(
            f"{where}: is for flats of {size[0]} x {size[1]} px, not of {image_size[0]} x {image_size[1]} px"
        )
    pitch = require_positive(get("MIDiameter"), "MIDiameter", where)
    upright = get("MLADirection") == 1
    if "LeftTopMICenterX" in pairs:
        names = ("LeftTop", "RightTop", "LeftBottom", "RightBottom")
        corners = [np.array([get(f"{n}MICenterX"), get(f"{n}MICenterY")]) for n in names]
        return _from_corners(corners, pitch, upright, size, where)
    origin = (np.array(size) - 1) / 2 + np.array([get("CentralMIOffsetX"), -get("CentralMIOffsetY")])
    basis = _HEXAGON[:, ::-1] if upright else _HEXAGON
    warnings = ["the file gives no angle finer than upright or level rows"]
    return make_camera(origin, basis * pitch, size, pitch / 2, warnings)


def _from_corners(
    corners: list[NDArray[np.float64]], pitch: float, upright: bool, image_size: tuple[int, int], where: str
) -> Calibration:
    """Hexagonal lattice through the outermost centres: left top, right top, left bottom, right bottom."""
    pitch = require_positive(pitch, "diameter", where)
    left_top, right_top, left_low, right_low = corners
    down = ((left_low - left_top) + (right_low - right_top)) / 2
    across = ((right_top - left_top) + (right_low - left_low)) / 2
    along, sideways = (down, across) if upright else (across, down)
    rows = round(float(np.hypot(*sideways)) / (pitch * np.sqrt(0.75)))
    steps = round(float(np.hypot(*along)) / pitch)
    if rows < 1 or steps < 1:
        raise CameraFileError(f"{where}: the corner centres are less than a pitch apart")
    along, sideways = along / steps, sideways / rows
    if rows % 2:
        # The last row sits half a step off, to whichever side leaves the axes perpendicular.
        square = sideways - (sideways @ along) / (along @ along) * along
        slip = np.sign(float((sideways - square) @ along)) or 1.0
        sideways = sideways - slip * 0.5 * along / rows
    first = np.mean(corners, axis=0) - (down + across) / 2
    return make_camera(first, np.array([along, sideways + along / 2]), image_size, pitch / 2, [_COARSE])
