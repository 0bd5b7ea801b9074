"""Pages of HTML, filled from templates (Jinja), and figures on them."""

from __future__ import annotations

import os
from io import StringIO
from pathlib import Path
from typing import Any

from .output_file import atomic_write

__all__ = ["to_svg", "write_page"]


def write_page(path: str | os.PathLike[str], template: Path, **values: Any) -> None:
    """Write a template filled with values, which are escaped, as a page; it appears whole or not at all."""
    from jinja2 import Environment, FileSystemLoader

    templates = Environment(loader=FileSystemLoader(template.parent), autoescape=True)
    page = templates.get_template(template.name).render(**values)
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def to_svg(figure: Any) -> str:
    """A Matplotlib figure as SVG without the head of a file, for a page."""
    text = StringIO()
    figure.savefig(text, format="svg")
    return text.getvalue()[text.getvalue().index("<svg") :]
