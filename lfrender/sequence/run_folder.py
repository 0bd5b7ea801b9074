"""The folder of a run: its pictures, and a hidden folder with all that continues the run."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from lfcal import Calibration, OutputError, load
from lfcal.runtime.output_file import atomic_write, make_folder, refuse_leftovers

from ..output.formats import check_format
from .frames import is_video
from .options import FrameOptions
from .view_grid import ViewOutput

__all__ = ["RunFolder", "RunState", "load_camera"]

_HIDDEN = ".lfrender"


@dataclass(frozen=True)
class RunState:
    """What the first analysed frame decides for all pictures of a run."""

    scale: float  # output pixels per pitch
    still: float  # patch size [px] of the places that do not move from view to view
    colours: tuple[float, float]  # far and near end of the colours of depth pictures
    gain: float  # factor on the light of pictures
    balance: tuple[float, float, float]  # and further factors on red, green and blue


def load_camera(folder: Path) -> Calibration:
    """The camera of the pictures in a folder, once the first frame has been analysed."""
    return load(folder / _HIDDEN / "camera.json")


class RunFolder:
    """Paths of all files of a run for the frames of these names; made, or continued if it exists.

    `overwrite` removes what an earlier run has stored in the hidden folder.
    """

    def __init__(
        self, place: Path, options: FrameOptions, names: list[str], overwrite: bool
    ) -> None:
        self.place = make_folder(place)
        self.hidden = make_folder(place / _HIDDEN)
        self.depth_maps = None if options.depth_maps is None else Path(options.depth_maps)
        self.makes_depth_film = self.depth_maps is not None and is_video(self.depth_maps)
        self.views: ViewOutput | None = None
        self._suffix = options.suffix
        self._state = self.hidden / "settings.json"
        if options.views is None:
            check_format(self.path_of("picture"), "picture", quality=options.quality)
        else:
            self.views = ViewOutput(place, self.hidden, options.suffix, options.quality)
            self.views.start(overwrite, names)
        if self.depth_maps is not None:
            make_folder(self.depth_path_of("").parent)
        if overwrite:
            self._clear(names)

    def _clear(self, names: list[str]) -> None:
        if names and self.views is None and self._state.exists():
            # The next run would take pictures of other frames for pictures with these settings.
            pictures = [self.path_of(name).name for name in names]
            refuse_leftovers(self.place, rf"[^.].*{re.escape(self._suffix)}", pictures)
        for file in (*self.hidden.glob("*.npz"), *self.hidden.glob("*.json")):
            file.unlink()

    def path_of(self, name: str) -> Path:
        """Picture of a frame, or folder of its views."""
        if self.views:
            return self.views.path_of(name)
        return self.place / f"{name}{self._suffix}"

    def depth_path_of(self, name: str) -> Path:
        """Depth map of a frame, or its picture in the film of depth."""
        assert self.depth_maps is not None
        if self.makes_depth_film:
            return self.hidden / "depth" / f"{name}.png"
        return self.depth_maps / f"{name}.npz"

    def reference_path_of(self, name: str) -> Path:
        """Depth map of a frame that other frames are compared with."""
        return self.hidden / f"depth_{name}.npz"

    def is_missing(self, name: str) -> bool:
        """Whether the frame has to be rendered."""
        missing = self.views.is_missing(name) if self.views else not self.path_of(name).exists()
        return missing or (self.depth_maps is not None and not self.depth_path_of(name).exists())

    def remove(self, names: list[str]) -> None:
        """Remove the results for these frames: an interrupted run must keep none of before."""
        for name in names:
            paths = []
            if not (self.views and self.views.raw):
                paths.append(self.path_of(name))
            if self.depth_maps is not None:
                paths.append(self.depth_path_of(name))
            for path in paths:
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)

    def save_state(
        self, settings: dict[str, Any], state: RunState, camera: Calibration
    ) -> Calibration:
        """Store what continues the run; returns the camera as a continued run will read it."""
        camera.save(self.hidden / "camera.json")
        with atomic_write(self._state) as temporary:
            temporary.write_text(json.dumps(settings | asdict(state)), encoding="utf-8")
        return load_camera(self.place)

    def load_state(
        self, settings: dict[str, Any], scale: float | None, camera: Calibration | None
    ) -> tuple[RunState, Calibration] | None:
        """State and camera of the run to continue, if there is one.

        OutputError if its settings, scale or camera are others; None stands for any.
        """
        if not self._state.exists():
            return None
        stored = load_camera(self.place)
        try:
            found = json.loads(self._state.read_text(encoding="utf-8"))
            state = RunState(*[found.pop(field.name) for field in fields(RunState)])
        except (OSError, AttributeError, KeyError, TypeError, ValueError) as error:
            raise OutputError(
                f"{self.hidden}: damaged ({error}); render everything again (--overwrite)"
            ) from error
        same_camera = camera is None or camera.to_dict() == stored.to_dict()
        if not (same_camera and found == settings and scale in (None, state.scale)):
            raise OutputError(
                f"{self.place}: holds pictures made with another camera, dark frame, preset or "
                "scale; give another folder, or render everything again (--overwrite)"
            )
        return state, stored
