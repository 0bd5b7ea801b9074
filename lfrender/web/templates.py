"""The templates of pages, in the folder `assets`; values are escaped."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup

__all__ = ["Markup", "fill", "import_map", "read_asset"]


@cache
def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("lfrender.web", "assets")
    return Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def fill(template: str, **values: Any) -> Any:
    """The text of a template with values in it."""
    return Markup(_environment().get_template(template).render(**values))


def read_asset(name: str) -> Any:
    """A style sheet, script or shader, to be put into a page as it is."""
    return Markup((files(__package__) / "assets" / name).read_text(encoding="utf-8"))


def import_map(names: Iterable[str]) -> Markup:
    """Where a page finds the modules `lfrender/NAME`, as the text of an import map.

    They are data URLs: browsers do not fetch files for a page that was opened from a disk.
    """
    urls = {}
    for name in names:
        script = base64.b64encode(read_asset(f"{name}.js").encode()).decode()
        urls[f"lfrender/{name}"] = f"data:text/javascript;base64,{script}"
    return Markup(json.dumps({"imports": urls}))
