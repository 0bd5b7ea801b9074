"""Charts and maps of a report: histogram, bars and legends as markup that follows light and dark, maps as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ..data.depth_map import DepthMap
from ..flat.lens_graph import nearest_lens
from ..output.depth_picture import MODE_COLOURS, magnification_picture, mode_picture

__all__ = ["bars", "confidence_map", "magnification_histogram", "magnification_limits", "map_grid", "maps", "table"]

# Widest map in the page [px]: a lens takes several pixels of it.
_WIDEST = 1100
_BINS = 48
# Size of the histogram in its own units.
_WIDTH, _HEIGHT, _LOW, _LEFT = 1080, 240, 34, 56


def magnification_limits(depth: DepthMap) -> tuple[float, float]:
    """Ends of the scale of M that holds 98 % of the resolved lenses."""
    known = depth.magnification[np.isfinite(depth.magnification)]
    low, high = np.percentile(known, [1, 99]) if known.size else (1.0, 10.0)
    return float(low), float(max(high, 1.2 * low))


def map_grid(lattice: Lattice) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Affine from map pixels to scene coordinates, and the shape of the maps."""
    width, height = lattice.image_size
    spacing = max(width / _WIDEST, lattice.pitch / 12)
    first = 0.5 * spacing - 0.5
    shape = max(1, round(height / spacing)), max(1, round(width / spacing))
    return np.array([[spacing, 0.0, first], [0.0, spacing, first]]), shape


def maps(depth: DepthMap, lattice: Lattice) -> dict[str, NDArray[np.uint8]]:
    """Maps of magnification, mode and confidence, (h, w, 3) uint8 each."""
    affine, shape = map_grid(lattice)
    limits = magnification_limits(depth)
    # Legends are part of the page.
    return {
        "magnification": magnification_picture(depth.patch_size, depth.mode, lattice, affine, shape, limits)[
            : shape[0]
        ],
        "modes": mode_picture(depth.mode, lattice, affine, shape)[: shape[0]],
        "confidence": confidence_map(depth, lattice, affine, shape),
    }


def confidence_map(
    depth: DepthMap, lattice: Lattice, affine: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """Confidence of the lens at each pixel, dark for 0 and light for 1 (colours of viridis)."""
    import cv2

    v, u = np.indices(shape)
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ affine.T
    share = np.clip(np.nan_to_num(depth.confidence), 0, 1)[nearest_lens(lattice, points)].reshape(shape)
    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], cv2.COLORMAP_VIRIDIS)[0, :, ::-1]
    return np.asarray(ramp[np.rint(255 * share).astype(np.uint8)], np.uint8)


def magnification_histogram(depth: DepthMap) -> str:
    """SVG: lenses over magnification on a logarithmic scale, telescopic ones below, binocular ones on top of them."""
    low, high = magnification_limits(depth)
    edges = np.geomspace(low, high, _BINS + 1)
    known = np.clip(depth.magnification.astype(np.float64), edges[0], edges[-1])
    counts = {code: np.histogram(known[depth.mode == code], edges)[0] for code in (1, -1)}
    most = max(int(sum(counts.values()).max()), 1)  # type: ignore[union-attr]
    plot_width, plot_height = _WIDTH - _LEFT - 8, _HEIGHT - _LOW - 10
    parts = []
    for n in range(_BINS):
        base = 0.0
        for code, name in ((1, "telescopic"), (-1, "binocular")):
            tall = plot_height * counts[code][n] / most
            if not tall:
                continue
            words = f"{counts[code][n]:,} {name} lenses, M {edges[n]:.2f} to {edges[n + 1]:.2f}"
            parts.append(
                f'<rect x="{_LEFT + plot_width * n / _BINS + 0.5:.1f}" y="{10 + plot_height - base - tall:.1f}" '
                f'width="{plot_width / _BINS - 1:.1f}" height="{tall:.1f}" fill="rgb{MODE_COLOURS[code]}">'
                f"<title>{words}</title></rect>"
            )
            base += tall
    floor = _HEIGHT - _LOW
    parts.append(f'<path d="M{_LEFT} {floor}H{_WIDTH - 8}" stroke="currentColor" opacity=".4"/>')
    for tick in _ticks(low, high):
        x = _LEFT + plot_width * np.log(tick / low) / np.log(high / low)
        parts.append(f'<text x="{x:.1f}" y="{floor + 23}" text-anchor="middle">{tick:g}</text>')
    parts.append(f'<text x="{_LEFT - 6}" y="18" text-anchor="end">{most:,}</text>')
    parts.append(f'<text x="{_LEFT - 6}" y="{floor}" text-anchor="end">0</text>')
    described = f"Histogram of the magnification of {int(sum(c.sum() for c in counts.values())):,} lenses"
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{described}">{"".join(parts)}</svg>'


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers on a logarithmic scale, a handful of them."""
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
    """Table of names and words."""
    lines = [f'<tr><th scope="row">{escape(name)}</th><td>{escape(words)}</td></tr>' for name, words in rows]
    return f'<table class="facts"><tbody>{"".join(lines)}</tbody></table>'
