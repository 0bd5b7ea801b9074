"""Views of objects in notebooks: a small picture beside key figures, as HTML without scripts; Matplotlib axes."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import to_eight_bits

__all__ = ["colour_bar", "get_axes", "html_card", "thumbnail"]

_PICTURE_HEIGHT = 240  # of a card [CSS px]


def html_card(title: str, figures: Mapping[str, str], picture: str, warnings: Sequence[str] = ()) -> str:
    """HTML of a picture (HTML, as from `thumbnail`) beside a table of figures, with warnings below."""
    rows = "".join(
        f"<tr><th style='text-align:left;font-weight:normal;opacity:.7'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(value)}</td></tr>"
        for name, value in figures.items()
    )
    lines = "".join(f"<p style='margin:.3em 0'>&#9888; {escape(line)}</p>" for line in warnings)
    return (
        "<div style='display:flex;flex-wrap:wrap;gap:1.2em;align-items:flex-start'>"
        f"{picture}<div><b>{escape(title)}</b><table>{rows}</table>{lines}</div></div>"
    )


def thumbnail(image: NDArray, name: str, white: float | None = None) -> str:
    """HTML of a picture (h, w), (h, w, 1) or (h, w, 3), reduced to fit a card.

    `name` is the text for readers who cannot see it; `white` is as for `to_eight_bits`.
    """
    from PIL import Image

    pixels = image[:, :, 0] if image.ndim == 3 and image.shape[2] == 1 else image
    picture = Image.fromarray(np.ascontiguousarray(to_eight_bits(pixels, white)))
    # Twice the size on the page, for dense screens.
    picture.thumbnail((4 * _PICTURE_HEIGHT, 2 * _PICTURE_HEIGHT))
    stream = BytesIO()
    picture.save(stream, "PNG")
    data = base64.b64encode(stream.getvalue()).decode()
    return f"<img alt='{escape(name)}' style='height:{_PICTURE_HEIGHT}px' src='data:image/png;base64,{data}'>"


def colour_bar(steps: NDArray, low: str, high: str, others: Mapping[str, tuple[int, int, int]]) -> str:
    """HTML of a scale of colours: `steps` (k, 3) 0..255 from low to high, and other colours with their names."""
    stops = ", ".join("rgb({},{},{})".format(*step) for step in np.asarray(steps).tolist())
    keys = "".join(
        f"<span style='display:inline-block;width:1em;height:1em;margin:0 .4em 0 1em;vertical-align:-.15em;"
        f"background:rgb{colour}'></span>{escape(name)}"
        for name, colour in others.items()
    )
    return (
        f"<div style='height:10px;margin:6px 0 2px;background:linear-gradient(to right, {stops})'></div>"
        f"<div style='display:flex;justify-content:space-between;font-size:.85em'><span>{escape(low)}</span>"
        f"<span>{keys}</span><span>{escape(high)}</span></div>"
    )


def get_axes(given: Any) -> Any:
    """Matplotlib axes to draw on: those given, or the current ones."""
    import matplotlib.pyplot as plt

    return plt.gca() if given is None else given
