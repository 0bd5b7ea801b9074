"""HTML pages from templates (Jinja), figures on pages, results in notebooks."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

from .output_file import atomic_write
from .types import AnyPath

__all__ = ["html_card", "html_table", "to_svg", "write_page"]


def write_page(path: AnyPath, template: Path, **values: Any) -> None:
    """Fill a template with values, which are escaped, and write it as a page.

    The page appears whole or not at all.
    """
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


def html_card(
    title: str, figures: Mapping[str, str], plot: Callable[[Any], Any], warnings: Sequence[str] = ()
) -> str:
    """HTML of what `plot` draws, beside a table of figures, with warnings below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4, 3), dpi=110, layout="tight")
    stream = BytesIO()
    plot(figure.subplots())
    figure.savefig(stream, format="png")
    data = base64.b64encode(stream.getvalue()).decode()
    return (
        "<div style='display:flex;flex-wrap:wrap;gap:1.2em;align-items:flex-start'>"
        f"<img alt='{escape(title)}' style='width:400px' src='data:image/png;base64,{data}'>"
        f"{html_table(title, figures, warnings)}</div>"
    )


def html_table(title: str, figures: Mapping[str, str], warnings: Sequence[str] = ()) -> str:
    """HTML of a table of figures, with warnings below."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in figures.items()
    )
    lines = "".join(f"<p>&#9888; {escape(line)}</p>" for line in warnings)
    return f"<div><b>{escape(title)}</b><table>{rows}</table>{lines}</div>"
