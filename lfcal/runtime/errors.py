"""The errors of this toolkit: each message says what was wrong, where, and what to do."""

__all__ = ["RAW_FLAT_ADVICE", "BoardError", "CalibrationError", "CameraFileError", "FlatError", "LightFieldError"]

#: Ending of messages about images that show no microimages.
RAW_FLAT_ADVICE = "give a raw flat from the sensor, of a camera with a microlens array"


class LightFieldError(Exception):
    """Base of all errors that users can cause and mend."""


class FlatError(LightFieldError, ValueError):
    """An image cannot be read or cannot be a flat (raw plenoptic picture)."""


class CalibrationError(LightFieldError, ValueError):
    """No reliable microlens lattice was found, or a lattice does not fit a flat."""


class CameraFileError(LightFieldError, ValueError):
    """A camera file is missing, damaged, or belongs to another image size."""


class BoardError(LightFieldError, ValueError):
    """A board was not found on flats, or what was found cannot calibrate a camera."""
