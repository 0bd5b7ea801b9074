"""One run over a sequence: its settings, what it keeps in its folder, and what it does with one frame.

The sequence is cut into stretches, and these into groups. The first frame of a stretch, its key, is analysed against
the key of the stretch before, the first of any other group against the key of its stretch, and all others against the
first of their group, since which little has moved: still parts keep one depth from picture to picture, and a run that
was killed, or was spread over many machines, makes the same pictures as one that was not.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError, load
from lfcal.runtime.output_file import atomic_write

from ..data.depth_map import DepthFileError, DepthMap
from ..data.rendering import Rendering
from ..depth.analyze import analyze
from ..depth.incremental import load_reference_match, save_reference_match
from ..flat.demosaicing import demosaic
from ..output.metadata import EmbeddedMetadata, read_metadata
from ..output.picture import check_picture, write_picture
from ..rendering.render import default_scale, render
from .frames import Frame

__all__ = ["GROUP_LENGTH", "SEGMENT_LENGTH", "FrameResult", "Job", "KeyFrame", "load_camera"]

#: Number of frames from one key frame to the next.
SEGMENT_LENGTH = 30
#: Number of frames of a segment that are compared with the same frame, the first of them.
GROUP_LENGTH = 5
# Pictures of keys that are kept, those used last: of a stretch, of the first of a group, and of the next.
_PICTURES = 3
_STATE = ".lfrender"


@dataclass(frozen=True)
class FrameResult:
    """What became of one frame.

    Parameters
    ----------
    name : str
    path : Path
        Its picture.
    outcome : {"rendered", "kept", "failed"}
        Kept pictures were there already.
    message : str
        Why it failed, else empty.
    seconds : float
        From the pixels to the picture.
    still : float
        Share of the lenses that kept the depth of an earlier frame.
    """

    name: str
    path: Path
    outcome: Literal["rendered", "kept", "failed"]
    message: str = ""
    seconds: float = 0.0
    still: float = 0.0


@dataclass(frozen=True)
class KeyFrame:
    """A frame that others of its stretch or group are analysed against; flat and depth are there once needed.

    Where nothing has changed since the frame `before` in its stretch, if any, it shows the picture of that.
    """

    number: int
    frame: Frame
    flat: NDArray[Any] | None = None
    depth: DepthMap | None = None
    before: KeyFrame | None = None


def load_camera(folder: Path) -> Calibration:
    """The camera of the pictures in a folder, once there are some."""
    return load(folder / _STATE / "camera.json")


@dataclass
class Job:
    """Settings of a run, and what it keeps in the hidden folder."""

    folder: Path
    calibration: Calibration | None
    preset: str
    scale: float | None
    suffix: str
    _pictures: dict[int, Rendering] = field(default_factory=dict)
    _drawing: RLock = field(default_factory=RLock, compare=False)

    @classmethod
    def opened(
        cls,
        folder: Path,
        calibration: Calibration | None,
        preset: str,
        scale: float | None,
        suffix: str,
        overwrite: bool,
    ) -> Job:
        state = folder / _STATE
        try:
            state.mkdir(parents=folder.parent.is_dir(), exist_ok=True)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be made ({error.strerror or error})") from error
        check_picture(folder / f"picture{suffix}")
        job = cls(folder, calibration, preset, scale, suffix)
        if overwrite:
            for old in [
                *state.glob("depth_*.npz"),
                *state.glob("comparison_*.npz"),
                state / "camera.json",
                state / "settings.json",
            ]:
                old.unlink(missing_ok=True)
        if (state / "settings.json").exists():
            job._resume(state)
        return job

    def _resume(self, state: Path) -> None:
        """Take over the camera and the scale of an earlier run."""
        camera = load_camera(self.folder)
        try:
            settings = json.loads((state / "settings.json").read_text(encoding="utf-8"))
            same = settings["preset"] == self.preset and self.scale in (None, settings["scale"])
            self.scale = float(settings["scale"])
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise OutputError(f"{state}: damaged ({error}); render everything anew (--overwrite)") from error
        if not same or (self.calibration is not None and self.calibration.to_dict() != camera.to_dict()):
            raise OutputError(
                f"{self.folder}: holds pictures made with another camera, preset or scale; "
                "give another folder, or render everything anew (--overwrite)"
            )
        self.calibration = camera

    def result(self, number: int, frame: Frame, flat: Callable[[], NDArray[Any]], key: KeyFrame) -> FrameResult:
        """Analyse and draw one frame; `flat` gives its pixels in colour, `key`, the first of its group, has flat and
        depth."""
        path, start = self.path_of(frame), perf_counter()
        try:
            pixels = flat()
            if key.number == number:
                depth, picture = key.depth, self.key_picture(key)
            else:
                depth = self.depth_after(key, pixels)
                picture = self._picture_after(key, pixels, depth)
            assert depth is not None
            self.write(path, picture, EmbeddedMetadata() if frame.source is None else read_metadata(frame.source))
        except OutputError:
            raise
        except LightFieldError as error:
            return self.failure(frame, error, perf_counter() - start)
        still = float(depth.saved.get("still", 0.0))
        return FrameResult(frame.name, path, "rendered", "", perf_counter() - start, still)

    def failure(self, frame: Frame, error: LightFieldError, seconds: float = 0.0) -> FrameResult:
        return FrameResult(frame.name, self.path_of(frame), "failed", f"{frame.name}: {error}", seconds)

    def depth_file(self, key: KeyFrame) -> Path:
        """Where the depth map of a key frame is kept."""
        return self.folder / _STATE / f"depth_{key.number:06d}.npz"

    def _comparison_file(self, key: KeyFrame) -> Path:
        """Where is kept what frames after a key frame are compared with."""
        return self.folder / _STATE / f"comparison_{key.number:06d}.npz"

    def path_of(self, frame: Frame) -> Path:
        return self.folder / f"{frame.name}{self.suffix}"

    def is_missing(self, frame: Frame) -> bool:
        return not self.path_of(frame).exists()

    def in_colour(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """The flat without its colour mosaic, where the camera has one."""
        mosaic = self.calibration is not None and self.calibration.mosaic is not None
        return demosaic(pixels, self.camera(pixels)) if mosaic and pixels.ndim == 2 else pixels

    def camera(self, pixels: NDArray[Any]) -> Calibration:
        """The camera of the run, calibrated from these pixels where it has none yet."""
        if self.calibration is None:
            from lfcal import calibrate

            self.calibration = calibrate(pixels)
        return self.calibration

    def with_depth(self, key: KeyFrame, earlier: KeyFrame | None) -> KeyFrame:
        """The key of a stretch with flat and depth, which is in the hidden folder or analysed against another key."""
        if earlier is None or self.depth_file(key).exists():
            return self._analysed(key, None, self._comparison_file(key))
        earlier = earlier if earlier.depth else self.with_depth(earlier, None)
        # In its own stretch it has been compared with for itself.
        depth = self._kept_depth(self.depth_file(earlier))
        load_reference_match(depth, self._comparison_file(earlier))
        return self._analysed(key, replace(earlier, depth=depth), self._comparison_file(key))

    def first_of_group(self, first: KeyFrame, key: KeyFrame) -> KeyFrame:
        """The first frame of a group with flat and depth; it may be the key of its stretch itself."""
        return key if first.number == key.number else replace(self._analysed(first, key), before=key)

    def _analysed(self, key: KeyFrame, earlier: KeyFrame | None, comparison: Path | None = None) -> KeyFrame:
        """A frame with flat and depth, which is in the hidden folder or analysed against an earlier one; what later
        ones are compared with is kept in the file `comparison`."""
        flat = self.in_colour(key.frame.read()) if key.flat is None else key.flat
        file = self.depth_file(key)
        if not file.exists():
            camera = self.camera(flat)
            depth = analyze(flat, camera, self.preset) if earlier is None else self.depth_after(earlier, flat)
            if self.scale is None:
                self.scale = default_scale(depth)
            self._remember(camera)
            if comparison is not None:
                save_reference_match(depth, comparison)
            depth.save(file)
        # What an analysis remembers of a depth map beside its file, another worker or a later run would not have.
        return replace(key, flat=flat, depth=self._kept_depth(file))

    def _kept_depth(self, file: Path) -> DepthMap:
        """A depth map of the hidden folder, which another version may have left there."""
        try:
            return DepthMap.load(file)
        except DepthFileError as error:
            what = "left by another version, or damaged; render everything anew (--overwrite)"
            raise OutputError(f"{file}: {what}") from error

    def depth_after(self, key: KeyFrame, flat: NDArray[Any]) -> DepthMap:
        """Depth of a frame whose still parts keep that of a key frame."""
        assert key.flat is not None and key.depth is not None
        return analyze(flat, self.camera(flat), self.preset, previous=(key.flat, key.depth))

    def _remember(self, camera: Calibration) -> None:
        state = self.folder / _STATE
        if (state / "settings.json").exists():
            return
        camera.save(state / "camera.json")
        with atomic_write(state / "settings.json") as temporary:
            temporary.write_text(json.dumps({"preset": self.preset, "scale": self.scale}), encoding="utf-8")

    def key_picture(self, key: KeyFrame) -> Rendering:
        """The picture of a key frame, whose pixels are kept where nothing has changed since."""
        # The last frames of one group and the first of the next may be worked on at once.
        with self._drawing:
            picture = self._pictures.pop(key.number, None)
            if picture is None:
                assert key.flat is not None and key.depth is not None
                if key.before is None:
                    picture = render(key.flat, self.camera(key.flat), key.depth, scale=self.scale)
                else:
                    picture = self._picture_after(key.before, key.flat, key.depth)
            self._pictures = {**dict(list(self._pictures.items())[1 - _PICTURES :]), key.number: picture}
            return picture

    def _picture_after(self, key: KeyFrame, flat: NDArray[Any], depth: DepthMap) -> Rendering:
        """The picture of a frame, which keeps pixels of that of a key frame."""
        assert key.flat is not None and key.depth is not None
        return render(flat, self.camera(flat), depth, previous=(key.flat, key.depth, self.key_picture(key)))

    def write(self, path: Path, picture: Rendering, embedded: EmbeddedMetadata) -> None:
        """Write the picture of a frame, with what its file says of its colours and of how it was taken."""
        check_picture(path, np.asarray(picture.image).dtype)
        settings = {"rendering": "all in focus", "preset": self.preset}
        write_picture(path, picture, settings=settings, embedded=embedded)
