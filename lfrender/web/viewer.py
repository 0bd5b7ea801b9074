"""The viewer: a web page on which a light field is refocused, as files for any web server or disk."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.output_file import atomic_write, make_folder

from ..data.depth_map import DepthMap
from .templates import fill, read_asset, safe
from .viewer_scene import viewer_scene

__all__ = ["viewer_files", "viewer_page", "write_viewer"]

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
    for name, content in viewer_scene(flat, calibration, depth, title, **options):
        text = base64.b64encode(content).decode()
        yield f"data/{name}.js", f'lightFieldData("{name}", "{text}");\n'.encode()
    yield "index.html", _page(title).encode()


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


def _page(title: str, data: dict[str, str] | None = None) -> str:
    """The page, with the data files in it, or loading them from the folder `data`."""
    # Modules are data URLs: browsers do not fetch files for a page that was opened from a disk.
    urls = {}
    for name in _MODULES:
        script = base64.b64encode(read_asset(f"{name}.js").encode()).decode()
        urls[f"lfrender/{name}"] = f"data:text/javascript;base64,{script}"
    inside = f"<script>globalThis.lightFieldFiles = {json.dumps(data)};</script>" if data is not None else ""
    page = fill(
        "viewer.html", title=title, style=read_asset("viewer.css"), shader=read_asset("light_field.frag"),
        prefilter=read_asset("prefilter.frag"), modules=safe(json.dumps({"imports": urls})), data=safe(inside),
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
    make_folder(target, parents=True)
    make_folder(target / "data")
    # Files that are sent over a network are worth the time of compression.
    for name, content in viewer_files(flat, calibration, depth, title, compression=6):
        with atomic_write(target / name) as temporary:
            temporary.write_bytes(content)
    return target / "index.html"
