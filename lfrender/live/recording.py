"""Recordings: one TIFF with raw frames, their times, the camera and the settings.

Page by page the pixels are as the source gave them. The description of each page is a JSON text
with the number and the times of the frame; that of the first one holds the camera and the settings
too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

from lfcal import Calibration, OutputError
from lfcal.runtime.image_formats import TIFF_SUFFIXES

from ..output.formats import EmbeddedMetadata, tiff_tags
from ..runtime.choices import Preset
from .sources import Shot

__all__ = ["Recorder", "Recording", "read_recording"]

# Frames that wait for the disk take no more bytes than these.
_WAITING = 1 << 28


@dataclass(frozen=True)
class Recording:
    """What a recording holds beside its frames."""

    camera: Calibration | None
    preset: Preset
    scale: float | None


def read_recording(path: str | os.PathLike[str]) -> Recording | None:
    """Camera and settings of a recording; None for other files."""
    if Path(path).suffix.lower() not in TIFF_SUFFIXES or not Path(path).is_file():
        return None
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            about = json.loads(tiff.pages.first.description)["recording"]
    # Of other files; reading the pixels will report what is wrong with damaged ones.
    except Exception:
        return None
    camera = None if about["camera"] is None else Calibration.from_dict(about["camera"])
    return Recording(camera, about["preset"], about["scale"])


class Recorder:
    """Writes frames into a new file in a thread; `about` is stored with the first frame."""

    def __init__(self, path: Path, about: Mapping[str, Any]) -> None:
        import tifffile

        self.path, self.frames, self.skipped, self.message = path, 0, 0, ""
        self._about: Mapping[str, Any] | None = about
        self._queue: Queue[Shot | None] = Queue()
        try:
            path.open("xb").close()
            self._file = tifffile.TiffWriter(path, bigtiff=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
        self._thread = Thread(target=self._run)
        self._thread.start()

    def add(self, shot: Shot) -> None:
        """Write a frame soon; if the disk is too slow, or full, the frame is skipped."""
        if self.message or self._queue.qsize() * shot.pixels.nbytes > _WAITING:
            self.skipped += 1
        else:
            self._queue.put(shot)

    @property
    def told(self) -> str:
        """The file, and how many frames are in it and were skipped."""
        told = f"{self.path}: {self.frames} frames"
        if self.skipped:
            told += f", {self.skipped} skipped"
        return told

    def close(self) -> None:
        """Write what waits, and close the file; one without frames is removed."""
        self._queue.put(None)
        self._thread.join()
        if not self.frames:
            self.path.unlink(missing_ok=True)

    def _run(self) -> None:
        with self._file:
            while (shot := self._queue.get()) is not None:
                try:
                    self._write(shot)
                except OSError as error:
                    self.skipped += 1
                    self.message = (
                        f"{self.path}: recording has ended "
                        f"({error.strerror or 'is the disk full?'})"
                    )

    def _write(self, shot: Shot) -> None:
        if self.message:
            self.skipped += 1
            return
        when = datetime.fromtimestamp(shot.time, UTC).isoformat(timespec="microseconds")
        text: dict[str, Any] = {
            "software": "lfrender",
            "frame": shot.number,
            "time": when,
            "camera_clock_ns": shot.ticks,
        }
        if self._about is not None:
            text["recording"] = self._about
        known = EmbeddedMetadata(encoded=shot.encoded)
        tags = tiff_tags(shot.pixels.shape, json.dumps(text), known)
        self._file.write(shot.pixels, contiguous=False, **tags)
        self._about = None
        self.frames += 1
