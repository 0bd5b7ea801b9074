"""One run over a sequence: analysis and picture of each frame, in segments and groups.

The sequence is divided into segments, and these into groups. Depth is updated incrementally, so
that static parts keep one depth from picture to picture: the first frame of a segment, its key
frame, is compared with the key frame of the segment before; the first frame of any other group with
the key frame of its segment; all others with the first of their group. A run that was interrupted,
or spread over many machines, therefore makes the same pictures as any other.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any, Literal

from lfcal import Calibration, FlatError, LightFieldError, OutputError, calibrate
from lfcal.runtime.arrays import Array
from lfcal.runtime.errors import check_type

from ..data.depth_file import DepthFileError
from ..data.depth_map import DepthMap, default_scale
from ..data.depth_order import depth_limits
from ..data.rendering import PictureGrid, Rendering
from ..depth.analyze import analyze
from ..flat.demosaicing import demosaic
from ..output.depth_picture import depth_picture
from ..output.finish import Finish, flat_picture
from ..output.formats import EmbeddedMetadata, read_metadata
from ..output.picture import encoded_by, write_finished, write_picture
from ..output.views import resize_view, scale_for_size
from ..rendering.render import render
from ..rendering.viewpoints import still_depth
from ..runtime.types import Size
from .frames import Frame, Frames, read_lit
from .options import FrameOptions
from .run_folder import RunFolder, RunState

__all__ = ["FrameResult", "Group", "Run", "render_group"]


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
    outcome: Literal["rendered", "kept", "failed"]  # kept: the picture was there already
    message: str = ""  # why it failed
    seconds: float = 0.0  # from the pixels to the picture
    still: float = 0.0  # share of the lenses that kept the depth of an earlier frame


@dataclass
class Group:
    """Neighbouring frames that one worker renders."""

    # The outcome of each frame, or number and frame where it is still to be rendered.
    items: list[FrameResult | tuple[int, Frame]] = field(default_factory=list)
    first: Frame | None = None  # all are compared with it; None for the first to be rendered
    key: Frame | None = None  # of their segment; None if nothing is to be rendered


@dataclass
class _Reference:
    """A frame that others are compared with."""

    name: str
    flat: Array
    depth: DepthMap
    picture: Rendering | None = None


class _KeyFrames:
    """The last two key frames, since groups of two segments may be rendered at once.

    A copy in another process starts empty.
    """

    def __init__(self) -> None:
        self.lock = RLock()
        self.kept: dict[str, _Reference] = {}

    def __reduce__(self) -> tuple[type, tuple[()]]:
        return _KeyFrames, ()

    def keep(self, key: _Reference) -> _Reference:
        with self.lock:
            latest = list(self.kept.items())[-1:]
            self.kept = {**dict(latest), key.name: key}
        return key


class Run:
    """Analyses, draws and writes the frames of one sequence."""

    def __init__(
        self,
        folder: RunFolder,
        options: FrameOptions,
        camera: Calibration | None,
        frames: Frames,
    ) -> None:
        self.folder = folder
        self.options = options
        self._encoded = frames.encoded
        self.camera = camera and self._as_stored(camera)
        self.state: RunState | None = None
        self.stopped = False  # nobody takes the results of further frames
        self._keys = _KeyFrames()
        views = options.views and {**asdict(options.views), "format": options.suffix}
        settings = {
            "preset": options.preset,
            "eight_bits": options.eight_bits,
            "dark": frames.dark and str(frames.dark),
            "views": views,
            "exposure": options.exposure,
            "tone": options.tone,
            "white_balance": options.white_balance,
            "quality": options.quality,
            "size": options.size,
        }
        # As they are read from a file, so that they compare.
        self._settings: dict[str, Any] = json.loads(json.dumps(settings))
        found = folder.load_state(self._settings, options.scale, self.camera)
        if found is not None:
            self.state, self.camera = found

    @property
    def size(self) -> Size | None:
        """Columns and rows of the pictures, once the first frame has been analysed."""
        if self.options.size is not None:
            return self.options.size
        if self.camera is None or self.state is None:
            return None
        pitch = self.camera.lattice.pitch
        return PictureGrid(self.camera.image_size, pitch, self.state.scale).size

    def groups(self, frames: Iterable[Frame], overwrite: bool) -> Iterator[Group]:
        """The frames in groups, of which only the last may have nothing to be rendered.

        Key frames are analysed on the way.
        """
        earlier: Frame | None = None
        key: Frame | None = None
        group = Group()
        for number, frame in enumerate(frames):
            check_type(frame, Frame, "frames", "lfrender.open_frames finds them")
            place = number % self.options.segment
            if place == 0:
                earlier = key or earlier
                key = None
            if place % self.options.group == 0:
                if group.key is not None:
                    yield group
                    group = Group()
                group.first = None
            if not overwrite and not self.folder.is_missing(frame.name):
                key = key or frame
                group.first = group.first or frame
                group.items.append(self.result(frame, "kept"))
                continue
            try:
                if key is None or not self.folder.reference_path_of(key.name).exists():
                    self._analyze_key(key or frame, earlier)
                    key = key or frame
            except OutputError:
                raise
            except LightFieldError as error:
                group.items.append(self.failed(frame, error))
                continue
            group.items.append((number, frame))
            group.key = key
        yield group

    def result(self, frame: Frame, outcome: Any, **more: Any) -> FrameResult:
        return FrameResult(frame.name, self.folder.path_of(frame.name), outcome, **more)

    def failed(self, frame: Frame, error: LightFieldError) -> FrameResult:
        message = str(error)
        if frame.place not in message:
            message = f"{frame.place}: {message}"
        return self.result(frame, "failed", message=message)

    def read(self, frame: Frame) -> Array:
        """The flat of a frame, in colour if the camera has a colour mosaic."""
        pixels = read_lit(frame)
        camera = self._camera(pixels)
        size = pixels.shape[1::-1]
        if size != camera.image_size:
            own, common = ("{} x {}".format(*pair) for pair in (size, camera.image_size))
            raise FlatError(
                f"has {own} px, the frames of this run have {common}; leave this file out, or "
                "render it into a folder of its own"
            )
        return demosaic(pixels, camera)

    def _camera(self, pixels: Array) -> Calibration:
        """The camera of the run, calibrated from these pixels if there is none yet."""
        if self.camera is None:
            self.camera = self._as_stored(calibrate(pixels))
        return self.camera

    def _as_stored(self, camera: Calibration) -> Calibration:
        if self._encoded and camera.encoded is None:
            return replace(camera, encoded=True)
        return camera

    def _analyze_key(self, frame: Frame, earlier: Frame | None) -> None:
        """Write the depth map of a key frame, compared with an earlier one, if any."""
        flat = self.read(frame)
        file = self.folder.reference_path_of(frame.name)
        if not file.exists():
            depth = self._analyze(flat, None if earlier is None else self._key(earlier))
            if self.state is None:
                self._begin(flat, depth)
            depth.save(file)
        self._keys.keep(_Reference(frame.name, flat, self._load_depth(frame)))

    def _begin(self, flat: Array, depth: DepthMap) -> None:
        """Decide what all pictures have in common, and store it."""
        options = self.options
        camera = self._camera(flat)
        scale = scale_for_size(camera, options.size, options.scale) or default_scale(depth)
        finish = self._finish(None).measured(flat_picture(flat, camera))
        light = (finish.gain or 1.0, finish.balance)
        self.state = RunState(scale, still_depth(depth), depth_limits(depth), *light)
        self.camera = self.folder.save_state(self._settings, self.state, camera)

    def _analyze(self, flat: Array, before: _Reference | None) -> DepthMap:
        previous = None if before is None else (before.flat, before.depth)
        return analyze(
            flat, self._camera(flat), self.options.preset, previous=previous, check=False
        )

    def _draw(self, flat: Array, depth: DepthMap, before: _Reference | None = None) -> Rendering:
        camera = self._camera(flat)
        if before is None or before.picture is None:
            return render(flat, camera, depth, scale=self._known.scale)
        return render(flat, camera, depth, previous=(before.flat, before.depth, before.picture))

    @property
    def _known(self) -> RunState:
        assert self.state is not None
        return self.state

    def _key(self, frame: Frame) -> _Reference:
        with self._keys.lock:
            found = self._keys.kept.get(frame.name)
            if found is None:
                depth = self._load_depth(frame)
                found = self._keys.keep(_Reference(frame.name, self.read(frame), depth))
            return found

    def _load_depth(self, frame: Frame) -> DepthMap:
        """A depth map from its file: other workers and later runs have no more than the file."""
        file = self.folder.reference_path_of(frame.name)
        if not file.exists():
            problem = "a file of one worker is not seen by another; give a shared folder"
            raise OutputError(f"{self.folder.place}: {problem}")
        try:
            return DepthMap.load(file)
        except DepthFileError as error:
            problem = "of another version, or damaged; render everything again (--overwrite)"
            raise OutputError(f"{file}: {problem}") from error

    def first_of_group(self, frame: Frame, flat: Array | None, key: Frame) -> _Reference:
        """The first frame of a group with flat, depth and picture; it may be the key frame."""
        before = self._key(key)
        with_views = self.folder.views is not None
        with self._keys.lock:
            if before.picture is None and not with_views:
                before.picture = self._draw(before.flat, before.depth)
        if frame.name == before.name:
            return before
        if flat is None:
            flat = self.read(frame)
        file = self.folder.reference_path_of(frame.name)
        if not file.exists():
            self._analyze(flat, before).save(file)
        found = _Reference(frame.name, flat, self._load_depth(frame))
        if not with_views:
            found.picture = self._draw(flat, found.depth, before)
        return found

    def render_frame(
        self, number: int, frame: Frame, flat: Array, first: _Reference
    ) -> FrameResult:
        """Analyse, draw and write a frame, given its flat in colour and the first of a group."""
        start = perf_counter()
        state = self._known
        depth = first.depth
        picture = first.picture
        if first.name != frame.name:
            depth = self._analyze(flat, first)
            picture = None
        if self.folder.makes_depth_film:
            picture_of_depth = depth_picture(depth, state.scale, state.colours)
            write_picture(self.folder.depth_path_of(frame.name), picture_of_depth)
        elif self.folder.depth_maps is not None:
            depth.save(self.folder.depth_path_of(frame.name))
        if self.folder.views is not None:
            assert self.options.views is not None
            drawn = self.options.views.draw(
                flat, self._camera(flat), depth, state.scale, state.still
            )
            pictures = (resize_view(picture, self.options.size) for picture in drawn)
            self.folder.views.write(number, frame.name, pictures, self._finish(None))
        else:
            picture = resize_view(picture or self._draw(flat, depth, first), self.options.size)
            settings: dict[str, Any] = {"rendering": "all in focus", "preset": self.options.preset}
            embedded = EmbeddedMetadata()
            if frame.source:
                embedded = read_metadata(frame.source)
            path = self.folder.path_of(frame.name)
            finish = self._finish(encoded_by(embedded))
            write_finished(path, picture, finish, settings=settings, embedded=embedded)
        still = float(depth.saved.get("still", 0))
        return self.result(frame, "rendered", seconds=perf_counter() - start, still=still)

    def _finish(self, encoded: bool | None) -> Finish:
        """What is done to all pictures of the run, of which frames may tell whether they are encoded."""
        options = self.options
        suffix = options.shown_as or options.suffix
        if self.folder.views is not None and self.folder.views.raw:
            suffix = ".yuv"
        finish = Finish(
            f"picture{suffix}",
            options.exposure,
            options.tone,
            options.white_balance,
            options.eight_bits,
            options.quality,
            encoded,
        )
        if self.state is None:
            return finish
        red, green, blue = self.state.balance
        return replace(finish, gain=self.state.gain, balance=(red, green, blue))

    @property
    def sentences(self) -> list[str]:
        """What is done to all pictures, once the first frame has been analysed."""
        return self._finish(None).sentences()


def render_group(run: Run, group: Group, _loaded: object) -> list[FrameResult]:
    """The outcomes of a group in the order of its frames, after rendering the missing ones."""
    results = []
    first = None
    for item in group.items:
        if isinstance(item, FrameResult):
            results.append(item)
            continue
        if run.stopped:
            break
        number, frame = item
        try:
            flat = run.read(frame)
            if first is None:
                assert group.key is not None
                given = group.first or frame
                known = flat if given.name == frame.name else None
                first = run.first_of_group(given, known, group.key)
            results.append(run.render_frame(number, frame, flat, first))
        except OutputError:
            raise
        except LightFieldError as error:
            results.append(run.failed(frame, error))
    return results
