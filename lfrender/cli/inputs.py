"""What commands start from: the camera of a flat, its colours, and its depth, from files or from the pixels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import console
from lfcal.runtime.image_formats import IMAGE_SUFFIXES

if TYPE_CHECKING:
    from typing import Literal

    import numpy as np
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.optics import Optics

    Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]

__all__ = ["analysed", "camera_of", "in_colour", "is_published", "read_camera", "read_depth", "read_optics"]


def read_camera(path: Path, pixels: NDArray[np.generic]) -> Calibration:
    """A camera file for flats of this size, in our form or as published."""
    from lfcal import CameraFileError, load

    size = (pixels.shape[1], pixels.shape[0])
    if path.suffix.lower() in IMAGE_SUFFIXES and path.exists():
        raise CameraFileError(
            f"{path}: is an image, not a camera file; give a white image as --white, or make a camera file of it with "
            "'lfcal calibrate'"
        )
    calibration = load(path, size)
    return _checked(calibration, pixels) if is_published(path) else calibration


def is_published(path: Path) -> bool:
    """Whether a camera file is of another program, so that its lattice is to be checked against the pixels."""
    return path.suffix.lower() != ".json"


def _checked(calibration: Calibration, pixels: NDArray[np.generic]) -> Calibration:
    """A published calibration, with a warning where the pixels contradict it."""
    from dataclasses import replace

    from lfcal import check_fit

    misfit = check_fit(calibration, pixels).warning
    if misfit is None:
        return calibration
    warning = f"as published, {misfit}; calibrate on this flat instead: leave out -c"
    return replace(calibration, warnings=(*calibration.warnings, warning))


def camera_of(
    report: Any, flat: Path, pixels: NDArray[np.generic], camera: Path | None, white: Path | None, mosaic: Mosaic | None
) -> Calibration:
    """The camera of a file, or calibrated from a white image or from the flat itself."""
    if mosaic is not None and pixels.ndim == 3:
        raise click.UsageError(f"{flat} is in colour already; leave out --mosaic")
    if camera:
        from dataclasses import replace

        calibration = read_camera(camera, pixels)
        return replace(calibration, mosaic=mosaic) if mosaic is not None else calibration
    from lfcal import FlatError, calibrate, read_flat

    if white is None:
        report.announce_compilation("lfcal")
        with console.name_file_in_errors(flat):
            return _of_scene(calibrate(pixels, mosaic=mosaic))
    white_pixels = read_flat(white)
    if white_pixels.shape[:2] != pixels.shape[:2]:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (white_pixels, pixels))
        raise FlatError(f"{white}: white image and flat must be of one size, they have {sizes} px")
    report.announce_compilation("lfcal")
    with console.name_file_in_errors(white):
        return calibrate(white_pixels, kind="white", mosaic=mosaic if white_pixels.ndim == 2 else None)


def _of_scene(calibration: Calibration) -> Calibration:
    """A calibration from the flat that is to be drawn, with a warning where there is nothing in it to draw."""
    if calibration.source != "white":
        return calibration
    from dataclasses import replace

    warning = "this is a white image, there is no scene in it; give a capture, and this one as --white"
    return replace(calibration, warnings=(*calibration.warnings, warning))


def in_colour(pixels: NDArray[Any], calibration: Calibration) -> NDArray[Any]:
    """The flat without its colour mosaic, once for depth and picture."""
    if calibration.mosaic is None or pixels.ndim == 3:
        return pixels
    from .. import demosaic

    return demosaic(pixels, calibration)


def read_depth(path: Path) -> DepthMap:
    """A depth map made by `lfrender analyze`."""
    from ..data.depth_map import DepthFileError, DepthMap

    if path.suffix.lower() != ".npz" and path.exists():
        raise DepthFileError(f"{path}: is no depth map (.npz); make one with 'lfrender analyze'")
    return DepthMap.load(path)


def read_optics(path: Path | None) -> Optics | None:
    """The optics of a file, where one was given."""
    if path is None:
        return None
    from ..data.optics import Optics

    return Optics.load(path)


def analysed(
    report: Any, pixels: NDArray[np.generic], calibration: Calibration, preset: str, **options: Any
) -> DepthMap:
    """The depth of a flat in colour; `options` as for `lfrender.analyze`."""
    from .. import analyze as run

    report.announce_compilation("lfrender")
    return run(pixels, calibration, preset=preset, **options)
