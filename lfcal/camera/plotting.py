"""Drawings of a calibration with Matplotlib: centres, usable circles, residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..gain.gain_map import Defects, GainMap, Vignetting
from ..gain.rows import RegionGain
from ..lattice.lattice import Lattice
from ..lattice.standard_errors import Residuals
from .lens_types import LensTypes

__all__ = [
    "TYPE_COLOURS",
    "draw_circles",
    "draw_lenses",
    "plot_centres",
    "plot_falloff",
    "plot_gain",
    "plot_residuals",
]

#: Colours of lens types.
TYPE_COLOURS = ("#2d7dd2", "#e6721a", "#3a9d5d", "#8e5bb5")

# Relative difference of the diagonals up to which a cell counts as rectangular.
_RECTANGULAR = 0.03
# Farthest light over the usable radius, from which on microimages have corners: 1.00 to 1.08 on five
# arrays of discs, 1.15 to 1.41 on four of squares.
_CORNERED = 1.12


def plot_residuals(
    lattice: Lattice, residuals: Residuals | None, ax: Any, **style: Any
) -> tuple[Any, float]:
    """Draw the mean residuals over the flat as arrows, coloured by their significance.

    Returns the arrows, None if there are none, and the longest one [px], NaN if it is unknown.
    """
    _frame(ax, np.array([[0, 0], lattice.image_size]) - 0.5)
    if residuals is None:
        return None, float("nan")
    positions, mean, error = residuals.mean_over_grid(lattice)
    length = np.hypot(*mean.T)
    if not length.any():
        return None, 0.0
    arrows = ax.quiver(*positions.T, *mean.T, length / error, angles="xy", cmap="viridis", **style)
    return arrows, float(length.max())


def plot_gain(lattice: Lattice, gain: GainMap | None, defects: Defects, ax: Any) -> None:
    """Draw the gain map of the top left corner, four pitches wide."""
    if gain is None:
        ax.set(title="Gain map: not measured", xticks=[], yticks=[])
        return
    reach = max(8, int(4 * lattice.pitch))
    size = np.minimum(lattice.image_size, reach).tolist()
    ax.imshow(RegionGain(gain, lattice).at(0, 0, *size), cmap="gray", vmin=0, vmax=1)
    found = f"{len(defects.pixels)} pixels, {len(defects.lenses)} lenses defect"
    ax.set(title="Gain map, top left", xticks=[], yticks=[], xlabel=found)


def plot_falloff(radius: float, vignetting: Vignetting | None, ax: Any) -> None:
    """Draw the light in a microimage over the distance to its centre, and the usable radius."""
    ax.set(title="Light: not measured", xlabel=f"radius [px], R {radius:.1f}")
    ax.axvline(radius, color=TYPE_COLOURS[0])
    if vignetting is not None:
        distance = np.arange(len(vignetting.profile)) * vignetting.step
        ax.plot(distance, vignetting.profile, color=TYPE_COLOURS[1])
        ax.set_title("Light in a microimage")


def plot_centres(lattice: Lattice, types: LensTypes | None, ax: Any, most: int = 600) -> None:
    """Draw the centres and usable circles of at most `most` lenses in the middle of the flat."""
    size = np.array(lattice.image_size)
    centres = lattice.centres()
    half = size / 2
    title = f"{len(centres):,} microimages"
    if len(centres) > most:
        half = np.minimum(half, lattice.pitch * most**0.5 / 2)
        title = f"{title}, those in the middle"
    corners = (size - 1) / 2 + [-half, half]
    inside = ((centres > corners[0]) & (centres < corners[1])).all(1)
    draw_lenses(lattice, types, ax, inside, linewidth=0.5)
    ax.plot(*centres[inside].T, ".", markersize=2, color=TYPE_COLOURS[1])
    _frame(ax, corners)
    ax.set_title(title)


def _frame(ax: Any, corners: Any) -> None:
    """Show the part of a flat between two `corners` (2, 2) [px], with y pointing down."""
    (left, top), (right, bottom) = corners
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x [px]", ylabel="y [px]")


def draw_circles(ax: Any, centres: Any, radii: Any, colours: Any, **style: Any) -> None:
    """Draw circles about centres (n, 2) [px], of one radius or of n radii [px]."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    discs = map(Circle, centres, np.broadcast_to(radii, len(centres)))
    ax.add_collection(PatchCollection(list(discs), facecolor="none", edgecolor=colours, **style))


def draw_lenses(
    lattice: Lattice,
    types: LensTypes | None,
    ax: Any,
    shown: Any,
    reach: float = 0.0,
    **style: Any,
) -> None:
    """Draw the usable circles of the lenses in the mask `shown` (n,), coloured by their types.

    They are rectangles if light reaches farther towards the corners of rectangular cells: `reach`
    [px] as `Calibration.lit_reach`.
    """
    from matplotlib.collections import PolyCollection

    kinds = np.zeros(shown.sum(), int) if types is None else types.of(lattice.indices()[shown])
    colours = [TYPE_COLOURS[kind % len(TYPE_COLOURS)] for kind in kinds]
    centres = lattice.centres()[shown]
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) @ lattice.basis / 2
    lengths = np.hypot(*half.T)
    rectangular = np.ptp(lengths) < _RECTANGULAR * lengths.max()
    if not rectangular or reach < _CORNERED * lattice.radius:
        draw_circles(ax, centres, lattice.radius, colours, **style)
        return
    outlines = centres[:, None] + half * (reach / lengths.max())
    ax.add_collection(PolyCollection(outlines, facecolor="none", edgecolor=colours, **style))
