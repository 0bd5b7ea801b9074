"""What objects show in a notebook: a small picture beside their key figures, as HTML without any script; plots."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..lattice.orientation import describe_orientation
from .eight_bit import to_eight_bits

__all__ = ["get_axes", "html_card", "lattice_svg", "thumbnail"]

# Height of a picture in a card, and side of the drawing of a lattice [CSS px].
_HEIGHT, _SIDE = 240, 200
# Pitches across the drawing of a lattice.
_ACROSS = 5.0
# Lattice steps within which all lenses of a drawing lie; a reduced basis is at least 60 degrees apart.
_NEIGHBOURS = 6
_TYPE_COLOURS = ("#2d7dd2", "#e6721a", "#3a9d5d", "#8e5bb5")


def html_card(title: str, figures: Mapping[str, str], picture: str, warnings: Sequence[str] = ()) -> str:
    """A picture beside a table.

    Parameters
    ----------
    title : str
    figures : mapping of str to str
        Rows of the table, as they are to be read.
    picture : str
        HTML of the picture, as `thumbnail` and `lattice_svg` give it.
    warnings : sequence of str, optional
        Lines below.

    Returns
    -------
    str
        HTML.
    """
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
    """HTML of a picture, made smaller to fit a card.

    Parameters
    ----------
    image : (h, w), (h, w, 1) or (h, w, 3) array
        uint8, uint16, or float between 0 and 1.
    name : str
        What it shows, for readers who cannot see it.
    white : float, optional
        As for `to_eight_bits`.
    """
    from PIL import Image

    pixels = image[:, :, 0] if image.ndim == 3 and image.shape[2] == 1 else image
    picture = Image.fromarray(np.ascontiguousarray(to_eight_bits(pixels, white)))
    # Twice the size on the page, for dense screens.
    picture.thumbnail((4 * _HEIGHT, 2 * _HEIGHT))
    stream = BytesIO()
    picture.save(stream, "PNG")
    data = base64.b64encode(stream.getvalue()).decode()
    return f"<img alt='{escape(name)}' style='height:{_HEIGHT}px' src='data:image/png;base64,{data}'>"


def lattice_svg(lattice: Lattice, types: LensTypes | None = None) -> str:
    """Inline SVG of the lenses about the middle of a flat: usable circles, and the basis as two arrows.

    Parameters
    ----------
    lattice : Lattice
    types : LensTypes, optional
        Each type has a colour of its own.
    """
    scale = _SIDE / (_ACROSS * lattice.pitch)
    span = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
    index = lattice.middle + np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    at = (lattice.points(index) - lattice.points(lattice.middle[None])) * scale + _SIDE / 2
    near = (np.abs(at - _SIDE / 2) < _SIDE / 2 + lattice.radius * scale).all(1)
    kinds = np.zeros(len(index), int) if types is None else types.of(index)
    circles = "".join(
        f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{lattice.radius * scale:.1f}' fill='{colour}' "
        f"fill-opacity='.15' stroke='{colour}'/>"
        for (x, y), kind in zip(at[near], kinds[near], strict=True)
        for colour in [_TYPE_COLOURS[int(kind) % len(_TYPE_COLOURS)]]
    )
    arrows = "".join(
        f"<line x1='{_SIDE / 2}' y1='{_SIDE / 2}' x2='{x:.1f}' y2='{y:.1f}' stroke='currentColor' stroke-width='1.5'/>"
        f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2.5' fill='currentColor'/>"
        for x, y in lattice.basis * scale + _SIDE / 2
    )
    return (
        f"<svg width='{_SIDE}' height='{_SIDE}' viewBox='0 0 {_SIDE} {_SIDE}' role='img' "
        f"aria-label='{describe_orientation(lattice)[0]} lattice, {_ACROSS:.0f} pitches wide'>{circles}{arrows}</svg>"
    )


def get_axes(given: Any) -> Any:
    """Matplotlib axes to draw on: those given, or the current ones.

    Raises
    ------
    ModuleNotFoundError
        If Matplotlib is not installed, with how to install it.
    """
    if given is not None:
        return given
    try:
        import matplotlib.pyplot as plt
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("plots need Matplotlib: pip install 'lfrender[plots]'", name="matplotlib") from error
    return plt.gca()
