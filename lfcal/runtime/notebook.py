"""Results in a cell of a notebook: a plot beside key figures, as HTML without scripts."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

__all__ = ["html_card"]


def html_card(title: str, figures: Mapping[str, str], plot: Callable[[Any], Any], warnings: Sequence[str] = ()) -> str:
    """HTML of what `plot` draws on Matplotlib axes, beside a table of figures, with warnings below."""
    from matplotlib.figure import Figure

    figure, stream = Figure(figsize=(4, 3), dpi=110, layout="tight"), BytesIO()
    plot(figure.subplots())
    figure.savefig(stream, format="png")
    data = base64.b64encode(stream.getvalue()).decode()
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in figures.items())
    lines = "".join(f"<p>&#9888; {escape(line)}</p>" for line in warnings)
    return (
        "<div style='display:flex;flex-wrap:wrap;gap:1.2em;align-items:flex-start'>"
        f"<img alt='{escape(title)}' style='width:400px' src='data:image/png;base64,{data}'>"
        f"<div><b>{escape(title)}</b><table>{rows}</table>{lines}</div></div>"
    )
