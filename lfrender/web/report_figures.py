"""Pictures, maps and charts of a report: rendered, coloured, and encoded to be part of the page itself."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.eight_bit import to_eight_bits

from ..data.depth_map import BINOCULAR, TELESCOPIC, DepthMap
from ..data.rendering import Rendering
from ..output.depth_picture import (
    MODE_COLOURS,
    MODES,
    confidence_picture,
    magnification_limits,
    magnification_picture,
    mode_picture,
)
from ..rendering.render import render
from ..rendering.traditional import traditional

__all__ = [
    "ReportPictures", "bars", "cards", "data_urls", "draw_pictures", "fit_width", "magnification_histogram", "map_grid",
    "maps", "outliers", "png_url", "table", "table_rows", "webp_url",
]  # fmt: skip


@dataclass(frozen=True)
class ReportPictures:
    """Pictures of one flat, to be compared."""

    sharp: Rendering  # all in focus
    traditional: Rendering
    fixed: Mapping[str, Rendering]  # with the median patch size of each mode, by its name, on the grid of `sharp`
    patch_size: Mapping[str, float]  # [px] of `fixed`


def draw_pictures(
    flat: NDArray, calibration: Calibration, depth: DepthMap, least_share: float = 0.01
) -> ReportPictures:
    """Draw a flat all in focus, traditionally, and with the median patch size of each mode that it shows.

    A mode that fewer than `least_share` of the lenses have is taken for errors.
    """
    sharp = render(flat, calibration, depth)
    sizes = {}
    for mode in (TELESCOPIC, BINOCULAR):
        found = depth.patch_size[depth.mode == mode]
        if found.size > least_share * len(depth):
            sizes[MODES[mode]] = float(np.median(found))
    fixed = {name: render(flat, calibration, patch_size=size, scale=sharp.scale) for name, size in sizes.items()}
    return ReportPictures(sharp, traditional(flat, calibration), fixed, sizes)


def data_urls(pictures: Mapping[str, ArrayLike], most: int, white: float | None = None) -> tuple[dict[str, str], float]:
    """Pictures (h, w) or (h, w, 3) as WebP in data URLs of at most `most` characters in all, and their scale.

    All have the same quality, the best that fits, and below that the same reduction of width and height. `white` is the
    white level of integer pictures of more than 8 bits; by default the largest value of their type.
    """
    shown = {name: to_eight_bits(_to_rgb(np.asarray(picture)), white) for name, picture in pictures.items()}
    urls: dict[str, str] = {}
    for size, quality in ((1.0, 92), (1.0, 78), (0.5, 85), (0.25, 85), (0.125, 80)):
        # WebP holds at most so many pixels in a row.
        if size * max(max(picture.shape[:2]) for picture in shown.values()) > 16383:
            continue
        urls = {}
        for name, picture in shown.items():
            # The traditional picture, of a pixel per lens, stays as it is.
            reduced = picture if max(picture.shape) < 400 or size == 1 else _reduce(picture, size)
            urls[name] = webp_url(reduced, quality)
        if sum(map(len, urls.values())) <= most:
            break
    return urls, size


def png_url(picture: NDArray[np.uint8]) -> str:
    """A picture of few colours as PNG in a data URL."""
    import cv2

    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()


def webp_url(picture: NDArray[np.uint8], quality: int = 85) -> str:
    """A picture (h, w) or (h, w, C) as WebP in a data URL."""
    import cv2

    done, data = cv2.imencode(".webp", _to_rgb(picture)[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert done
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()


def fit_width(picture: NDArray, widest: int, white: float | None = None) -> NDArray[np.uint8]:
    """A picture with 8 bits, reduced to at most `widest` columns."""
    return _reduce(
        to_eight_bits(picture[..., :3] if picture.ndim == 3 else picture, white), min(1.0, widest / picture.shape[1])
    )


def _reduce(picture: NDArray[np.uint8], size: float) -> NDArray[Any]:
    import cv2

    width, height = (max(1, round(size * n)) for n in picture.shape[1::-1])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))


def _to_rgb(picture: NDArray) -> NDArray:
    if picture.ndim == 2 or picture.shape[2] < 3:
        picture = np.repeat(picture.reshape(*picture.shape[:2], -1)[..., :1], 3, axis=2)
    return picture[..., :3]


def map_grid(
    lattice: Lattice, widest: float = 1100, per_pitch: float = 12
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Affine from map pixels to scene coordinates, and the shape of the maps.

    They have at most `widest` columns and `per_pitch` pixels per pitch.
    """
    width, height = lattice.image_size
    spacing = max(width / widest, lattice.pitch / per_pitch)
    first = 0.5 * spacing - 0.5
    shape = max(1, round(height / spacing)), max(1, round(width / spacing))
    return np.array([[spacing, 0.0, first], [0.0, spacing, first]]), shape


