"""Reading a source in a thread: the newest frame is kept, lost frames are counted.

A slow reader never blocks the camera: a frame that is not taken before the next one arrives is
counted as lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Condition, Event, Thread

from lfcal import LightFieldError

from ..runtime.messages import one_line
from .recording import Recorder
from .sources import Shot

__all__ = ["Grabber"]

# Time between attempts to open a source that is gone [s].
_AGAIN = 1.0
# Time between looks whether frames of files are wanted again [s].
_PAUSE = 0.1


class Grabber:
    """Reads frames in a thread; an error of the first is raised, later ones are a message."""

    def __init__(self, open_source: Callable[[], Iterator[Shot]]) -> None:
        self.received = self.lost = 0
        self.message = ""
        #: Gets every frame while it is set.
        self.recorder: Recorder | None = None
        #: Whether nobody looks at frames. Files are not read then; a camera would fall behind.
        self.is_idle: Callable[[], bool] = bool
        self._open, self._frames = open_source, open_source()
        self._changed, self._stopped = Condition(), Event()
        self._newest: Shot | None = None
        #: The first frame.
        self.first = self._put(next(self._frames))
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def take(self, timeout: float) -> Shot | None:
        """The newest frame that was not taken yet; None if there is none within `timeout` [s]."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None, timeout)
            shot, self._newest = self._newest, None
            return shot

    def close(self) -> None:
        """Give the source back."""
        self._stopped.set()
        self._thread.join(timeout=2)

    def _put(self, shot: Shot) -> Shot:
        with self._changed:
            self.lost += shot.lost + (self._newest is not None)
            self.received += 1 + shot.lost
            recorder = self.recorder
            shot = replace(
                shot,
                number=self.received,
                arrived=time.monotonic(),
                time=time.time(),
                recorded=recorder is not None,
            )
            self._newest, self.message = shot, ""
            self._changed.notify_all()
        if recorder is not None:
            recorder.add(shot)
        return shot

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                for shot in self._frames:
                    self._put(shot)
                    while shot.waits and self.recorder is None and self.is_idle():
                        if self._stopped.wait(_PAUSE):
                            break
                    if self._stopped.is_set():
                        break
            # Drivers raise errors of any kind when a camera is pulled out.
            except Exception as error:
                text = one_line(error)
                if not isinstance(error, LightFieldError):
                    text = f"the camera fails: {text}"
                self.message = text
                self._stopped.wait(_AGAIN)
                self._frames = self._open()
        self._frames.close()  # type: ignore[attr-defined]
