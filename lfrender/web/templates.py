"""The templates of pages, in the folder `assets`; values are escaped."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup

__all__ = ["Markup", "fill", "read_asset"]


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
