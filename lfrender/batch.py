"""All-in-focus pictures of the frames of a sequence: one camera, and depth that is kept where nothing moves.

The sequence is cut into stretches. The first frame of each is analysed against the first frame of the stretch before,
all others against the first frame of their own: still parts keep one depth from picture to picture, and a run that
was killed goes on with the same pictures as if it had not been.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError, load, whole_file

from .analysis import analyze
from .demosaicing import demosaic
from .depthmap import DepthMap
from .drawing import default_scale, render
from .frames import Frame
from .picture import check_picture, write_picture

__all__ = ["FrameResult", "render_frames"]

# Frames from one that is analysed against the far past to the next.
_STRETCH = 30
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
class _Key:
    """The frame that others of its stretch are analysed against; flat and depth are there once they were needed."""

    number: int
    frame: Frame
    flat: NDArray[Any] | None = None
    depth: DepthMap | None = None


def render_frames(
    frames: Iterable[Frame],
    folder: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: str = "balanced",
    scale: float | None = None,
    suffix: str = ".tif",
    overwrite: bool = False,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a folder, one picture a frame.

    The folder also gets a hidden folder with the camera, the settings, and a depth map every 30 frames. Run again with
    the same settings, only pictures that are not there are rendered, and they are the same as in one run.
    A frame that cannot be read or analysed is reported, and the others are rendered.

    Parameters
    ----------
    frames : iterable of Frame
        From `open_frames`.
    folder : path-like
        Made where it does not exist; its parent must exist.
    calibration : Calibration or None
        With None that of an earlier run into this folder, or else calibrated from the first frame that can be.
    preset : {"fast", "balanced", "accurate"}
    scale : float or None
        Output pixels per pitch; with None the full resolution of the first frame, for all frames.
    suffix : str
        Kind of the pictures: `".tif"`, `".png"`, ...
    overwrite : bool
        Render all frames anew, whatever is in the folder.

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError
        If the folder or a picture cannot be written, or it holds pictures made with other settings.
    """
    job = _Job.opened(Path(folder), calibration, preset, scale, suffix, overwrite)
    earlier: _Key | None = None
    key: _Key | None = None
    wanted = None if overwrite else job.is_missing
    for number, (frame, reading) in enumerate(_read_ahead(frames, wanted)):
        if number % _STRETCH == 0:
            earlier, key = key or earlier, None
        path = job.path_of(frame)
        if reading is None:
            key = key or _Key(number, frame)
            yield FrameResult(frame.name, path, "kept")
            continue
        start = perf_counter()
        try:
            pixels = job.in_colour(reading.result())
            if key is None:
                key = _Key(number, frame, pixels)
            if key.depth is None:
                key = job.with_depth(key, earlier)
                # Its flat is as large as this one's.
                earlier = None
            depth = key.depth if key.number == number else job.depth_after(key, pixels)
            assert depth is not None
            job.write(path, pixels, depth)
        except OutputError:
            raise
        except LightFieldError as error:
            if key is not None and key.number == number:
                key = None
            yield FrameResult(frame.name, path, "failed", f"{frame.name}: {error}", perf_counter() - start)
            continue
        yield FrameResult(
            frame.name, path, "rendered", "", perf_counter() - start, float(depth.saved.get("still", 0.0))
        )


def _read_ahead(
    frames: Iterable[Frame], wanted: Callable[[Frame], bool] | None
) -> Iterator[tuple[Frame, Future[NDArray[Any]] | None]]:
    """Each frame with its pixels, which are read while the frame before is being worked on; None where not wanted."""
    with ThreadPoolExecutor(1) as reader:
        waiting: tuple[Frame, Future[NDArray[Any]] | None] | None = None
        for frame in frames:
            following = frame, reader.submit(frame.read) if wanted is None or wanted(frame) else None
            if waiting is not None:
                yield waiting
            waiting = following
        if waiting is not None:
            yield waiting


@dataclass
class _Job:
    """Settings of a run, and what it keeps in the hidden folder."""

    folder: Path
    calibration: Calibration | None
    preset: str
    scale: float | None
    suffix: str

    @classmethod
    def opened(
        cls,
        folder: Path,
        calibration: Calibration | None,
        preset: str,
        scale: float | None,
        suffix: str,
        overwrite: bool,
    ) -> _Job:
        state = folder / _STATE
        try:
            state.mkdir(parents=folder.parent.is_dir(), exist_ok=True)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be made ({error.strerror or error})") from error
        check_picture(folder / f"picture{suffix}")
        job = cls(folder, calibration, preset, scale, suffix)
        if overwrite:
            for old in [*state.glob("depth_*.npz"), state / "camera.json", state / "settings.json"]:
                old.unlink(missing_ok=True)
        if (state / "settings.json").exists():
            job._resume(state)
        return job

    def _resume(self, state: Path) -> None:
        """Take over the camera and the scale of an earlier run."""
        camera = load(state / "camera.json")
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

    def path_of(self, frame: Frame) -> Path:
        return self.folder / f"{frame.name}{self.suffix}"

    def is_missing(self, frame: Frame) -> bool:
        return not self.path_of(frame).exists()

    def in_colour(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """The flat without its colour mosaic, where the camera has one."""
        mosaic = self.calibration is not None and self.calibration.mosaic is not None
        return demosaic(pixels, self._camera(pixels)) if mosaic and pixels.ndim == 2 else pixels

    def _camera(self, pixels: NDArray[Any]) -> Calibration:
        if self.calibration is None:
            from lfcal import calibrate

            self.calibration = calibrate(pixels)
        return self.calibration

    def with_depth(self, key: _Key, earlier: _Key | None) -> _Key:
        """The key frame with flat and depth, which is in the hidden folder or analysed against an earlier key frame."""
        flat = self.in_colour(key.frame.read()) if key.flat is None else key.flat
        file = self.folder / _STATE / f"depth_{key.number:06d}.npz"
        if file.exists():
            return replace(key, flat=flat, depth=DepthMap.load(file))
        camera = self._camera(flat)
        if earlier is None:
            depth = analyze(flat, camera, self.preset)
        else:
            depth = self.depth_after(earlier if earlier.depth else self.with_depth(earlier, None), flat)
        if self.scale is None:
            self.scale = default_scale(depth)
        self._remember(camera)
        depth.save(file)
        return replace(key, flat=flat, depth=depth)

    def depth_after(self, key: _Key, flat: NDArray[Any]) -> DepthMap:
        """Depth of a frame whose still parts keep that of a key frame."""
        assert key.flat is not None and key.depth is not None
        return analyze(flat, self._camera(flat), self.preset, previous=(key.flat, key.depth))

    def _remember(self, camera: Calibration) -> None:
        state = self.folder / _STATE
        if (state / "settings.json").exists():
            return
        camera.save(state / "camera.json")
        with whole_file(state / "settings.json") as temporary:
            temporary.write_text(json.dumps({"preset": self.preset, "scale": self.scale}), encoding="utf-8")

    def write(self, path: Path, pixels: NDArray[Any], depth: DepthMap) -> None:
        """Draw and write the picture of a frame."""
        picture = render(pixels, self._camera(pixels), depth, scale=self.scale)
        check_picture(path, np.asarray(picture.image).dtype)
        write_picture(path, picture, settings={"rendering": "all in focus", "preset": self.preset})
