"""The viewer's page: a light field to be refocused in the browser, as files for any web page."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from numpy.typing import NDArray

from lfcal import Calibration, OutputError
from lfcal.runtime.output_file import atomic_write

from ..data.depth_map import DepthMap
from .viewer_scene import viewer_scene

__all__ = ["viewer_files", "write_viewer"]

_MODULES = ("geometry", "scene", "renderer", "viewer")
# Files that are sent over a network are worth the time.
_SMALL = 6


def viewer_files(
    flat: NDArray, calibration: Calibration, depth: DepthMap, title: str = "Light field", **options: Any
) -> Iterator[tuple[str, bytes]]:
    """All files of the viewer, the page last.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
    calibration : Calibration
    depth : DepthMap
        Of this flat.
    title : str
    options
        `tile` and `compression` of `viewer_scene`.

    Returns
    -------
    iterator of (str, bytes)
        Paths relative to the page, `index.html` or `data/...`, and contents.
    """
    for name, content in viewer_scene(flat, calibration, depth, title, **options):
        text = base64.b64encode(content).decode()
        yield f"data/{name}.js", f'lightFieldData("{name}", "{text}");\n'.encode()
    web = files(__package__) / "assets"
    # Modules as data URLs: browsers fetch no files for a page that was opened from a disk.
    modules = {f"lfrender/{name}": _data_url((web / f"{name}.js").read_bytes()) for name in _MODULES}
    page = Template((web / "viewer.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        style=(web / "viewer.css").read_text(encoding="utf-8"),
        shader=(web / "light_field.frag").read_text(encoding="utf-8"),
        ready=(web / "ready_to_read.frag").read_text(encoding="utf-8"),
        modules=json.dumps({"imports": modules}),
    )
    yield "index.html", page.encode()


def _data_url(script: bytes) -> str:
    return "data:text/javascript;base64," + base64.b64encode(script).decode()


def write_viewer(
    folder: str | os.PathLike[str],
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    title: str = "Light field",
) -> Path:
    """Write the viewer as static files; gives the path of its page.

    The page works where the folder is served, and from a disk. To put it on a web page, use an `iframe`.

    Parameters
    ----------
    folder : path-like
        Made if it does not exist; files of the same names in it are replaced.
    flat, calibration, depth, title
        As for `viewer_files`.

    Raises
    ------
    OutputError
        If the folder cannot be made or written.
    FlatError, CalibrationError
        As `render`.
    """
    target = Path(folder)
    try:
        (target / "data").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{target}: cannot be made ({error.strerror})") from error
    for name, content in viewer_files(flat, calibration, depth, title, compression=_SMALL):
        with atomic_write(target / name) as temporary:
            temporary.write_bytes(content)
    return target / "index.html"
