"""The histogram of the magnification of a report."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..data.depth_map import MODES, DepthMap
from ..output.depth_picture import MODE_COLOURS, magnification_limits
from .templates import fill

__all__ = ["magnification_histogram"]

# Bars between the limits; width and height of the drawing, its left margin and that below, in its own units.
_BINS, _WIDTH, _HEIGHT, _LEFT, _BELOW = 40, 900, 280, 84, 30


def magnification_histogram(depth: DepthMap) -> Any:
    """SVG: number of lenses over magnification on a logarithmic scale, telescopic ones above the axis, binocular below.

    Heights are square roots: a wall has thousands of lenses of one M, and single branches are seen beside it. What lies
    beyond the limits of the scale, mostly errors, is in a pale bar at each end.
    """
    low, high = magnification_limits(depth.magnification)
    edges = np.array([0.0, *np.geomspace(low, high, _BINS + 1), np.inf])
    counts = {code: np.histogram(depth.magnification[depth.mode == code], edges)[0] for code in (1, -1)}
    tall = {code: np.sqrt(max(count.max(), 1)) for code, count in counts.items()}
    # Both modes have one scale; the axis lies where it leaves room for either.
    tall = {code: max(n, 0.12 * max(tall.values())) for code, n in tall.items()}
    unit = (_HEIGHT - _BELOW - 20) / sum(tall.values())
    axis, step = 10 + unit * tall[1], (_WIDTH - _LEFT - 8) / (_BINS + 2)
    spans = [f"below {low:.2f}", *(f"{a:.2f} to {b:.2f}" for a, b in pairwise(edges[1:-1]))]
    spans.append(f"above {high:.2f}")
    bars = [
        {
            "x": _LEFT + step * n + 0.5, "height": (bar := unit * float(np.sqrt(count[n]))), "count": int(count[n]),
            "y": axis - bar if code > 0 else axis, "mode": MODES[code], "colour": MODE_COLOURS[code],
            "span": spans[n], "pale": n in (0, _BINS + 1),
        }
        for code, count in counts.items() for n in np.nonzero(count)[0].tolist()
    ]  # fmt: skip
    # Round numbers, if enough of them lie on the scale.
    powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    ticks = np.unique(np.outer(10.0**powers, (1, 1.5, 2, 3, 4, 5, 7)).round(6))
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    ticks = ticks if len(ticks) >= 3 else np.geomspace(low, high, 5)
    places = _LEFT + step * (1 + _BINS * np.log(ticks / low) / np.log(high / low))
    return fill(
        "histogram.svg", width=_WIDTH, height=_HEIGHT, left=_LEFT, axis=axis, bars=bars, step=step,
        ticks=list(zip(places.tolist(), ticks.tolist(), strict=True)),
        most=[int(counts[1].max()), int(counts[-1].max())], lenses=int(sum(count.sum() for count in counts.values())),
    )  # fmt: skip
