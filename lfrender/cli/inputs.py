"""The inputs of commands: a flat, its camera and its depth, read or computed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal import CameraFileError
from lfcal.runtime.command_line import Report, name_file_in_errors
from lfcal.runtime.image_formats import RAW_SUFFIX, TIFF_SUFFIXES, VIDEO_FORMATS, Mosaic

from ..runtime.choices import Preset
from ..runtime.types import Entries, Region
from . import figures

if TYPE_CHECKING:
    from lfcal import Calibration, FlatSource, Optics
    from lfcal.runtime.arrays import Array

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering
    from ..live.recording import Recording
    from ..output.finish import Finish
    from ..sequence.frames import Frames

__all__ = ["MOVING", "CaptureInput", "is_large", "is_published"]

#: Suffixes of files that hold nothing but moving pictures.
MOVING = (".gif", ".mkv", ".mov", ".mp4")

# [px] Side of the middle of a flat that is not in memory on which its camera is checked.
_CHECKED = 3000
# [bytes] Larger flats are drawn in tiles: smaller ones are faster as a whole.
_LARGE = 1e8


@dataclass(frozen=True)
class CaptureInput:
    """A flat and the files of its camera and depth; methods time the stages of a command."""

    report: Report
    flat: Path
    # Without camera and white image, the camera is calibrated from the flat; without a depth file,
    # it is analysed.
    camera: Path | None = None
    white: Path | None = None
    no_check: bool = False  # the camera is used whatever the flat shows
    depth_file: Path | None = None
    dark: Path | None = None  # frame that is subtracted from the flat and from the white image
    preset: Preset | None = None
    roi: Region | None = None
    mosaic: Mosaic | None = None
    page: int | None = None  # of a TIFF of several pictures, or of a video
    # Of raw video; with a camera file that has it, the size is that of the camera.
    size: tuple[int, int] | None = None
    pixel_format: str | None = None

    @cached_property
    def recording(self) -> Recording | None:
        """Camera and settings that stand in the flat itself, if 'lfrender live' has recorded it."""
        from ..live.recording import read_recording

        return read_recording(self.flat)

    @property
    def chosen_preset(self) -> Preset:
        """The preset that was given, or that of the recording."""
        return self.preset or (self.recording.preset if self.recording else "balanced")

    def load(self) -> tuple[Array, Calibration, DepthMap]:
        """The flat in colour, its camera and its depth."""
        pixels, calibration = self.calibrate(self.read())
        return pixels, calibration, self.analyze(pixels, calibration)

    def read(self) -> Array:
        """The pixels of the flat."""
        with self.report.stage("read"):
            return self.read_pixels()

    def read_pixels(self) -> Array:
        """The pixels of the flat, less the dark frame."""
        from lfcal import read_flat

        return self.subtract_dark(read_flat(self.flat, self.page, **self.raw_layout([self.flat])))

    @contextmanager
    def open_parts(self) -> Iterator[FlatSource]:
        """The flat, less the dark frame, to be read in parts."""
        from lfcal import open_flat

        with self.report.stage("read"):
            opened = open_flat(self.flat, self.page, self.dark)
        with opened as source:
            yield source

    def calibrate_parts(self, source: FlatSource) -> Calibration:
        """The camera of the file, or calibrated on all pixels of a flat that is read in parts."""
        with self.report.stage("calibrate"):
            known = self.camera is not None and not is_published(self.camera)
            return self.find_camera(source if known else self.read_pixels())

    def analyze_parts(
        self, source: FlatSource, calibration: Calibration, cluster: Entries, **options: Any
    ) -> DepthMap:
        """The depth of a flat that is read in parts; `options` as for `lfrender.analyze_large`."""
        from .. import analyze_large

        with self.report.progress("tiles") as step:
            options |= {"progress": step, **cluster}
            return analyze_large(source, calibration, self.chosen_preset, **options)

    def open_frames(self, inputs: tuple[Path, ...], **chosen: Any) -> Frames:
        """The frames of a sequence, less the dark frame; `chosen` as for `lfrender.open_frames`."""
        from .. import open_frames

        return open_frames(inputs, **self.raw_layout(inputs), dark=self.dark, **chosen)

    def describe(
        self,
        calibration: Calibration,
        depth: DepthMap | None = None,
        optics: Optics | None = None,
    ) -> tuple[Entries, list[str]]:
        """Figures and sentences about the lenses: number, source of the camera, modes, distances."""
        how = f"with {self.camera}"
        if self.camera is None:
            source = self.white or "the flat itself"
            how = f"found on {source} (confidence {calibration.confidence_text})"
        found = figures.capture_figures(calibration, depth, optics)
        return found, figures.capture_sentences(how, found)

    def conclude(
        self,
        found: Entries,
        calibration: Calibration,
        depth: DepthMap | None,
        *closing: str,
        optics: Optics | None = None,
    ) -> None:
        """Print what a command has found, after what `describe` tells; `closing` are sentences."""
        known, sentences = self.describe(calibration, depth, optics)
        self.report.finish(known | found, *sentences, *closing)

    def raw_layout(self, inputs: Iterable[Path]) -> Entries:
        """How raw video among the `inputs` is read, as options of `lfcal.read_flat`."""
        found = {"size": self.size, "pixel_format": self.pixel_format}
        raw = any(path.suffix.lower() == RAW_SUFFIX for path in inputs)
        if raw and self.size is None and self.camera is not None:
            from lfcal import load

            with suppress(CameraFileError):
                found["size"] = load(self.camera).image_size
        return found

    def subtract_dark(self, pixels: Array) -> Array:
        """Pixels less the dark frame, if there is one."""
        if self.dark is None:
            return pixels
        from lfcal import subtract_dark

        from ..sequence.frames import read_dark

        with name_file_in_errors(self.dark):
            return subtract_dark(pixels, read_dark(self.dark))

    def calibrate(
        self, pixels: Array, known: Calibration | None = None
    ) -> tuple[Array, Calibration]:
        """The flat in colour and its camera: `known` from another flat if the pixels agree."""
        with self.report.stage("calibrate"):
            calibration = known
            if calibration is None or not _agrees(calibration, pixels):
                calibration = self.find_camera(pixels)
            if calibration.mosaic is not None and pixels.ndim == 2:
                from ..flat.demosaicing import demosaic

                pixels = demosaic(pixels, calibration)
            return pixels, calibration

    def find_camera(self, pixels: Any) -> Calibration:
        """The camera of the file, or calibrated from the white image or from the pixels.

        With a camera file of lfcal, `pixels` may be a `FlatSource`. Videos are encoded for display,
        whatever bits they have.
        """
        if self.mosaic is not None and len(pixels.shape) == 3:
            raise click.UsageError(f"{self.flat} is in colour already; leave out --mosaic")
        known = self.camera is not None
        if self.camera is not None:
            calibration = self._read_camera(self.camera, pixels)
        elif self.white is not None:
            calibration = self._calibrate_white(self.white, pixels)
        elif self.recording is not None and self.recording.camera is not None:
            known = True
            calibration = self.recording.camera
        else:
            calibration = self._calibrate_scene(pixels)
        if known and self.mosaic is not None:
            import numpy as np

            shown = pixels if isinstance(pixels, np.ndarray) else None
            calibration = calibration.with_mosaic(self.mosaic, flat=shown)
        video = self.flat.suffix.lower() in {*VIDEO_FORMATS, RAW_SUFFIX}
        if calibration.encoded is None and (video or self.dark is not None):
            # A dark frame can be subtracted from linear values only.
            return replace(calibration, encoded=video)
        return calibration

    def _read_camera(self, path: Path, pixels: Array | FlatSource) -> Calibration:
        """A camera file for flats of this size, as the pixels confirm it.

        Colour filters that a published one does not know are found on the flat.
        """
        import numpy as np

        from lfcal import load, widen_microimages

        from ..depth.region import crop_lattice

        size = np.array(pixels.shape[1::-1])
        calibration = load(path, (int(size[0]), int(size[1])))
        if not is_published(path):
            self.report.camera_warnings(path, calibration.warnings)
        if isinstance(pixels, np.ndarray):
            checked = self._check(calibration, pixels, path)
            return widen_microimages(checked.with_mosaic_of(pixels), pixels)
        # The middle of a flat that is not in memory; even, so that a colour filter mosaic keeps its
        # phase.
        low = np.maximum(size - _CHECKED, 0) // 4 * 2
        high = np.minimum(low + _CHECKED, size)
        part = pixels.read(*low.tolist(), *high.tolist())
        lattice = calibration.lattice
        shown = replace(calibration, lattice=crop_lattice(lattice, low, high), gain_map=None)
        checked = self._check(shown, part, path)
        shift = checked.lattice.origin - shown.lattice.origin
        lattice = replace(lattice, origin=lattice.origin + shift)
        moved = replace(calibration, lattice=lattice, warnings=checked.warnings)
        return moved.with_mosaic_of(part)

    def _calibrate_scene(self, pixels: Array) -> Calibration:
        from lfcal import calibrate

        with name_file_in_errors(self.flat):
            calibration = calibrate(pixels, mosaic=self.mosaic)
        if calibration.source != "white":
            return calibration
        warning = (
            "this is a white image, there is no scene in it; give a capture, and this one "
            "as --white"
        )
        return replace(calibration, warnings=(*calibration.warnings, warning))

    def _calibrate_white(self, path: Path, pixels: Array) -> Calibration:
        from lfcal import FlatError, calibrate, read_flat, widen_microimages

        white = read_flat(path)
        own, other = (f"{flat.shape[1]} x {flat.shape[0]}" for flat in (white, pixels))
        if own != other:
            raise FlatError(
                f"{path}: white image and flat must be of one size, they have {own} and {other} px"
            )
        white = self.subtract_dark(white)
        mosaic = self.mosaic if white.ndim == 2 else None
        with name_file_in_errors(path):
            calibration = calibrate(white, kind="white", mosaic=mosaic)
        calibration = self._check(calibration, pixels, path)
        # Scenes show more of which filters are red.
        return widen_microimages(calibration.with_mosaic_of(pixels), pixels)

    def _check(self, calibration: Calibration, pixels: Array, source: Path) -> Calibration:
        """The camera of a file or white image, as the pixels confirm it (`CameraCheck.apply`)."""
        from lfcal import check_camera

        if self.no_check:
            return calibration
        return check_camera(pixels, calibration).apply(calibration, source)

    def analyze(self, pixels: Array, calibration: Calibration, **options: Any) -> DepthMap:
        """The depth of the file, or of the flat in colour; `options` as for `lfrender.analyze`."""
        with self.report.stage("analyze"):
            if self.depth_file is not None:
                return self.read_depth(pixels)
            from .. import analyze

            # The camera was checked when it was read.
            options |= {"preset": self.chosen_preset, "check": False}
            return analyze(pixels, calibration, **options)

    def read_depth(self, flat: Array | FlatSource | None) -> DepthMap:
        """The depth of the file, with a warning if it was made from another flat of this size.

        Flats of a colour filter mosaic are checked in colour.
        """
        from ..data.depth_file import DepthFileError
        from ..data.depth_map import DepthMap

        path = self.depth_file
        assert path is not None
        if path.suffix.lower() != ".npz":
            raise DepthFileError(
                f"{path}: is no depth map (.npz); make one with 'lfrender analyze'"
            )
        depth = DepthMap.load(path)
        if flat is not None and depth.image_size == flat.shape[1::-1] and not depth.is_of(flat):
            self.report.warn(
                f"{path} was made from another flat than {self.flat}: edges of the scene may be "
                "drawn at wrong places; analyse this flat"
            )
        return depth

    def finish(self, given: Any, output: Path) -> Finish:
        """What is done to the pictures of a command before they are written.

        The values `given` are `eight_bits`, `exposure`, `tone`, `white_balance` and `quality`.
        """
        from ..output.finish import Finish
        from ..output.formats import read_metadata
        from ..output.picture import encoded_by

        return Finish(
            output,
            given.exposure,
            given.tone,
            given.white_balance,
            given.eight_bits,
            given.quality,
            encoded_by(read_metadata(self.flat)),
        )

    def write(
        self, given: Any, pictures: list[Rendering], settings: list[Entries], **options: Any
    ) -> tuple[list[Path], list[str]]:
        """Write a picture, a stack or an animation; return the files and sentences about them.

        The values `given` are `output` and those of `finish`. Animations go there and back again.
        """
        from ..output.formats import read_metadata
        from ..output.picture import write_finished, write_stack

        output = given.output
        embedded = read_metadata(self.flat)
        finish = self.finish(given, output).measured(pictures[0])
        written = [output]
        with self.report.stage("write"):
            if output.suffix.lower() in MOVING:
                from ..sequence.film_file import write_moving

                write_moving(output, [*pictures, *pictures[-2:0:-1]], finish)
            elif len(pictures) > 1:
                stored: Entries = {"settings": settings, "embedded": embedded}
                written = write_stack(output, pictures, finish=finish, **stored)
            else:
                options |= {"settings": settings[0], "embedded": embedded}
                write_finished(output, pictures[0], finish, **options)
        return written, finish.sentences(pictures[0])


def is_large(flat: Path) -> bool:
    """Whether a flat can be read in parts and is too large to be faster as a whole."""
    from lfcal import LightFieldError, open_flat

    # A compressed file that is a hundred times smaller need not be opened: its flat is smaller too.
    is_file = (
        flat.is_file()
        and flat.suffix.lower() in TIFF_SUFFIXES
        and flat.stat().st_size >= _LARGE / 100
    )
    if not (is_file or flat.is_dir()):
        return False
    try:
        with open_flat(flat) as source:
            return source.in_parts and source.nbytes > _LARGE
    except (LightFieldError, OSError):
        # Reading the file will report what is wrong with it.
        return False


def is_published(path: Path) -> bool:
    """Whether a camera file is of another program: its lattice may be moved onto the pixels."""
    return path.suffix.lower() != ".json"


def _agrees(calibration: Calibration, pixels: Array) -> bool:
    from lfcal import check_camera

    return calibration.image_size == pixels.shape[1::-1] and check_camera(pixels, calibration).fits
