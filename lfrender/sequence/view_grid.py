"""Views of a grid for each frame, in the files that other lenslet converters write.

Raw video (TLCT): a file for each view, `v000-1920x1080.yuv` and so on, into which frames are
written at their place, so that several of them can be worked on at once and an interrupted run goes
on. Pictures (RLC): a folder for each frame, `FRAME/image_001.png` and so on. Views are numbered row
by row from the top left.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfcal import Calibration, OutputError
from lfcal.runtime.arrays import Array

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..output.finish import Finish
from ..output.formats import check_format
from ..output.picture import write_finished
from ..output.raw_video import check_raw_format, frame_bytes, view_name, yuv_frame
from ..rendering.viewpoints import grid_offsets, views

__all__ = ["ViewGrid", "ViewOutput"]

_VIDEOS = "v[0-9][0-9][0-9]-*x*.yuv"


@dataclass(frozen=True)
class ViewGrid:
    """A grid of viewpoints.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     frames, grid = lfrender.open_frames([folder]), ViewGrid(1, 2)
    ...     options = {"preset": "fast", "views": grid}
    ...     done = list(lfrender.render_frames(frames, f"{folder}/out", camera, **options))
    >>> grid.count
    2
    """

    rows: int = 5
    columns: int = 5
    aperture: float = 0.7  # distance of the corners from the middle [radius of a microimage]

    @property
    def count(self) -> int:
        """Number of views."""
        return self.rows * self.columns

    def draw(
        self,
        flat: Array,
        calibration: Calibration,
        depth: DepthMap,
        scale: float | None,
        still: float,
    ) -> Iterator[Rendering]:
        """The views of a frame, row by row."""
        offsets = grid_offsets(self.rows, self.columns, self.aperture * calibration.lattice.radius)
        return views(flat, calibration, depth, offsets=offsets, scale=scale, still=still)


class ViewOutput:
    """The files of views; `suffix` is one of pictures, or the pixel format of raw video."""

    def __init__(self, folder: Path, hidden: Path, suffix: str, quality: int | None = None) -> None:
        self.folder = folder
        self.suffix = suffix
        self._parts = hidden / "views"  # unfinished files
        kind = suffix.lstrip(".")
        #: Pixel format of raw video, empty for pictures.
        self.raw = (
            check_raw_format(folder, kind, quality) if kind.startswith(("yuv", "gra")) else ""
        )
        if not self.raw:
            check_format(folder / f"image{suffix}", "picture", quality=quality)

    def path_of(self, name: str) -> Path:
        """The folder of the views of a frame, or of the files of raw video."""
        if self.raw:
            return self.folder
        return self.folder / name

    def is_missing(self, name: str) -> bool:
        """Whether the views of a frame have to be written."""
        made = self._mark(name) if self.raw else self.path_of(name)
        return not made.exists()

    def start(self, overwrite: bool, names: list[str]) -> None:
        """Make the hidden folder; OutputError if it belongs to frames with other names."""
        if overwrite:
            shutil.rmtree(self._parts, ignore_errors=True)
            for file in self._raw_files(self.folder):
                file.unlink()
        self._parts.mkdir(exist_ok=True)
        places = {name: f"{number}" for number, name in enumerate(names)}
        for mark in self._parts.glob("*.done"):
            if names and places.get(mark.stem) != mark.read_text(encoding="utf-8").strip():
                remedy = "give another folder, or render everything again (--overwrite)"
                raise OutputError(f"{self.folder}: holds the frames of another sequence; {remedy}")

    def write(self, number: int, name: str, pictures: Iterator[Rendering], finish: Finish) -> None:
        """Write the views of a frame after `finish`."""
        if self.raw:
            self._write_raw(number, name, map(finish.apply, pictures))
            return
        unfinished = self._parts / name
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        for view, picture in enumerate(pictures):
            path = unfinished / f"image_{view + 1:03d}{self.suffix}"
            write_finished(path, picture, finish, settings={"rendering": "views", "view": view})
        shutil.rmtree(self.folder / name, ignore_errors=True)
        os.replace(unfinished, self.folder / name)

    def _write_raw(self, number: int, name: str, pictures: Iterator[Rendering]) -> None:
        for view, picture in enumerate(pictures):
            frame = yuv_frame(picture.image, self.raw)
            data = frame_bytes(frame)
            path = self._parts / view_name(view, frame.width, frame.height)
            finished = self.folder / path.name
            if not path.exists() and finished.exists():
                os.replace(finished, path)
            # Frames are worked on at once: the file is not truncated.
            path.touch()
            with path.open("r+b") as stream:
                stream.seek(number * len(data))
                stream.write(data)
        self._mark(name).write_text(f"{number}\n", encoding="utf-8")

    def finish(self, names: list[str]) -> None:
        """Move the files of raw video into place.

        A frame that failed shows the frame before it, or the first one of all.
        """
        unfinished = self._raw_files(self._parts)
        numbers = {name: number for number, name in enumerate(names)}
        good = [number for name, number in numbers.items() if self._mark(name).exists()]
        if not (unfinished and good):
            return
        for path in unfinished:
            width, height = (int(n) for n in path.stem.partition("-")[2].split("x"))
            size = len(frame_bytes(yuv_frame(np.zeros((height, width), np.uint8), self.raw)))
            with path.open("r+b") as stream:
                for number in set(numbers.values()) - set(good):
                    stream.seek(max((n for n in good if n < number), default=good[0]) * size)
                    data = stream.read(size)
                    stream.seek(number * size)
                    stream.write(data)
            os.replace(path, self.folder / path.name)

    def _raw_files(self, folder: Path) -> list[Path]:
        """The files of raw video in a folder; none if pictures are written."""
        return sorted(folder.glob(_VIDEOS)) * bool(self.raw)

    def _mark(self, name: str) -> Path:
        """The file that marks the views of a frame as written; it holds the frame number."""
        return self._parts / f"{name}.done"
