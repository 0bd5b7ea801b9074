"""The one family of errors: each says what was wrong, where, and what to do."""

__all__ = ["RAW_FLAT_ADVICE", "CalibrationError", "CameraFileError", "FlatError", "LightFieldError"]

#: Ending of messages about images that show no microimages.
RAW_FLAT_ADVICE = "give a raw flat from the sensor, of a camera with a microlens array"


class LightFieldError(Exception):
    """Anything this toolkit refuses to do; the message names the cause and the remedy."""


class FlatError(LightFieldError, ValueError):
    """An image cannot be read or cannot be a flat (raw plenoptic picture)."""


class CalibrationError(LightFieldError, ValueError):
    """No trustworthy microlens lattice was found, or a lattice does not fit a flat."""


class CameraFileError(LightFieldError, ValueError):
    """A camera file is missing, damaged, or belongs to another image size."""
