"""One run over a sequence: its settings, the files in its hidden folder, and the analysis and
picture of each frame.

The sequence is divided into segments, and these into groups. Depth is updated incrementally, so
that static parts keep one depth from picture to picture: the first frame of a segment, its key
frame, is compared with the key frame of the segment before; the first frame of any other group with
the key frame of its segment; all others with the first of their group. A run that was interrupted,
or spread over many machines, therefore makes the same pictures as any other.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, Literal

from lfcal import Calibration, LightFieldError, OutputError, calibrate, load
from lfcal.runtime.arrays import Array, Exposure, exposure_gain
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, make_folder, refuse_leftovers

from ..data.depth_map import DepthFileError, DepthMap, default_scale
from ..data.rendering import PictureGrid, Rendering
from ..depth.analyze import analyze
from ..flat.demosaicing import demosaic
from ..output.depth_picture import depth_picture, magnification_limits
from ..output.formats import EmbeddedMetadata, check_format, read_metadata
from ..output.picture import Brightness, eight_bits, write_picture
from ..rendering.render import render
from ..rendering.viewpoints import still_depth
from ..runtime.choices import Preset
from .frames import Frame, is_video
from .view_grid import ViewGrid, ViewOutput

__all__ = ["FrameResult", "Group", "Job", "load_camera", "render_group"]

_HIDDEN = ".lfrender"
# Of key frames: groups of one segment may be worked on at once.
_LOCK = RLock()


@dataclass(frozen=True)
class FrameResult:
    """The outcome of one frame.

    Examples
    --------
    >>> FrameResult("f1", Path("pictures/f1.tif"), "kept").outcome
    'kept'
    """

    name: str
    path: Path  # of its picture
    outcome: Literal["rendered", "kept", "failed"]  # kept pictures were there already
    message: str = ""  # why it failed
    seconds: float = 0.0  # from the pixels to the picture
    still: float = 0.0  # share of the lenses that kept the depth of an earlier frame


@dataclass
class Group:
    """Frames that are worked on together."""

    outcomes: list[FrameResult | None] = field(
        default_factory=list
    )  # None for frames to be rendered ...
    missing: list[tuple[int, Frame]] = field(
        default_factory=list
    )  # ... which are these, and their places
    first: Frame | None = (
        None  # the frame that they are compared with, if its picture is there already
    )
    key: Frame | None = None  # of their segment


@dataclass
class _Reference:
    """A frame that others are compared with."""

    name: str
    flat: Array
    depth: DepthMap
    picture: Rendering | None = None


def load_camera(folder: Path) -> Calibration:
    """The camera of the pictures in a folder, once there are some."""
    return load(folder / _HIDDEN / "camera.json")


@dataclass
class Job:
    """Settings of a run, and the files in its hidden folder."""

    folder: Path
    calibration: Calibration | None
    preset: Preset
    scale: float | None
    suffix: str
    views: ViewGrid | None = None
    eight_bits: bool = False
    dark: str | None = None  # file of the dark frame
    encoded: bool = False  # frames are encoded for display, whatever bits they have
    depth_maps: Path | None = None  # folder of the depth maps of frames, or film of their pictures
    still: float | None = None  # patch size [px] of the places that all views have in common
    colours: tuple[float, float] | None = (
        None  # magnification at the ends of the colours of depth pictures
    )
    stopped: bool = False  # nobody takes the results of further frames
    output: ViewOutput | None = None  # files of views
    exposure: Exposure | None = None
    gain: float = 1.0  # of all pictures, by `exposure` and the first frame
    _keys: dict[str, _Reference] = field(
        default_factory=dict
    )  # the last two, of neighbouring segments

    def __post_init__(self) -> None:
        self.hidden = self.folder / _HIDDEN
        self._settings_file = self.hidden / "settings.json"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_keys": {}}

    def start(self, overwrite: bool, names: list[str]) -> None:
        """Make the folder, or continue the run that is there, with frames of these names."""
        make_folder(self.folder)
        make_folder(self.hidden)
        if self.calibration is not None:
            self.calibration = self._as_stored(self.calibration)
        if self.views is None:
            check_format(self.folder / f"picture{self.suffix}", "picture")
        else:
            self.output = ViewOutput(self.folder, self.hidden, self.suffix)
            self.output.start(overwrite, names)
        if self.depth_maps is not None:
            make_folder(self.depth_path_of("").parent)
        if overwrite and names and self.output is None and self._settings_file.exists():
            # Frames of an earlier run that this one leaves would be taken for pictures of this one
            # by the next.
            pictures = [self.path_of(name).name for name in names]
            refuse_leftovers(self.folder, rf"[^.].*{re.escape(self.suffix)}", pictures)
        if overwrite:
            for file in (*self.hidden.glob("*.npz"), *self.hidden.glob("*.json")):
                file.unlink()
        if self._settings_file.exists():
            self._resume()

    def _settings(self) -> dict[str, Any]:
        """What pictures of one folder have in common, beside their camera and scale; as JSON
        returns it.
        """
        views = None if self.views is None else {**asdict(self.views), "format": self.suffix}
        common: dict[str, Any] = {
            "preset": self.preset,
            "eight_bits": self.eight_bits,
            "dark": self.dark,
            "views": views,
        }
        common["exposure"] = self.exposure
        return dict(json.loads(json.dumps(common)))

    def _resume(self) -> None:
        camera = load_camera(self.folder)
        try:
            settings = json.loads(self._settings_file.read_text(encoding="utf-8"))
            found = [settings.pop(name) for name in ("scale", "still", "colours", "gain")]
            scale, self.still, self.colours, self.gain = found
            same = settings == self._settings() and self.scale in (None, scale)
        except (OSError, AttributeError, KeyError, TypeError, ValueError) as error:
            raise OutputError(
                f"{self.hidden}: damaged ({error}); render everything again (--overwrite)"
            ) from error
        if not same or (
            self.calibration is not None and self.calibration.to_dict() != camera.to_dict()
        ):
            raise OutputError(
                f"{self.folder}: holds pictures made with another camera, dark frame, preset or scale; "
                "give another folder, or render everything again (--overwrite)"
            )
        self.calibration, self.scale = camera, scale

    def groups(
        self, frames: Iterable[Frame], overwrite: bool, segment: int, group: int
    ) -> Iterator[Group]:
        """The frames in groups, all but the last with some to be rendered; key frames are analysed
        on the way.
        """
        earlier: Frame | None = None
        key: Frame | None = None
        made = Group()
        for number, frame in enumerate(frames):
            check_type(frame, Frame, "frames", "lfrender.open_frames finds them")
            if number % segment == 0:
                earlier = key or earlier
                key = None
            if number % segment % group == 0:
                if made.missing:
                    yield made
                    made = Group()
                made.first = None
            if not overwrite and not self.is_missing(frame.name):
                key, made.first = key or frame, made.first or frame
                made.outcomes.append(FrameResult(frame.name, self.path_of(frame.name), "kept"))
                continue
            try:
                if key is None or not self._depth_file(key.name).exists():
                    self._analyze_key(key or frame, earlier)
                    key = key or frame
            except OutputError:
                raise
            except LightFieldError as error:
                made.outcomes.append(self.failed(frame, error))
                continue
            made.outcomes.append(None)
            made.missing.append((number, frame))
            made.key = key
        yield made

    def path_of(self, name: str) -> Path:
        return self.output.path_of(name) if self.output else self.folder / f"{name}{self.suffix}"

    def depth_path_of(self, name: str) -> Path:
        assert self.depth_maps is not None
        film = is_video(self.depth_maps)
        return self.hidden / "depth" / f"{name}.png" if film else self.depth_maps / f"{name}.npz"

    def is_missing(self, name: str) -> bool:
        missing = self.output.is_missing(name) if self.output else not self.path_of(name).exists()
        return missing or (self.depth_maps is not None and not self.depth_path_of(name).exists())

    def remove(self, names: list[str]) -> None:
        """Remove the results for frames that are all rendered again, so that none is kept if this
        is interrupted.
        """
        for name in names:
            paths = [] if self.output and self.output.raw else [self.path_of(name)]
            paths += [] if self.depth_maps is None else [self.depth_path_of(name)]
            for path in paths:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)

    @property
    def size(self) -> tuple[int, int] | None:
        """Columns and rows of the pictures, once the first frame has been analysed."""
        if self.views is not None and self.views.size is not None:
            return self.views.size
        if self.calibration is None or self.scale is None:
            return None
        return PictureGrid(
            self.calibration.image_size, self.calibration.lattice.pitch, self.scale
        ).size

    def failed(self, frame: Frame, error: LightFieldError) -> FrameResult:
        return FrameResult(frame.name, self.path_of(frame.name), "failed", f"{frame.name}: {error}")

    def _depth_file(self, name: str) -> Path:
        return self.hidden / f"depth_{name}.npz"

    def camera(self, pixels: Array) -> Calibration:
        """The camera of the run, calibrated from these pixels if there is none yet."""
        if self.calibration is None:
            self.calibration = self._as_stored(calibrate(pixels))
        return self.calibration

    def _as_stored(self, calibration: Calibration) -> Calibration:
        return (
            replace(calibration, encoded=True)
            if self.encoded and calibration.encoded is None
            else calibration
        )

    def read(self, frame: Frame) -> Array:
        """The flat of a frame, in colour if the camera has a colour mosaic."""
        pixels = frame.read()
        return demosaic(pixels, self.camera(pixels)) if pixels.ndim == 2 else pixels

    def _analyze_key(self, frame: Frame, earlier: Frame | None) -> None:
        """Write the depth map of a key frame, compared with that of an earlier segment, if any."""
        flat = self.read(frame)
        file = self._depth_file(frame.name)
        if not file.exists():
            depth = self._analyze(flat, None if earlier is None else self._key(earlier))
            if not self._settings_file.exists():
                self._save_settings(flat, depth)
            depth.save(file)
        self._remember(_Reference(frame.name, flat, self._load_depth(frame)))

    def _analyze(self, flat: Array, before: _Reference | None) -> DepthMap:
        previous = None if before is None else (before.flat, before.depth)
        return analyze(flat, self.camera(flat), self.preset, previous=previous)

    def _draw(self, flat: Array, depth: DepthMap, before: _Reference | None) -> Rendering:
        if before is None or before.picture is None:
            return render(flat, self.camera(flat), depth, scale=self.scale)
        return render(
            flat, self.camera(flat), depth, previous=(before.flat, before.depth, before.picture)
        )

    def _remember(self, key: _Reference) -> _Reference:
        with _LOCK:
            self._keys = {**dict(list(self._keys.items())[-1:]), key.name: key}
        return key

    def _key(self, frame: Frame) -> _Reference:
        with _LOCK:
            found = self._keys.get(frame.name)
            return found or self._remember(
                _Reference(frame.name, self.read(frame), self._load_depth(frame))
            )

    def _load_depth(self, frame: Frame) -> DepthMap:
        """A depth map from its file: other workers and later runs have no more than what is in it."""
        file = self._depth_file(frame.name)
        if not file.exists():
            raise OutputError(
                f"{self.folder}: a file of one worker is not seen by another; give a shared folder"
            )
        try:
            return DepthMap.load(file)
        except DepthFileError as error:
            what = "left by another version, or damaged; render everything again (--overwrite)"
            raise OutputError(f"{file}: {what}") from error

    def _save_settings(self, flat: Array, depth: DepthMap) -> None:
        camera = self.camera(flat)
        if self.exposure is not None:
            self.gain = exposure_gain(flat, camera.white_level, self.exposure)
        self.scale = default_scale(depth) if self.scale is None else self.scale
        self.still, self.colours = still_depth(depth), magnification_limits(depth.magnification)
        settings = {
            **self._settings(),
            "scale": self.scale,
            "still": self.still,
            "colours": self.colours,
        }
        settings["gain"] = self.gain
        camera.save(self.hidden / "camera.json")
        # As a continued run will have it.
        self.calibration = load_camera(self.folder)
        with atomic_write(self._settings_file) as temporary:
            temporary.write_text(json.dumps(settings), encoding="utf-8")

    def _shown(self, picture: Rendering) -> Rendering:
        """A picture as it is written."""
        shown: Rendering = Brightness(None, self.gain).apply(picture)
        return eight_bits(shown) if self.eight_bits else shown

    def first_of_group(self, frame: Frame, flat: Array | None, key: Frame) -> _Reference:
        """The first frame of a group with flat, depth and picture; it may be the key frame of its
        segment itself.
        """
        before = self._key(key)
        with _LOCK:
            if before.picture is None and self.output is None:
                before.picture = self._draw(before.flat, before.depth, None)
        if frame.name == before.name:
            return before
        flat = self.read(frame) if flat is None else flat
        if not self._depth_file(frame.name).exists():
            self._analyze(flat, before).save(self._depth_file(frame.name))
        depth = self._load_depth(frame)
        return _Reference(
            frame.name, flat, depth, None if self.output else self._draw(flat, depth, before)
        )

    def render_frame(
        self, number: int, frame: Frame, flat: Array, first: _Reference
    ) -> FrameResult:
        """Analyse, draw and write one frame, with its pixels in colour, after the `first` of its
        group.
        """
        start = perf_counter()
        path = self.path_of(frame.name)
        own = first.name == frame.name
        depth = first.depth if own else self._analyze(flat, first)
        if self.depth_maps is not None and is_video(self.depth_maps):
            write_picture(
                self.depth_path_of(frame.name), depth_picture(depth, self.scale, self.colours)
            )
        elif self.depth_maps is not None:
            depth.save(self.depth_path_of(frame.name))
        if self.output is not None:
            assert self.views is not None and self.still is not None
            pictures = self.views.draw(flat, self.camera(flat), depth, self.scale, self.still)
            self.output.write(number, frame.name, map(self._shown, pictures))
        else:
            picture = first.picture if own and first.picture else self._draw(flat, depth, first)
            settings: dict[str, Any] = {"rendering": "all in focus", "preset": self.preset}
            embedded = EmbeddedMetadata() if frame.source is None else read_metadata(frame.source)
            settings |= {} if self.gain == 1 else {"exposure_gain": self.gain}
            write_picture(
                path, self._shown(picture), settings=settings, embedded=embedded, exposure=0.0
            )
        return FrameResult(
            frame.name,
            path,
            "rendered",
            "",
            perf_counter() - start,
            float(depth.saved.get("still", 0)),
        )


def render_group(job: Job, group: Group, _loaded: object) -> list[FrameResult]:
    """The outcomes of a group in the order of its frames, the missing ones rendered."""
    outcomes = list(group.outcomes)
    first = None
    for number, frame in group.missing:
        if job.stopped:
            break
        try:
            flat = job.read(frame)
            if first is None:
                assert group.key is not None
                given = group.first or frame
                first = job.first_of_group(
                    given, flat if given.name == frame.name else None, group.key
                )
            result = job.render_frame(number, frame, flat, first)
        except OutputError:
            raise
        except LightFieldError as error:
            result = job.failed(frame, error)
        outcomes[outcomes.index(None)] = result
    return [outcome for outcome in outcomes if outcome is not None]
