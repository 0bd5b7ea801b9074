"""A live session: depth and pictures of the newest frame, as far as they are watched.

Depth and the sharp picture are updated from a reference frame where nothing has moved. While a
recording runs, they are made of each frame alone, so that they have the bits of those that are
rendered from the recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from threading import Condition, Event, Lock, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError, OutputError, assess
from lfcal.runtime.arrays import white_of
from lfcal.runtime.light.tone import Exposure

from ..data.depth_map import DepthMap, default_scale
from ..data.depth_order import slider_limits
from ..data.rendering import Rendering
from ..depth.analyze import analyze
from ..flat.demosaicing import demosaic
from ..flat.lens_graph import nearest_lens
from ..output.depth_picture import depth_picture
from ..output.finish import Finish, flat_picture
from ..rendering.refocus import refocus
from ..rendering.render import render
from ..rendering.traditional import find_depth_problem, traditional
from ..runtime.choices import Preset
from ..runtime.messages import one_line
from .grabber import Grabber
from .recording import Recorder
from .sources import Shot

__all__ = ["COMMANDS", "KINDS", "Session", "View"]

#: What `Session.command` does.
COMMANDS = ("record", "stop", "snapshot", "calibrate")
#: Pictures of a frame.
KINDS = ("raw", "traditional", "sharp", "focus", "depth")
# [s] A kind of picture that no page has asked for during this time is not made.
_WATCHED = 5.0
# A frame becomes the next reference if less than this share of its lenses is still.
_STILL = 0.9
# Number of references in a row before depth is analysed anew: changes smaller than the noise would
# add up.
_CHAIN = 30
# Rows and columns of a frame from which its histogram is made, and levels of it.
_SAMPLES = 500
_LEVELS = 32
# Format whose brightness and tone are those of the page.
_SHOWN = "frame.jpg"
# Of the JPEG files that pages get.
_QUALITY = 90
# [s] The thread looks so often whether it is to end.
_PATIENCE = 0.2
# Output pixels per pitch of the depth picture, which browsers enlarge: more would take longer than
# the depth itself.
_DEPTH_SCALE = 4.0


#: A place in a picture, as shares of its width and height.
Place = tuple[float, float]
#: What is in focus: a place, or a patch size [px].
Focus = Place | float


@dataclass
class View:
    """One frame and what is known of it."""

    shot: Shot
    flat: NDArray[Any]  # in colour where the camera has a mosaic
    camera: Calibration | None = None
    depth: DepthMap | None = None
    sharp: Rendering | None = None
    finish: Finish = field(default_factory=lambda: Finish(_SHOWN))  # of what is shown
    jpegs: dict[str, tuple[Focus, bytes]] = field(default_factory=dict)

    @cached_property
    def light(self) -> dict[str, Any]:
        """What the raw frame tells about exposure and focus.

        Its pixels over equal levels up to white, the share of those at white, and the sharpness of
        the middle third: standard deviation of its Laplacian over its mean, largest in focus.
        """
        import cv2

        pixels = self.shot.pixels
        top = white_of(pixels, self.white)
        height, width = pixels.shape[:2]
        middle = np.s_[height // 3 : height - height // 3, width // 3 : width - width // 3]
        grey = np.atleast_3d(pixels[middle]).mean(2, dtype=np.float32)
        few = pixels[:: max(1, height // _SAMPLES), :: max(1, width // _SAMPLES)]
        sharpness = cv2.Laplacian(grey, cv2.CV_32F).std() / max(float(grey.mean()), 1e-9)
        return {
            "histogram": np.histogram(few, _LEVELS, (0, top))[0].tolist(),
            "clipped": float((few >= top).mean()),
            "sharpness": float(sharpness),
        }

    @property
    def white(self) -> float | None:
        """The white level that the source tells, or the camera."""
        if self.shot.white is None and self.camera is not None:
            return self.camera.white_level
        return self.shot.white

    def has(self, kind: str) -> bool:
        """Whether the picture can be drawn; without a camera all are the raw frame."""
        needed = {"sharp": self.sharp, "focus": self.depth, "depth": self.depth}.get(
            kind, self.camera
        )
        return self.camera is None or needed is not None

    @property
    def knows_depth(self) -> bool:
        """Whether `patch_size` and `depth_at` have an answer."""
        return self.camera is not None and self.depth is not None

    def patch_size(self, focus: Focus) -> float:
        """The patch size in focus [px]."""
        if isinstance(focus, float):
            return focus
        return float(self.depth_at(focus)["patch_size"])

    def depth_at(self, place: Place) -> dict[str, Any]:
        """Depth at a place: patch size [px], confidence, and distance [m] if the optics are known.

        Confidence is 0 where the lens has no depth of its own.
        """
        assert self.camera is not None and self.depth is not None
        depth = self.depth
        point = (np.array(place) * self.camera.image_size - 0.5)[None]
        size = float(depth.surface.at(point)[0])
        lens = nearest_lens(self.camera.lattice.centres(), point)[0]
        distance = None
        if self.camera.optics is not None:
            ahead = float(self.camera.optics.distance(np.array([size / depth.pitch]), point)[0])
            distance = ahead if np.isfinite(ahead) else None
        confidence = 0.0 if depth.filled[lens] else float(np.nan_to_num(depth.confidence[lens]))
        return {"patch_size": size, "confidence": confidence, "distance": distance}

    def draw(self, kind: str, focus: Focus = (0.5, 0.5)) -> NDArray[Any]:
        """The picture with 8 bits."""
        if self.camera is None or kind == "raw":
            picture = self.raw
        elif kind == "traditional":
            picture = traditional(self.flat, self.camera)
        elif kind == "depth":
            assert self.depth is not None
            return np.asarray(depth_picture(self.depth, _DEPTH_SCALE))
        elif kind == "focus":
            assert self.depth is not None
            # Blur by depth, for which refocus takes the depth map, takes too long here.
            scale = default_scale(self.depth)
            size = self.patch_size(focus)
            picture = refocus(self.flat, self.camera, size, scale=scale)
        else:
            assert self.sharp is not None
            picture = self.sharp
        return self.finish.apply(picture).image

    @property
    def raw(self) -> Rendering:
        """The raw frame."""
        encoded = self.shot.encoded
        if encoded is None and self.camera is not None:
            encoded = self.camera.encoded
        pixels = self.shot.pixels
        whole = np.ones((1, 1), bool)
        return Rendering(pixels, np.eye(2, 3), whole, 1.0, self.white, encoded=encoded)

    def jpeg(self, kind: str, focus: Focus = (0.5, 0.5)) -> bytes:
        """The same as a JPEG file; drawn once for all who ask, but for what is in focus."""
        import cv2

        made_for, content = self.jpegs.get(kind, (None, b""))
        if made_for is None or (kind == "focus" and made_for != focus):
            pixels = self.draw(kind, focus)
            if pixels.ndim == 3:
                pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
            _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            content = data.tobytes()
            self.jpegs[kind] = focus, content
        return content


def _in_colour(shot: Shot, camera: Calibration) -> NDArray[Any]:
    """The pixels of a frame, in colour where the camera has a mosaic.

    Recorded frames get the colours that commands would give them; others, of 8 bits, in a tenth of
    that time by variable number of gradients (Chang et al. 1999), which also mixes pixels of
    neighbouring microimages: on Fujita2 pictures are 40.2 dB from those of the true colours, and
    not 42.9.
    """
    import cv2

    if (
        shot.recorded
        or shot.pixels.ndim == 3
        or camera.mosaic is None
        or shot.pixels.dtype != np.uint8
    ):
        return demosaic(shot.pixels, camera)
    return cv2.demosaicing(shot.pixels, getattr(cv2, f"COLOR_Bayer{camera.mosaic}2RGB_VNG"))


def _planes(depth: DepthMap, before: dict[str, float] | None) -> dict[str, float]:
    """Ends of the slider of planes, which grow with the scene, and the pitch [px]."""
    far, near = (depth.pitch * end for end in slider_limits(depth))
    if before is not None:
        far, near = min(far, before["far"]), max(near, before["near"])
    return {"far": far, "near": near, "pitch": depth.pitch}


class Session:
    """Analyses and draws the newest frame of a source again and again, in a thread of its own.

    Only what somebody looks at is analysed; frames are recorded without that.
    `find_camera` gives the camera of a frame, measured on it unless it is `given`; where it fails,
    the raw frames are shown and it is tried again. Dim linear frames are shown brighter, by one gain
    until the next calibration, or all by so many EV (`exposure`). Recordings and snapshots go into
    `folder`, with the pixels of the source; `correct` gives those that are analysed and drawn, such
    as less a dark frame.
    """

    def __init__(
        self,
        grabber: Grabber,
        find_camera: Callable[[Shot], Calibration],
        preset: Preset,
        folder: Path,
        given: bool = False,
        exposure: Exposure | None = None,
        correct: Callable[[NDArray[Any]], NDArray[Any]] = np.asarray,
    ) -> None:
        self.grabber, self.preset, self.folder = grabber, preset, folder
        self.camera: Calibration | None = None
        self.view: View | None = None
        self.shot: Shot | None = None  # the newest one, whether it was analysed or not
        self.latency, self.still, self.message, self.saved = 0.0, 0.0, "", ""
        self.scale: float | None = None
        #: Ends of the slider of planes and the pitch, once a depth is known [px].
        self.planes: dict[str, float] | None = None
        self._exposure = exposure
        self._finish = Finish(_SHOWN, exposure=exposure)
        self._correct = correct
        self.findings: list[str] = []  # how the array is mounted
        self._find_camera, self._given, self._tried = find_camera, given, 0.0
        self._wanted: dict[str, float] = {}
        self._reference: tuple[View, Calibration] | None = None
        self._chain = 0
        self._published, self._stopped = Condition(), Event()
        self._recording, self._drawing = Lock(), Lock()
        self._thread = Thread(target=self._run, daemon=True)
        grabber.is_idle = lambda: not self._watched(*KINDS)

    def start(self, strict: bool = False) -> None:
        """Find the camera on the first frame, and begin; `strict` raises an error of that."""
        try:
            self._calibrate(self.grabber.first)
        except LightFieldError as error:
            if strict:
                raise
            self.message = str(error)
        self._thread.start()

    def picture(
        self, kind: str, after: int, focus: Focus = (0.5, 0.5), timeout: float = 5.0
    ) -> tuple[View, bytes] | None:
        """The JPEG of a frame later than number `after`; None if there is none in time."""
        end = time.monotonic() + timeout
        with self._published:
            while not self._stopped.is_set():
                self._wanted[kind] = time.monotonic()
                if (view := self.view) is not None and view.shot.number > after and view.has(kind):
                    break
                if (left := end - time.monotonic()) <= 0:
                    return None
                self._published.wait(min(left, 1.0))
            else:
                return None
        with self._drawing:
            data = view.jpeg(kind, focus)
        self.latency = time.monotonic() - view.shot.arrived
        return view, data

    @property
    def about(self) -> str:
        """The camera in words."""
        if (camera := self.camera) is None:
            return "no microlens array yet"
        return f"{len(camera.lattice):,} microlenses, {camera.lattice.pitch:.2f} px apart"

    def status(self) -> dict[str, Any]:
        """Counts of frames, latency [s], light, camera and messages, as the page shows them."""
        grabber = self.grabber
        recorder = self.grabber.recorder
        camera = self.camera
        return {
            "received": grabber.received,
            "lost": grabber.lost,
            "latency": self.latency,
            "still": self.still,
            "camera": "\n".join([self.about, *(camera.warnings if camera else ()), *self.findings]),
            "planes": self.planes,
            "saved": self.saved,
            "recording": recorder and recorder.told,
            "message": grabber.message or (recorder and recorder.message) or self.message,
            **(self.view.light if self.view else {}),
        }

    def command(self, name: str) -> None:
        """Do `record`, `stop`, `snapshot` or `calibrate`; OutputError if writing fails."""
        with self._recording:
            if name == "record" and self.grabber.recorder is None:
                self.grabber.recorder = self._open_recorder("recording")
            elif name == "stop" and self.grabber.recorder is not None:
                recorder, self.grabber.recorder = self.grabber.recorder, None
                recorder.close()
                self.saved = "no frame came: nothing was recorded"
                if recorder.frames:
                    self.saved = recorder.told
            elif name == "snapshot" and (shown := self._shown()) is not None:
                recorder = self._open_recorder("snapshot")
                recorder.add(shown)
                recorder.close()
                if recorder.message:
                    raise OutputError(recorder.message)
                self.saved = str(recorder.path)
            elif name == "calibrate" and self.grabber.recorder is None:
                self.camera, self.scale, self.planes = None, None, None
                self.findings, self._tried = [], 0.0

    def close(self) -> None:
        """Stop, and close what is being recorded and the source."""
        self._stopped.set()
        self.command("stop")
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        # The picture that is being drawn ends and no other begins: a process that ends while a
        # thread is in a kernel is aborted.
        self._drawing.acquire(timeout=5)
        self.grabber.close()

    def _open_recorder(self, name: str) -> Recorder:
        camera = self.camera and self.camera.to_dict()
        path = self.folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}.tif"
        return Recorder(path, {"camera": camera, "preset": self.preset, "scale": self.scale})

    def _watched(self, *kinds: str) -> bool:
        return any(
            time.monotonic() - self._wanted.get(kind, -_WATCHED) < _WATCHED for kind in kinds
        )

    def _shown(self) -> Shot | None:
        """The frame that pages show, or the newest one if nobody looks at a page."""
        if self.view is not None and self._watched(*KINDS):
            return self.view.shot
        return self.shot

    def _is_drawn(self, shot: Shot) -> bool:
        """Whether all pictures of a frame are there that pages ask for."""
        wanted = list(filter(self._watched, KINDS))
        view = self.view
        if view is None or view.shot is not shot:
            return not wanted
        return all(map(view.has, wanted))

    def _run(self) -> None:
        while not self._stopped.is_set():
            self.shot = shot = self.grabber.take(_PATIENCE) or self.shot
            if shot is None or self._is_drawn(shot):
                continue
            view = View(shot, shot.pixels)
            try:
                view.finish = self._finish = self._finish.measured(view.raw)
                self.message = self._analyze(view)
            # An error of one frame, such as its size, is shown, and the next frame is tried.
            except Exception as error:
                self.message = one_line(error)
                view.camera = None
            with self._published:
                self.view = view
                self._published.notify_all()

    def _corrected(self, shot: Shot) -> Shot:
        return replace(shot, pixels=self._correct(shot.pixels))

    def _calibrate(self, raw: Shot) -> Calibration:
        """Camera and assessment of a frame."""
        shot = self._corrected(raw)
        try:
            # As recordings hold it: in files, gain is rounded.
            self.camera = camera = Calibration.from_dict(self._find_camera(shot).to_dict())
        finally:
            self._tried = time.monotonic()
        known = camera
        if shot.white is not None:
            known = replace(camera, white_level=shot.white)
        shown = flat_picture(_in_colour(shot, known), known)
        self._finish = Finish(_SHOWN, self._exposure).measured(shown)
        # A camera that is given tells nothing but the rotation: this frame need not be its white
        # image.
        if self._given:
            camera = replace(camera, source="scene")
        found = assess(shot.pixels, calibration=camera, white_level=shot.white).findings
        self.findings = [
            f"{name}: {finding}" for name, finding in found.items() if finding.measured
        ]
        return self.camera

    def _analyze(self, view: View) -> str:
        """Find the camera, depth and pictures that somebody watches; return a message."""
        camera = self.camera
        message = ""
        if camera is None:
            # A recording has one camera or none.
            if view.shot.recorded or time.monotonic() - self._tried < 2:
                return self.message
            camera = self._calibrate(view.shot)
        view.flat = _in_colour(self._corrected(view.shot), camera)
        if self._watched("sharp", "focus", "depth"):
            before = self._comparable(view, camera)
            earlier = None if before is None else (before.flat, before.depth)
            options: dict[str, Any] = {"previous": earlier, "check": False}
            view.depth = depth = analyze(view.flat, camera, self.preset, **options)
            self.still = float(depth.saved.get("still", 0.0)) if before else 0.0
            message = find_depth_problem(depth) or ""
            if not message:
                self.planes = _planes(depth, self.planes)
            if self.scale is None and not message and not view.shot.recorded:
                self.scale = default_scale(depth)
            if self._watched("sharp"):
                drawn: Any = {"scale": self.scale}
                if before is not None and before.sharp is not None:
                    drawn = {"previous": (before.flat, before.depth, before.sharp)}
                view.sharp = render(view.flat, camera, depth, **drawn)
            # A picture of no scene has another scale than those that follow.
            if self.scale is not None and (
                before is None or self.still < _STILL or (view.sharp and not before.sharp)
            ):
                self._chain = 0 if before is None else self._chain + 1
                self._reference = view, camera
        view.camera = camera
        return message

    def _comparable(self, view: View, camera: Calibration) -> View | None:
        """The frame that this one is compared with, or None."""
        if view.shot.recorded or self._reference is None or self._chain >= _CHAIN:
            return None
        before, of = self._reference
        alike = before.flat.shape == view.flat.shape and before.flat.dtype == view.flat.dtype
        return before if of is camera and alike else None
