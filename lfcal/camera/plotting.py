"""A calibration in a notebook: a card with a drawing of its lattice, and plots of its parts with
Matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..lattice.lattice import describe_orientation
from ..runtime.page import html_card

if TYPE_CHECKING:
    from .calibration import Calibration

__all__ = [
    "TYPE_COLOURS",
    "calibration_card",
    "draw_circles",
    "draw_lenses",
    "plot_calibration",
    "plot_falloff",
    "plot_gain",
    "plot_residuals",
]

#: Colours of lens types.
TYPE_COLOURS = ("#2d7dd2", "#e6721a", "#3a9d5d", "#8e5bb5")


def calibration_card(calibration: Calibration) -> str:
    """HTML of the key figures of a camera beside a drawing of its lattice."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    width, height = calibration.image_size
    figures = {
        "lattice": f"{shape}, rows {rows}, turned by {turned:+.4f}°",
        "pitch": f"{lattice.pitch:.4f} px",
        "usable radius": f"{lattice.radius:.2f} px",
        "flat": f"{width} x {height} px, {len(lattice)} lenses",
        "lens types": str(
            calibration.lens_types.count if calibration.lens_types is not None else 1
        ),
        "measured on": f"{calibration.source}, confidence {calibration.confidence:.2f}",
    }
    if np.isfinite(calibration.residual_rms):
        figures["residual"] = (
            f"{calibration.residual_rms:.3f} px RMS of {calibration.lenses_used} lenses"
        )
    return html_card(
        "Calibration", figures, lambda ax: _plot_centres(calibration, ax, 40), calibration.warnings
    )


def plot_calibration(calibration: Calibration, ax: Any = None) -> Any:
    """See `Calibration.plot`."""
    import matplotlib.pyplot as plt

    ax = ax or plt.gca()
    if calibration.residuals is None:
        _plot_centres(calibration, ax)
        return ax
    arrows, longest = plot_residuals(calibration, ax)
    if arrows is not None:
        ax.figure.colorbar(arrows, ax=ax, label="length over its standard error")
    ax.set_title(f"Mean residuals of the lattice, at most {longest:.2g} px")
    return ax


def plot_residuals(calibration: Calibration, ax: Any, **style: Any) -> tuple[Any, float]:
    """Arrows of the mean residuals over the flat, coloured by their significance, and the longest
    [px].
    """
    width, height = calibration.image_size
    ax.set(
        xlim=(-0.5, width - 0.5),
        ylim=(height - 0.5, -0.5),
        aspect="equal",
        xlabel="x [px]",
        ylabel="y [px]",
    )
    if calibration.residuals is None:
        return None, float("nan")
    positions, mean, error = calibration.residuals.mean_over_grid(calibration.lattice)
    length = np.hypot(*mean.T)
    if not length.any():
        return None, 0.0
    arrows = ax.quiver(*positions.T, *mean.T, length / error, angles="xy", cmap="viridis", **style)
    return arrows, float(length.max(initial=0.0))


def plot_gain(calibration: Calibration, ax: Any) -> None:
    """The gain map of the top left corner, four pitches wide, or words where there is none."""
    known = calibration.gain_map is not None
    defects = calibration.defects
    ax.set(title="Gain map, top left" if known else "Gain map: not measured", xticks=[], yticks=[])
    if known:
        reach = max(8, int(4 * calibration.lattice.pitch))
        ax.imshow(calibration.gain()[:reach, :reach], cmap="gray", vmin=0, vmax=1)
        ax.set_xlabel(f"{len(defects.pixels)} pixels, {len(defects.lenses)} lenses defect")


def plot_falloff(calibration: Calibration, ax: Any) -> None:
    """Light inside a microimage over the distance to its centre, and the usable radius."""
    vignetting = calibration.vignetting
    radius = calibration.lattice.radius
    title = "Light in a microimage" if vignetting else "Light: not measured"
    ax.set(title=title, xlabel=f"radius [px], R {radius:.1f}")
    ax.axvline(radius, color=TYPE_COLOURS[0])
    if vignetting is not None:
        ax.plot(
            np.arange(len(vignetting.profile)) * vignetting.step,
            vignetting.profile,
            color=TYPE_COLOURS[1],
        )


def draw_circles(ax: Any, centres: Any, radii: Any, colours: Any, **style: Any) -> None:
    """Circles about centres (n, 2) [px], of one radius or of as many."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    discs = [
        Circle(*disc) for disc in zip(centres, np.broadcast_to(radii, len(centres)), strict=True)
    ]
    ax.add_collection(PatchCollection(discs, facecolor="none", edgecolor=colours, **style))


def draw_lenses(calibration: Calibration, ax: Any, shown: Any, **style: Any) -> None:
    """The usable circles of those microimages that are `shown` (n,), in the colours of their types."""
    lattice = calibration.lattice
    types = calibration.lens_types
    kinds = np.zeros(shown.sum(), int) if types is None else types.of(lattice.indices()[shown])
    colours = [TYPE_COLOURS[kind % len(TYPE_COLOURS)] for kind in kinds]
    draw_circles(ax, lattice.centres()[shown], lattice.radius, colours, **style)


def _plot_centres(calibration: Calibration, ax: Any, most: int = 600) -> None:
    lattice = calibration.lattice
    size = np.array(calibration.image_size)
    centres = lattice.centres()
    half = size / 2
    title = f"{len(centres):,} microimages"
    if len(centres) > most:
        half = np.minimum(half, lattice.pitch * most**0.5 / 2)
        title = f"{title}, those in the middle"
    (left, top), (right, bottom) = (size - 1) / 2 - half, (size - 1) / 2 + half
    inside = ((centres > (left, top)) & (centres < (right, bottom))).all(1)
    draw_lenses(calibration, ax, inside, linewidth=0.6)
    ax.plot(*centres[inside].T, ".", markersize=2, color=TYPE_COLOURS[1])
    ax.set(
        xlim=(left, right),
        ylim=(bottom, top),
        aspect="equal",
        xlabel="x [px]",
        ylabel="y [px]",
        title=title,
    )
