"""The inputs of commands: a flat, its camera and its depth, read from files or computed from the pixels."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from lfcal import CameraFileError
from lfcal.runtime import console
from lfcal.runtime.image_formats import VIDEO_FORMATS, Mosaic
from lfcal.runtime.video.raw_format import RAW_SUFFIX

from .camera_input import read_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration, FlatSource

    from ..data.depth_map import DepthMap

__all__ = ["CaptureInput", "raw_layout"]


@dataclass(frozen=True)
class CaptureInput:
    """A flat, and the files that its camera and its depth come from; its methods time the stages of a command."""

    report: console.Report
    flat: Path
    # Without camera and white image, the camera is calibrated from the flat; without a depth file, it is analysed.
    camera: Path | None = None
    white: Path | None = None
    depth_file: Path | None = None
    mosaic: Mosaic | None = None
    preset: str = "balanced"
    dark: Path | None = None  # frame that is subtracted from the flat and from the white image
    page: int | None = None  # of a TIFF of several pictures, or of a video
    # Of raw video; with a camera file that has it, the size is that of the camera.
    size: tuple[int, int] | None = None
    pixel_format: str | None = None

    #: Fields that are options of commands.
    OPTIONS: ClassVar = (
        "flat", "camera", "white", "depth_file", "mosaic", "preset", "dark", "page", "size", "pixel_format",
    )  # fmt: skip

    @property
    def files(self) -> list[Path | None]:
        """The files that must not be replaced by an output."""
        return [self.flat, self.camera, self.white, self.depth_file, self.dark]

    def load(self) -> tuple[NDArray[Any], Calibration, DepthMap]:
        """The flat in colour, its camera and its depth."""
        pixels, calibration = self.calibrate(self.read())
        return pixels, calibration, self.analyze(pixels, calibration)

    def read(self) -> NDArray[Any]:
        """The pixels of the flat."""
        with self.report.stage("read"):
            return self.read_pixels()

    def read_pixels(self) -> NDArray[Any]:
        """The pixels of the flat, less the dark frame."""
        from lfcal import read_flat

        layout = raw_layout([self.flat], self.size, self.pixel_format, self.camera)
        return self._subtract_dark(read_flat(self.flat, self.page, **layout))

    def open(self) -> FlatSource:
        """The flat, less the dark frame, to be read in parts."""
        from lfcal import open_flat

        return open_flat(self.flat, self.page, self.dark)

    def _subtract_dark(self, pixels: NDArray[Any]) -> NDArray[Any]:
        if self.dark is None:
            return pixels
        from lfcal import read_flat, subtract_dark

        with console.name_file_in_errors(self.dark):
            return subtract_dark(pixels, read_flat(self.dark))

    def calibrate(self, pixels: NDArray[Any]) -> tuple[NDArray[Any], Calibration]:
        """The flat in colour, and its camera."""
        with self.report.stage("calibrate"):
            calibration = self.find_camera(pixels)
            if calibration.mosaic is not None and pixels.ndim == 2:
                from ..flat.demosaicing import demosaic

                pixels = demosaic(pixels, calibration)
            return pixels, calibration

    def find_camera(self, pixels: Any) -> Calibration:
        """The camera of the file, or calibrated from the white image or from the pixels.

        With a camera file of lfcal, `pixels` may be a `FlatSource`.
        """
        return self._as_stored(self._find_camera(pixels))

    def _as_stored(self, calibration: Calibration) -> Calibration:
        """The camera of this flat: videos are encoded for display, whatever bits they have."""
        encoded = calibration.encoded is None and self.flat.suffix.lower() in (*VIDEO_FORMATS, RAW_SUFFIX)
        return replace(calibration, encoded=True) if encoded else calibration

    def _find_camera(self, pixels: Any) -> Calibration:
        from lfcal import FlatError, calibrate, read_flat

        mosaic = self.mosaic
        if mosaic is not None and len(pixels.shape) == 3:
            raise click.UsageError(f"{self.flat} is in colour already; leave out --mosaic")
        if self.camera:
            calibration = read_camera(self.camera, pixels)
            return calibration.with_mosaic(mosaic) if mosaic is not None else calibration
        if self.white is None:
            with console.name_file_in_errors(self.flat):
                calibration = calibrate(pixels, mosaic=mosaic)
            if calibration.source != "white":
                return calibration
            warning = "this is a white image, there is no scene in it; give a capture, and this one as --white"
            return replace(calibration, warnings=(*calibration.warnings, warning))
        white = read_flat(self.white)
        if white.shape[:2] != pixels.shape[:2]:
            sizes = " and ".join(f"{shape[1]} x {shape[0]}" for shape in (white.shape, pixels.shape))
            raise FlatError(f"{self.white}: white image and flat must be of one size, they have {sizes} px")
        white = self._subtract_dark(white)
        with console.name_file_in_errors(self.white):
            calibration = calibrate(white, kind="white", mosaic=mosaic if white.ndim == 2 else None)
        # Scenes show more of which filters are red.
        return calibration.with_mosaic_of(pixels)

    def analyze(self, pixels: NDArray[Any], calibration: Calibration, **options: Any) -> DepthMap:
        """The depth of the file, or of the flat in colour; `options` as for `lfrender.analyze`."""
        with self.report.stage("analyze"):
            if self.depth_file is not None:
                depth = self.read_depth()
                if depth.image_size == (pixels.shape[1], pixels.shape[0]) and not depth.is_of(pixels):
                    self.warn_of_other_flat()
                return depth
            from .. import analyze

            return analyze(pixels, calibration, preset=self.preset, **options)

    def warn_of_other_flat(self) -> None:
        """Warn that the depth file was made from other pixels."""
        self.report.warn(
            f"{self.depth_file} was made from another flat than {self.flat}: edges of the scene may be drawn at wrong "
            "places; analyse this flat"
        )

    def read_depth(self) -> DepthMap:
        """The depth of the file."""
        from ..data.depth_map import DepthFileError, DepthMap

        path = self.depth_file
        assert path is not None
        if path.suffix.lower() != ".npz" and path.exists():
            raise DepthFileError(f"{path}: is no depth map (.npz); make one with 'lfrender analyze'")
        return DepthMap.load(path)


def raw_layout(
    inputs: Iterable[Path], size: tuple[int, int] | None, pixel_format: str | None, camera: Path | None
) -> dict[str, Any]:
    """How raw video among the `inputs` is read, as options of `lfcal.read_flat`."""
    if size is None and camera is not None and any(path.suffix.lower() == RAW_SUFFIX for path in inputs):
        from lfcal import load

        with suppress(CameraFileError):
            size = load(camera).image_size
    return {"size": size, "pixel_format": pixel_format}
