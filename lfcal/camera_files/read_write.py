"""Camera files: read any known format by its content, write the format of a suffix.

Published files hold lattices that others have found. Some contradict themselves (a rotation given
twice), some are good to a few pixels only: what is read from them carries warnings, and calibrating
on a flat is the better choice.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..camera.calibration import Calibration
from ..camera.schema import check_plausible
from ..runtime.errors import CameraFileError, check_path
from ..runtime.image_formats import IMAGE_SUFFIXES
from ..runtime.input_file import read_text
from ..runtime.output_file import atomic_write, check_output
from ..runtime.types import AnyPath, Size
from .centre_table import ROUNDING, format_centre_table, parse_centre_table
from .text_files import Mode, format_key_value, parse_key_value
from .xml_files import format_xml, parse_xml

__all__ = ["FORMATS", "CameraFormat", "convert", "load"]


def _parse_json(text: str, _image_size: Size | None) -> Calibration:
    try:
        return Calibration.from_dict(json.loads(text))
    except (json.JSONDecodeError, RecursionError) as error:
        raise CameraFileError(
            f"not valid JSON ({error}); make one with 'lfcal calibrate'"
        ) from error


class CameraFormat(NamedTuple):
    """One camera file format."""

    parse: Callable[..., Calibration]  # from the text of a file and the image size
    format: Callable[
        [Calibration, Mode | None], str
    ]  # the text of a file, of captures of that mode
    recognise: str  # regular expression of the first line that is neither empty nor a comment
    has_size: bool  # whether files hold the image size; else the reader is given it
    # Any lattice can be written; else the text is read again and compared with the lattice.
    is_exact: bool = False


# First line of a table of centres: numbers, or names of columns.
_TABLE = r"[-+.\d]+(e[-+]?\d+)?[,;\s]+[-+.\d]|(?=[^:{<]*$)(?=.*x)(?=.*y)"
#: Every camera file format by its suffix. A new one is a line here and a module with its two
#: functions.
FORMATS = {
    ".json": CameraFormat(
        _parse_json, lambda camera, _: camera.to_json(), r"{", True, is_exact=True
    ),
    ".xml": CameraFormat(parse_xml, lambda camera, _: format_xml(camera), r"<", False),
    ".cfg": CameraFormat(parse_key_value, format_key_value, r"\w+\s*:\s*[-+.\d]", True),
    ".csv": CameraFormat(
        parse_centre_table, lambda camera, _: format_centre_table(camera), _TABLE, False, True
    ),
}


def load(path: AnyPath, image_size: Size | None = None, *, y_up: bool = False) -> Calibration:
    """Read a camera file: our own JSON, or one of another program.

    Parameters
    ----------
    path : path-like
        JSON of `Calibration.save`, `RayCalibData` or `TSPCCalibData` XML, key : value lines, or a
        table of centres with the columns x, y, and radius, type, i, j where known; recognised by
        its content.
    image_size : (int, int) or None [px]
        Width and height of the flats; XML and tables need it, because they do not hold it.
    y_up : bool
        Whether y in a table of centres grows upwards, from 0 in the middle of the lowest row of
        pixels, as in the tables of makers.

    Raises
    ------
    CameraFileError
        If the file is missing or damaged, or is for flats of another size.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from lfcal import Calibration, Lattice, load
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "camera.json"
    >>> Calibration(Lattice([10, 12], [[20, 0], [0, 20]], (200, 100), 9.5)).save(path)
    >>> load(path).lattice.radius
    9.5
    """
    source = check_path(path)
    try:
        text = read_text(source)
    except (OSError, UnicodeDecodeError) as error:
        problem = f"cannot be read as a camera file ({error})"
        if source.suffix.lower() in IMAGE_SUFFIXES and source.exists():
            problem = (
                "is an image, not a camera file; give a white image as --white, or make a camera "
                "file of it with "
            )
            problem += "'lfcal calibrate'"
        raise CameraFileError(f"{source}: {problem}") from error
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    by_suffix = FORMATS.get(source.suffix.lower(), FORMATS[".json"])
    form = next(
        (form for form in FORMATS.values() if re.match(form.recognise, first, re.I)), by_suffix
    )
    try:
        if image_size is None and not form.has_size:
            raise CameraFileError("has no image size; give image_size as (width, height)")
        camera = form.parse(text, image_size, *(y_up,) * (form.parse is parse_centre_table))
        if image_size is not None and tuple(image_size) != camera.image_size:
            own, given = ("{} x {} px".format(*size) for size in (camera.image_size, image_size))
            raise CameraFileError(
                f"is for flats of {own}, not of {given}; calibrate on a flat of that size"
            )
        check_plausible(camera.lattice)
        return camera
    except CameraFileError as error:
        raise CameraFileError(f"{source}: {error}") from error
    except (ValueError, ArithmeticError) as error:
        raise CameraFileError(f"{source}: {error}; calibrate on a flat instead") from error


def convert(calibration: Calibration, path: AnyPath, *, mode: Mode | None = None) -> None:
    """Write a camera in the format its suffix names; the file appears whole or not at all.

    `.json` is our own format and keeps everything. `.xml` (`RayCalibData`) keeps lattice, radius
    and the three lens types of a hexagonal array, `.cfg` (key : value, with four corner centres) a
    hexagonal lattice, `.csv` the columns `i, j, x, y, radius, type` of all centres. A `.cfg` file
    also states the `mode` of the captures. Without `mode`, it is the mode in which the lens types
    are focused, and binocular if the types do not show it.

    OutputError if no known format has the suffix or the file cannot be written, CameraFileError if
    the format cannot hold this lattice.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal
    >>> camera = lfcal.Calibration(lfcal.Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> with TemporaryDirectory() as folder:
    ...     convert(camera, f"{folder}/camera.csv")
    ...     len(lfcal.load(f"{folder}/camera.csv", (400, 300)).lattice)
    300
    """
    check_output(path, FORMATS)
    form = FORMATS[Path(path).suffix.lower()]
    text = form.format(calibration, mode)
    if not form.is_exact:
        # The file may count indices from another lens: centres are the same if the cells are, and
        # if all indices are whole numbers.
        lattice = calibration.lattice
        again = form.parse(text, calibration.image_size).lattice
        index = again.to_index(lattice.centres())
        apart = np.abs((index - np.rint(index)) @ again.basis).max()
        cell = abs(abs(np.linalg.det(again.basis) / np.linalg.det(lattice.basis)) - 1)
        if not max(apart, cell) <= ROUNDING:
            problem = f"this format cannot hold the lattice to {ROUNDING} px; write .json or .csv"
            raise CameraFileError(f"{path}: {problem}")
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
