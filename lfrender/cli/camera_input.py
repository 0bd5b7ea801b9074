"""The camera file of a command, checked against the flat that it is given for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration, FlatSource

__all__ = ["is_published", "read_camera"]

# [px] side of the part in the middle of a flat that is not in memory, on which its camera is checked.
_CHECKED_SIDE = 3000


def is_published(path: Path) -> bool:
    """Whether a camera file is of another program, so that its lattice may be moved onto the pixels."""
    return path.suffix.lower() != ".json"


def read_camera(path: Path, pixels: NDArray[Any] | FlatSource) -> Calibration:
    """A camera file for flats of this size, with a warning if the pixels contradict it or show nothing of it.

    A published one is moved onto the microimages where the flat is a crop of the sensor; colour filters that it does
    not know are found on the flat. Raises CameraFileError where the flat shows another lattice.
    """
    from lfcal import load

    calibration = _check_file(path, load(path, (pixels.shape[1], pixels.shape[0])), pixels)
    return calibration.with_mosaic_of(_middle(pixels)[0]) if len(pixels.shape) == 2 else calibration


def _check_file(path: Path, calibration: Calibration, pixels: NDArray[Any] | FlatSource) -> Calibration:
    import numpy as np

    check = _check(calibration, pixels)
    if check.adjusted is not None and is_published(path) and isinstance(pixels, np.ndarray):
        warning = "as published, the lattice lies beside the microimages, as in crops of a sensor; it was moved there"
        return replace(check.adjusted, warnings=(*calibration.warnings, warning))
    checked: Calibration = check.warn(calibration, path)
    return checked


def _check(calibration: Calibration, pixels: NDArray[Any] | FlatSource) -> Any:
    from lfcal import check_camera

    from ..data.region import crop_lattice

    part, low, high = _middle(pixels)
    if part is pixels:
        return check_camera(calibration, part)
    return check_camera(replace(calibration, lattice=crop_lattice(calibration.lattice, low, high), gain_map=None), part)


def _middle(pixels: NDArray[Any] | FlatSource) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """A flat, or its middle where it is not in memory, and the corners of that."""
    import numpy as np

    size = np.array(pixels.shape[1::-1])
    if isinstance(pixels, np.ndarray):
        return pixels, np.zeros(2, int), size
    # Even, so that a colour filter mosaic keeps its phase.
    low = np.maximum(size - _CHECKED_SIDE, 0) // 4 * 2
    high = np.minimum(low + _CHECKED_SIDE, size)
    return pixels.read(*low.tolist(), *high.tolist()), low, high