def maps(depth: DepthMap, lattice: Lattice) -> dict[str, NDArray[np.uint8]]:
    """Maps of magnification, mode and confidence, (h, w, 3) uint8 each; the page has their legends."""
    grid = lattice, *map_grid(lattice)
    limits = magnification_limits(depth.magnification)
    found = {
        "magnification": magnification_picture(depth.patch_size, depth.mode, *grid, limits),
        "modes": mode_picture(depth.mode, *grid),
        "confidence": confidence_picture(depth.confidence, *grid),
    }
    return {name: picture[: grid[2][0]] for name, picture in found.items()}


def magnification_histogram(
    depth: DepthMap, bins: int = 40, width: int = 900, height: int = 280, left: int = 84, below: int = 30
) -> str:
    """SVG: number of lenses over magnification on a logarithmic scale, telescopic ones above the axis, binocular below.

    Heights are square roots. What lies beyond the limits of the scale, mostly errors, is in a pale bar at each end. The
    size and the margins are in units of the drawing.
    """
    low, high = magnification_limits(depth.magnification)
    edges = np.array([0.0, *np.geomspace(low, high, bins + 1), np.inf])
    known = depth.magnification.astype(np.float64)
    counts = {code: np.histogram(known[depth.mode == code], edges)[0] for code in (1, -1)}
    # Square roots: a wall has thousands of lenses of one M, and single branches are seen beside it.
    tall = {code: np.sqrt(max(count.max(), 1)) for code, count in counts.items()}
    # Both modes have one scale; the axis lies where it leaves room for either.
    unit = (height - below - 20) / sum(max(n, 0.12 * max(tall.values())) for n in tall.values())
    axis, step = 10 + unit * max(tall[1], 0.12 * max(tall.values())), (width - left - 8) / (bins + 2)
    parts = []
    for code, count in counts.items():
        for n in np.nonzero(count)[0]:
            bar = unit * np.sqrt(count[n])
            beyond = n in (0, bins + 1)
            pale = ' opacity=".45"' if beyond else ""
            span = (
                f"M {edges[n]:.2f} to {edges[n + 1]:.2f}"
                if not beyond
                else "M " + (f"below {low:.2f}" if n == 0 else f"above {high:.2f}")
            )
            parts.append(
                f'<rect x="{left + step * n + 0.5:.1f}" y="{axis - bar if code > 0 else axis:.1f}" '
                f'width="{step - 1:.1f}" height="{bar:.1f}" fill="rgb{MODE_COLOURS[code]}"{pale}>'
                f"<title>{count[n]:,} {MODES[code]} lenses, {span}</title></rect>"
            )
        place = 10 + 10 if code > 0 else height - below - 4
        parts.append(f'<text x="{left - 8}" y="{place}" text-anchor="end">{count.max():,}</text>')
    parts.append(f'<path d="M{left} {axis:.1f}H{width - 8}" stroke="currentColor" opacity=".5"/>')
    for tick in _ticks(low, high):
        x = left + step + step * bins * np.log(tick / low) / np.log(high / low)
        parts.append(f'<text x="{x:.1f}" y="{height - 6}" text-anchor="middle">{tick:g}</text>')
    label = f"Histogram of the magnification of {int(sum(c.sum() for c in counts.values())):,} lenses"
    return f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def outliers(depth: DepthMap) -> str:
    """How many lenses the histogram marks as beyond its scale, in a sentence."""
    low, high = magnification_limits(depth.magnification)
    known = depth.magnification[np.isfinite(depth.magnification)]
    beyond = int(np.sum((known < low) | (known > high)))
    return f"Pale bars at the ends: {beyond:,} lenses beyond the scale, mostly errors." if beyond else ""


def _ticks(low: float, high: float) -> list[float]:
    """Four to nine round numbers on a logarithmic scale."""
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 4, 5, 7), tuple(1 + 0.2 * n for n in range(45)), (low, high)):
        powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        found = [float(f"{s * 10.0**p:.3g}") for p in powers for s in steps]
        found = [t for t in found if low <= t <= high]
        if len(found) >= 4:
            return found[:: -(-len(found) // 9)]
    return [float(f"{low:.3g}"), float(f"{high:.3g}")]


def bars(values: Mapping[str, float], form: str = "{:.2f} s") -> str:
    """Table of names and numbers, each with a bar as long as its share of the largest."""
    most = max(values.values(), default=0.0) or 1.0
    rows = [
        f'<tr><th scope="row">{escape(name)}</th><td class="bar"><span style="width:{100 * value / most:.1f}%"></span>'
        f"</td><td>{escape(form.format(value))}</td></tr>"
        for name, value in values.items()
    ]
    return f'<table class="bars"><tbody>{"".join(rows)}</tbody></table>'


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Table of names and texts."""
    lines = [f'<tr><th scope="row">{escape(name)}</th><td>{escape(text)}</td></tr>' for name, text in rows]
    return f'<table class="facts"><tbody>{"".join(lines)}</tbody></table>'


def table_rows(rows: Iterable[Iterable[str]]) -> str:
    """Rows of a table."""
    return "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)


def cards(values: Mapping[str, str]) -> str:
    """Names and figures as the cards at the top of a page."""
    return "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in values.items())
