"""The errors of this toolkit: each message says what was wrong, where, and what to do."""

import os
from collections.abc import Iterable
from contextlib import suppress
from numbers import Real
from pathlib import Path
from reprlib import repr as brief
from typing import Any

__all__ = [
    "CAMERA_ADVICE",
    "RAW_FLAT_ADVICE",
    "BoardError",
    "CalibrationError",
    "CameraError",
    "CameraFileError",
    "FlatError",
    "LightFieldError",
    "check_number",
    "check_numbers",
    "check_path",
    "check_type",
]

#: Where a camera comes from, for `check_type`.
CAMERA_ADVICE = "lfcal.calibrate makes one of a flat, lfcal.load reads one from a file"
#: Ending of messages about images that show no microimages.
RAW_FLAT_ADVICE = (
    "give a raw flat from the sensor, of a camera with a microlens array (if it is one: its white "
    "image, or its pitch as a hint)"
)


class LightFieldError(Exception):
    """Base of all errors that users can cause and mend.

    Examples
    --------
    >>> import lfcal
    >>> [issubclass(error, lfcal.LightFieldError) for error in (lfcal.FlatError, lfcal.OutputError)]
    [True, True]
    """


class FlatError(LightFieldError, ValueError):
    """An image cannot be read or cannot be a flat (raw plenoptic picture).

    Examples
    --------
    >>> import lfcal
    >>> lfcal.read_flat("no.png")
    Traceback (most recent call last):
    lfcal.runtime.errors.FlatError: no.png: cannot be read (No such file or directory)
    """


class CalibrationError(LightFieldError, ValueError):
    """No reliable microlens lattice was found, or a lattice does not fit a flat.

    Examples
    --------
    >>> import lfcal, numpy
    >>> lfcal.calibrate(numpy.full((300, 400), 100, numpy.uint8))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lfcal.runtime.errors.CalibrationError: the image is one even grey; ...
    """


class CameraError(CalibrationError):
    """A flat was made with another camera than the given one.

    Examples
    --------
    >>> import lfcal
    >>> issubclass(lfcal.CameraError, lfcal.CalibrationError)
    True
    """


class CameraFileError(LightFieldError, ValueError):
    """A camera file is missing, damaged, or belongs to another image size.

    Examples
    --------
    >>> import lfcal
    >>> lfcal.Calibration.from_dict({})  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lfcal.runtime.errors.CameraFileError: not an lfcal-camera file; ...
    """


class BoardError(LightFieldError, ValueError):
    """A board was not found on flats, or what was found cannot calibrate a camera.

    Examples
    --------
    >>> import lfcal
    >>> lfcal.Board(1, 6, 7.0)
    Traceback (most recent call last):
    lfcal.runtime.errors.BoardError: a board has 2 to 200 inner corners each way, got 1 x 6
    """


def check_type(value: Any, kind: type, name: str, remedy: str) -> None:
    """Raise a TypeError that names an argument of another type, and what makes one."""
    # A text is never meant as an iterable.
    if not isinstance(value, kind) or (kind is Iterable and isinstance(value, str)):
        article = "a"
        if kind.__name__[0] in "AEIOU":
            article = "an"
        raise TypeError(
            f"{name} must be {article} {kind.__name__}, got {type(value).__name__}; {remedy}"
        )


def check_path(value: Any, name: str = "path") -> Path:
    """An argument as a path; TypeError that names it if it is none."""
    if not isinstance(value, (str, os.PathLike)):
        raise TypeError(f"{name} must be a str or path-like, got {type(value).__name__}")
    return Path(value)


def check_number(value: Any, name: str) -> float:
    """An argument as a number; TypeError that names it if it is none."""
    if not isinstance(value, Real):
        raise TypeError(f"{name} must be a number, got {type(value).__name__}")
    try:
        return float(value)
    except OverflowError as error:
        raise ValueError(f"{name} is larger than any number of a computer") from error


def check_numbers(values: Any, name: str) -> Any:
    """An argument as a float64 array; TypeError that names it if it cannot be one."""
    import numpy as np

    # NumPy takes None for NaN.
    with suppress(TypeError, ValueError, OverflowError):
        if values is not None:
            return np.array(values, np.float64)
    raise TypeError(f"{name} must be numbers, got {brief(values)}")
