"""Options that several commands of lfcal share, and the files that they read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..runtime import command_line as cl
from ..runtime.types import Size

if TYPE_CHECKING:
    from ..camera.calibration import Calibration
    from ..runtime.arrays import Array

__all__ = [
    "RESULTS",
    "SIZE_OPTIONS",
    "read_camera",
    "read_flats",
    "read_image",
]

#: What the commands print with `--json`.
RESULTS = cl.results_of(__package__)
#: Options for camera files that do not hold the size of the flats.
SIZE_OPTIONS = (
    cl.option("--size", cl.SIZE, "Size of the flats [px], for files without it (.xml, .csv)."),
    cl.option("--image", cl.INPUT, "An image of that size, instead of --size."),
)


def read_flats(given: Any, *paths: Path, **options: Any) -> list[Array]:
    """Flats, less the frame of `--dark`; `options` as for `lfcal.read_flat`."""
    from .. import read_flat, subtract_dark

    flats = [read_flat(path, **options) for path in paths]
    if given.dark is None:
        return flats
    frame = read_flat(given.dark)
    with cl.name_file_in_errors(given.dark):
        return [subtract_dark(flat, frame) for flat in flats]


def read_image(given: Any) -> tuple[Array | None, Size | None]:
    """The image of `SIZE_OPTIONS`, and the size of the flats; None if they are not given."""
    if given.image is None:
        return None, given.size
    if given.size is not None:
        raise click.UsageError("--size and --image exclude each other")
    from .. import read_flat

    pixels = read_flat(given.image)
    return pixels, pixels.shape[1::-1]


def read_camera(path: Path, size: Size | None, y_up: bool = False) -> Calibration:
    """A camera file of any format; an error about its missing size names the options for it."""
    from .. import CameraFileError, load

    try:
        return load(path, size, y_up=y_up)
    except CameraFileError as error:
        if size is None and "image_size" in str(error):
            raise CameraFileError(
                f"{path}: has no image size; add --size WxH or --image"
            ) from error
        raise
