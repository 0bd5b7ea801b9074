"""One run over a sequence: its settings, the files in its hidden folder, and the analysis and picture of one frame.

The sequence is divided into segments, and these into groups. Depth is updated incrementally, so that static parts keep
one depth from picture to picture: the first frame of a segment, its key frame, is compared with the key frame of the
segment before; the first frame of any other group with the key frame of its segment; all others with the first of their
group. A run that was interrupted, or spread over many machines, therefore makes the same pictures as any other.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError, load
from lfcal.runtime.output_file import atomic_write, make_folder

from ..data.depth_map import DepthFileError, DepthMap, default_scale
from ..data.rendering import Rendering
from ..depth.analyze import analyze
from ..depth.incremental import load_reference_match, save_reference_match
from ..flat.demosaicing import demosaic
from ..output.metadata import EmbeddedMetadata, read_metadata
from ..output.picture import check_picture, eight_bits, write_picture
from ..rendering.render import render
from .frames import Frame
from .view_grid import ViewGrid, ViewOutput

__all__ = ["FrameResult", "Job", "KeyFrame", "load_camera"]

_HIDDEN = ".lfrender"
# Pictures of key frames held in memory, the last ones used: of a segment, of a group, and of the next group.
_PICTURES = 3


@dataclass(frozen=True)
class FrameResult:
    """The outcome of one frame.

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

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> with TemporaryDirectory() as folder:
    ...     for number in range(2):
    ...         lfrender.write_picture(f"{folder}/{number}.png", flat)
    ...     first, *_ = lfrender.render_frames(lfrender.open_frames([folder]), f"{folder}/out", camera, preset="fast")
    >>> first.name, first.path.name, first.outcome
    ('0', '0.tif', 'rendered')
    """

    name: str
    path: Path
    outcome: Literal["rendered", "kept", "failed"]
    message: str = ""
    seconds: float = 0.0
    still: float = 0.0


@dataclass(frozen=True)
class KeyFrame:
    """A frame that others of its segment or group are compared with; flat and depth are filled in when needed.

    `before` is the frame of its segment, if any, whose picture it keeps where nothing has changed.
    """

    number: int
    frame: Frame
    flat: NDArray[Any] | None = None
    depth: DepthMap | None = None
    before: KeyFrame | None = None


def load_camera(folder: Path) -> Calibration:
    """The camera of the pictures in a folder, once there are some."""
    return load(folder / _HIDDEN / "camera.json")


@dataclass
class Job:
    """Settings of a run, and the files in its hidden folder."""

    folder: Path
    calibration: Calibration | None
    preset: str
    scale: float | None
    suffix: str
    views: ViewGrid | None = None
    eight_bits: bool = False
    dark: str | None = None  # file of the dark frame
    encoded: bool = False  # frames are encoded for display, whatever bits they have
    still: float | None = None  # patch size [px] of the places that all views have in common
    _output: ViewOutput | None = None
    _pictures: dict[int, Rendering] = field(default_factory=dict)
    _drawing: RLock = field(default_factory=RLock, compare=False)

    @classmethod
    def open(
        cls,
        folder: Path,
        calibration: Calibration | None,
        preset: str,
        scale: float | None,
        suffix: str,
        overwrite: bool,
        views: ViewGrid | None = None,
        eight_bits: bool = False,
        dark: str | None = None,
        encoded: bool = False,
    ) -> Job:
        """Start a run in a folder, or continue the one that is there."""
        hidden = folder / _HIDDEN
        make_folder(folder)
        make_folder(hidden)
        job = cls(folder, calibration, preset, scale, suffix, views, eight_bits, dark, encoded)
        job.calibration = calibration and job._as_stored(calibration)
        if views is None:
            check_picture(folder / f"picture{suffix}")
        else:
            job._output = ViewOutput(folder, hidden, views, suffix)
            job._output.start(overwrite)
        if overwrite:
            for pattern in ("depth_*.npz", "comparison_*.npz", "camera.json", "settings.json"):
                for file in hidden.glob(pattern):
                    file.unlink()
        if job._settings_file.exists():
            job._resume()
        return job

    def _resume(self) -> None:
        """Take camera and scale from an earlier run."""
        hidden = self.folder / _HIDDEN
        camera = load_camera(self.folder)
        try:
            settings = json.loads(self._settings_file.read_text(encoding="utf-8"))
            views = None if self.views is None else {**self.views.to_dict(), "format": self.suffix}
            same = settings["preset"] == self.preset and self.scale in (None, settings["scale"])
            same &= settings.get("views") == views and settings.get("eight_bits", False) == self.eight_bits
            same &= settings.get("dark") == self.dark
            self.scale = float(settings["scale"])
            self.still = None if views is None else float(settings["still"])
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise OutputError(f"{hidden}: damaged ({error}); render everything again (--overwrite)") from error
        given = self.calibration
        if not same or (given is not None and given.to_dict() != camera.to_dict()):
            raise OutputError(
                f"{self.folder}: holds pictures made with another camera, dark frame, preset or scale; "
                "give another folder, or render everything again (--overwrite)"
            )
        self.calibration = camera

    def path_of(self, frame: Frame) -> Path:
        if self._output is not None:
            return self._output.path_of(frame.name)
        return self.folder / f"{frame.name}{self.suffix}"

    def is_missing(self, frame: Frame) -> bool:
        if self._output is not None:
            return self._output.is_missing(frame.name)
        return not self.path_of(frame).exists()

    def finish(self, names: list[str]) -> None:
        """Move what becomes whole with the last frame into place, once all frames of these names are done."""
        if self._output is not None:
            self._output.finish(names)

    def depth_file(self, key: KeyFrame) -> Path:
        """File of the depth map of a key frame."""
        return self.folder / _HIDDEN / f"depth_{key.number:06d}.npz"

    def _comparison_file(self, key: KeyFrame) -> Path:
        """File of what later frames are compared with, beside the depth map of a key frame."""
        return self.folder / _HIDDEN / f"comparison_{key.number:06d}.npz"

    def camera(self, pixels: NDArray[Any]) -> Calibration:
        """The camera of the run, calibrated from these pixels if there is none yet."""
        if self.calibration is None:
            from lfcal import calibrate

            self.calibration = self._as_stored(calibrate(pixels))
        return self.calibration

    @property
    def _settings_file(self) -> Path:
        return self.folder / _HIDDEN / "settings.json"

    def _as_stored(self, calibration: Calibration) -> Calibration:
        return replace(calibration, encoded=True) if self.encoded and calibration.encoded is None else calibration

    def demosaic(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """The flat in colour, if the camera has a colour mosaic."""
        return demosaic(pixels, self.camera(pixels)) if pixels.ndim == 2 else pixels

    def kept(self, frame: Frame) -> FrameResult:
        """The outcome of a frame whose picture is there already."""
        return FrameResult(frame.name, self.path_of(frame), "kept")

    def failed(self, frame: Frame, error: LightFieldError, seconds: float = 0.0) -> FrameResult:
        """The outcome of a frame that cannot be rendered."""
        return FrameResult(frame.name, self.path_of(frame), "failed", f"{frame.name}: {error}", seconds)

    def render_frame(self, number: int, frame: Frame, flat: NDArray[Any], first: KeyFrame) -> FrameResult:
        """Analyse, draw and write one frame, with its pixels in colour; `first` of its group has flat and depth."""
        path, start = self.path_of(frame), perf_counter()
        try:
            if first.number == number:
                assert first.depth is not None
                depth = first.depth
            else:
                depth = self._analyze_after(first, flat)
            if self._output is not None:
                assert self.views is not None and self.still is not None
                pictures = self.views.draw(flat, self.camera(flat), depth, self.scale, self.still)
                pictures = map(eight_bits, pictures) if self.eight_bits else pictures
                self._output.write(number, frame.name, pictures)
            else:
                own = first.number == number
                self._write(path, frame, self._key_picture(first) if own else self._render_after(first, flat, depth))
        except OutputError:
            raise
        except LightFieldError as error:
            return self.failed(frame, error, perf_counter() - start)
        still = float(depth.saved.get("still", 0.0))
        return FrameResult(frame.name, path, "rendered", "", perf_counter() - start, still)

    def _write(self, path: Path, frame: Frame, picture: Rendering) -> None:
        check_picture(path, np.asarray(picture.image).dtype)
        settings = {"rendering": "all in focus", "preset": self.preset}
        embedded = EmbeddedMetadata() if frame.source is None else read_metadata(frame.source)
        shown = eight_bits(picture) if self.eight_bits else picture
        write_picture(path, shown, settings=settings, embedded=embedded)

    def analyze_key(self, key: KeyFrame, earlier: KeyFrame | None) -> KeyFrame:
        """The key frame of a segment with flat and depth, analysed against that of an earlier segment, if any."""
        if earlier is None or self.depth_file(key).exists():
            return self._analyze_once(key, None, self._comparison_file(key))
        earlier = earlier if earlier.depth else self.analyze_key(earlier, None)
        # A fresh copy: the state of `earlier.depth` is that of its own segment.
        depth = load_reference_match(self._load_depth(self.depth_file(earlier)), self._comparison_file(earlier))
        return self._analyze_once(key, replace(earlier, depth=depth), self._comparison_file(key))

    def analyze_first(self, first: KeyFrame, key: KeyFrame) -> KeyFrame:
        """The first frame of a group with flat and depth; it may be the key frame of its segment itself."""
        return key if first.number == key.number else replace(self._analyze_once(first, key), before=key)

    def _analyze_once(self, key: KeyFrame, earlier: KeyFrame | None, comparison: Path | None = None) -> KeyFrame:
        """A frame with flat and depth; analysed, unless its depth map is in the hidden folder.

        What later frames are compared with is saved to the file `comparison`.
        """
        flat = self.demosaic(key.frame.read()) if key.flat is None else key.flat
        file = self.depth_file(key)
        if not file.exists():
            camera = self.camera(flat)
            depth = analyze(flat, camera, self.preset) if earlier is None else self._analyze_after(earlier, flat)
            if self.scale is None:
                self.scale = default_scale(depth)
            if self.views is not None and self.still is None:
                self.still = self.views.find_still(depth)
            self._save_settings(camera)
            if comparison is not None:
                save_reference_match(depth, comparison)
            depth.save(file)
        # Always loaded: other workers and later runs have no more than what is in the file.
        return replace(key, flat=flat, depth=self._load_depth(file))

    def _load_depth(self, file: Path) -> DepthMap:
        try:
            return DepthMap.load(file)
        except DepthFileError as error:
            what = "left by another version, or damaged; render everything again (--overwrite)"
            raise OutputError(f"{file}: {what}") from error

    def _save_settings(self, camera: Calibration) -> None:
        if self._settings_file.exists():
            return
        camera.save(self.folder / _HIDDEN / "camera.json")
        with atomic_write(self._settings_file) as temporary:
            settings: dict[str, Any] = {"preset": self.preset, "scale": self.scale, "eight_bits": self.eight_bits}
            settings["dark"] = self.dark
            if self.views is not None:
                settings |= {"views": {**self.views.to_dict(), "format": self.suffix}, "still": self.still}
            temporary.write_text(json.dumps(settings), encoding="utf-8")

    def _analyze_after(self, key: KeyFrame, flat: NDArray[Any]) -> DepthMap:
        """Depth of a frame, updated from that of a key frame."""
        assert key.flat is not None and key.depth is not None
        return analyze(flat, self.camera(flat), self.preset, previous=(key.flat, key.depth))

    def _render_after(self, key: KeyFrame, flat: NDArray[Any], depth: DepthMap) -> Rendering:
        """Picture of a frame, updated from that of a key frame."""
        assert key.flat is not None and key.depth is not None
        return render(flat, self.camera(flat), depth, previous=(key.flat, key.depth, self._key_picture(key)))

    def _key_picture(self, key: KeyFrame) -> Rendering:
        """The picture of a key frame."""
        # Locked: the last frames of one group and the first of the next may be worked on at once.
        with self._drawing:
            picture = self._pictures.pop(key.number, None)
            if picture is None:
                assert key.flat is not None and key.depth is not None
                if key.before is None:
                    picture = render(key.flat, self.camera(key.flat), key.depth, scale=self.scale)
                else:
                    picture = self._render_after(key.before, key.flat, key.depth)
            self._pictures = {**dict(list(self._pictures.items())[1 - _PICTURES :]), key.number: picture}
            return picture
