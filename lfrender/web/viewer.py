"""The viewer: a page on which a light field is refocused, for any web server or disk."""

from __future__ import annotations

import base64
import json
import os
import re
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError
from lfcal.runtime.output_file import atomic_write, make_folder, refuse_leftovers

from ..data.depth_map import DepthMap
from .templates import Markup, fill, import_map, read_asset
from .viewer_scene import viewer_scene

__all__ = ["FlatPages", "viewer_page", "write_viewer"]

# Scripts of the page, each a module that imports only those before it.
_MODULES = (
    "geometry",
    "scene",
    "renderer",
    "composition",
    "files",
    "readout",
    "address",
    "controls",
    "pointer",
    "viewer",
)


def viewer_page(
    flat: NDArray, calibration: Calibration, depth: DepthMap, title: str = "Light field"
) -> str:
    """The viewer as one HTML page that holds everything; errors as of `render`.

    Examples
    --------
    >>> import lfrender
    >>> viewer_page(*lfrender.data.example())[:15]
    '<!doctype html>'
    """
    scene = viewer_scene(flat, calibration, depth, title, compression=6)
    return _page(title, {name: base64.b64encode(content).decode() for name, content in scene})


def _page(title: str, data: dict[str, str] | None = None, **place: Any) -> str:
    """The page, which holds or loads its data; `place` is the number of the flat among several."""
    inside = ""
    if data is not None:
        inside = f"<script>globalThis.lightFieldFiles = {json.dumps(data)};</script>"
    page = fill(
        "viewer.html",
        title=title,
        style=read_asset("viewer.css"),
        shader=read_asset("light_field.frag"),
        prefilter=read_asset("prefilter.frag"),
        modules=import_map(_MODULES),
        data=Markup(inside),
        **{"folder": "data", "flats": 1, "status": "Loading", **place},
    )
    return str(page)


def write_viewer(
    folder: str | os.PathLike[str],
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    title: str = "Light field",
) -> Path:
    """Write the viewer as one page, or as static files; return the path of its page.

    The page works where it is served, and from a disk; to put it on a web page, use an `iframe`.
    `folder` is one page, if it ends with `.html` or `.htm`; else the folder of the files, made if
    it does not exist, where files of the same names are replaced. OutputError if it cannot be
    written; FlatError and CalibrationError as `render`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> with TemporaryDirectory() as folder:
    ...     write_viewer(f"{folder}/page", *lfrender.data.example()).name
    'index.html'
    """
    target = Path(folder)
    if target.suffix.lower() in (".html", ".htm"):
        with atomic_write(target) as temporary:
            temporary.write_text(viewer_page(flat, calibration, depth, title), encoding="utf-8")
        return target
    return FlatPages([title], lambda _: (flat, calibration, depth)).write(target)


class FlatPages:
    """Viewers of several flats, each with links to its neighbours.

    They serve `page_routes`, or are written into a folder.

    The pages are there at once. A flat is loaded when its page asks for its data, then the next
    one, one at a time. The page of one of several flats that cannot be loaded says why.

    Parameters
    ----------
    names : sequence of str
        Titles of the flats.
    load : callable
        Returns flat, calibration and depth by the number of the flat, or raises LightFieldError.
    options
        `tile` and `compression` of `viewer_scene`.
    """

    def __init__(
        self,
        names: Sequence[str],
        load: Callable[[int], tuple[NDArray, Calibration, DepthMap]],
        **options: Any,
    ) -> None:
        self.names, self._load, self._options = names, load, options
        self._pages = ["index.html", *(f"{number}.html" for number in range(2, len(names) + 1))]
        # Data files of the flats that were looked at last, and the one that is looked at now.
        self._made: dict[int, dict[str, bytes]] = {}
        self._wanted, self._turn = 0, threading.Lock()

    def get(self, path: str) -> bytes | None:
        """The content of a file; None if there is none, or if another flat was asked for since."""
        if path in self._pages:
            return self._page(self._pages.index(path))
        found = re.fullmatch(r"data/(\d{1,6})/.*", path)
        if not found or not 1 <= int(found[1]) <= len(self.names):
            return None
        self._wanted = int(found[1]) - 1
        files = self._data(self._wanted, self._wanted)
        threading.Thread(
            target=self._data, args=(self._wanted, self._wanted + 1), daemon=True
        ).start()
        if files is None:
            return None
        return files.get(path)

    def write(self, folder: str | os.PathLike[str]) -> Path:
        """Write the pages of all flats; returns the path of the first.

        OutputError if the folder holds pages of more flats, from an earlier run.
        """
        refuse_leftovers(Path(folder), r"\d+\.html", self._pages)
        # Files that are sent over a network are worth the time of compression.
        self._options.setdefault("compression", 6)
        for number, name in enumerate(self._pages):
            for path, content in {**self._make(number), name: self._page(number)}.items():
                make_folder((Path(folder) / path).parent, parents=True)
                with atomic_write(Path(folder) / path) as temporary:
                    temporary.write_bytes(content)
        return Path(folder) / self._pages[0]

    def _make(self, number: int) -> dict[str, bytes]:
        """The data files of a flat."""
        folder = f"data/{number + 1}"
        try:
            scene = viewer_scene(*self._load(number), self.names[number], **self._options)
            texts = {
                name: json.dumps([name, base64.b64encode(content).decode()])
                for name, content in scene
            }
        except (LightFieldError, OSError) as error:
            if len(self.names) == 1:
                raise
            texts = {"scene.json": json.dumps(["scene.json", "", str(error)])}
        return {
            f"{folder}/{name}.js": f"lightFieldData(...{text});\n".encode()
            for name, text in texts.items()
        }

    def _page(self, number: int) -> bytes:
        beside = {
            "previous": [None, *self._pages][number],
            "next": [*self._pages, None][number + 1],
        }
        title = self.names[number]
        status = "Loading"
        if len(self.names) > 1:
            status += f" {title}; a flat is analysed once, for some seconds"
        place = {
            "folder": f"data/{number + 1}",
            "flats": len(self.names),
            "number": number,
            "status": status,
        }
        return _page(title, None, **place, **beside).encode()

    def _data(self, wanted: int, number: int) -> dict[str, bytes] | None:
        """The data files of a flat, made now while `wanted` is still the one that is looked at."""
        with self._turn:
            if number not in self._made and wanted == self._wanted and number < len(self.names):
                self._made[number] = self._make(number)
                for old in list(self._made)[:-4]:
                    del self._made[old]
            return self._made.get(number)
