"""The viewer: a web page on which a light field is refocused, as files for any web server or disk."""

from __future__ import annotations

import base64
import json
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError
from lfcal.runtime.output_file import atomic_write, make_folder

from ..data.depth_map import DepthMap
from .templates import fill, read_asset, safe
from .viewer_scene import viewer_scene

__all__ = ["FlatPages", "viewer_files", "viewer_page", "write_viewer"]

# Scripts of the page, each a module that imports only those before it.
_MODULES = (
    "geometry", "scene", "renderer", "composition", "files", "readout", "address", "controls", "pointer", "viewer",
)  # fmt: skip


def viewer_files(
    flat: NDArray, calibration: Calibration, depth: DepthMap, title: str = "Light field", **options: Any
) -> Iterator[tuple[str, bytes]]:
    """All files of the viewer, the page last: paths relative to the page, `index.html` or `data/...`, and contents.

    `options` are `tile` and `compression` of `viewer_scene`.
    """
    yield from _data_files("data", flat, calibration, depth, title, **options)
    yield "index.html", _page(title).encode()


def _data_files(folder: str, *scene: Any, **options: Any) -> Iterator[tuple[str, bytes]]:
    for name, content in viewer_scene(*scene, **options):
        text = base64.b64encode(content).decode()
        yield f"{folder}/{name}.js", f'lightFieldData("{name}", "{text}");\n'.encode()


def viewer_page(flat: NDArray, calibration: Calibration, depth: DepthMap, title: str = "Light field") -> str:
    """The viewer as one HTML page that holds everything; arguments as of `viewer_files`.

    Examples
    --------
    >>> import lfrender
    >>> viewer_page(*lfrender.data.example())[:15]
    '<!doctype html>'
    """
    scene = viewer_scene(flat, calibration, depth, title, compression=6)
    return _page(title, {name: base64.b64encode(content).decode() for name, content in scene})


def _page(title: str, data: dict[str, str] | None = None, **place: Any) -> str:
    """The page, with the data files in it, or loading them from a folder; `place` is that among several flats."""
    # Modules are data URLs: browsers do not fetch files for a page that was opened from a disk.
    urls = {}
    for name in _MODULES:
        script = base64.b64encode(read_asset(f"{name}.js").encode()).decode()
        urls[f"lfrender/{name}"] = f"data:text/javascript;base64,{script}"
    inside = f"<script>globalThis.lightFieldFiles = {json.dumps(data)};</script>" if data is not None else ""
    page = fill(
        "viewer.html", title=title, style=read_asset("viewer.css"), shader=read_asset("light_field.frag"),
        prefilter=read_asset("prefilter.frag"), modules=safe(json.dumps({"imports": urls})), data=safe(inside),
        **{"folder": "data", "flats": 1, "status": "Loading", **place},
    )  # fmt: skip
    return str(page)


def write_viewer(
    folder: str | os.PathLike[str], flat: NDArray, calibration: Calibration, depth: DepthMap, title: str = "Light field"
) -> Path:
    """Write the viewer as one page that holds everything, or as static files; returns the path of its page.

    The page works where it is served, and from a disk; to put it on a web page, use an `iframe`. `folder` is one page,
    if it ends with `.html` or `.htm`; else the folder of the files, made if it does not exist, where files of the same
    names are replaced. OutputError if it cannot be written; FlatError and CalibrationError as `render`.

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
    # Files that are sent over a network are worth the time of compression.
    _write_files(target, viewer_files(flat, calibration, depth, title, compression=6))
    return target / "index.html"


def _write_files(target: Path, files: Iterator[tuple[str, bytes]]) -> None:
    make_folder(target, parents=True)
    for name, content in files:
        make_folder((target / name).parent, parents=True)
        with atomic_write(target / name) as temporary:
            temporary.write_bytes(content)


class FlatPages:
    """Viewers of several flats, each of which leads to the one before and the next: for `PageServer`, or a folder.

    The pages are there at once. A flat is loaded when its page asks for its data, then the next one, one at a time; the
    page of a flat that cannot be loaded says why.

    Parameters
    ----------
    names : sequence of str
        Titles of the flats.
    load : callable
        Returns flat, calibration and depth by the number of the flat, or raises LightFieldError.
    """

    def __init__(self, names: Sequence[str], load: Callable[[int], tuple[NDArray, Calibration, DepthMap]]) -> None:
        self.names, self._load = names, load
        self._pages = ["index.html", *(f"{number}.html" for number in range(2, len(names) + 1))]
        # Data files of the flats that were looked at last, and the one that is looked at now.
        self._made: dict[int, dict[str, bytes]] = {}
        self._wanted, self._turn = 0, threading.Lock()

    def get(self, path: str) -> bytes | None:
        """The content of a file; None if there is none, or another flat has been asked for since."""
        if path in self._pages:
            return self._page(self._pages.index(path)).encode()
        head, _, rest = path.partition("/")
        number, _, _ = rest.partition("/")
        if head != "data" or not (number.isdecimal() and 1 <= int(number) <= len(self.names)):
            return None
        self._wanted = int(number) - 1
        files = self._data(self._wanted, self._wanted)
        threading.Thread(target=self._data, args=(self._wanted, self._wanted + 1), daemon=True).start()
        return None if files is None else files.get(path)

    def write(self, folder: str | os.PathLike[str]) -> Path:
        """Write the pages of all flats; returns the path of the first."""
        for number, name in enumerate(self._pages):
            _write_files(Path(folder), iter(self._make(number, compression=6).items()))
            _write_files(Path(folder), iter([(name, self._page(number).encode())]))
        return Path(folder) / self._pages[0]

    def _page(self, number: int) -> str:
        beside = {"previous": [None, *self._pages][number], "next": [*self._pages, None][number + 1]}
        title, status = self.names[number], f"Loading {self.names[number]}; a flat is analysed once, for some seconds"
        place = {"folder": f"data/{number + 1}", "flats": len(self.names), "number": number, "status": status}
        return _page(title, None, **place, **beside)

    def _data(self, wanted: int, number: int) -> dict[str, bytes] | None:
        """The data files of a flat, made now while `wanted` is still the one that is looked at."""
        with self._turn:
            if number not in self._made and wanted == self._wanted and number < len(self.names):
                self._made[number] = self._make(number)
                for old in list(self._made)[:-4]:
                    del self._made[old]
            return self._made.get(number)

    def _make(self, number: int, **options: Any) -> dict[str, bytes]:
        folder = f"data/{number + 1}"
        try:
            return dict(_data_files(folder, *self._load(number), self.names[number], **options))
        except (LightFieldError, OSError) as error:
            words = json.dumps(str(error))
            return {f"{folder}/scene.json.js": f'lightFieldData("scene.json", "", {words});\n'.encode()}
