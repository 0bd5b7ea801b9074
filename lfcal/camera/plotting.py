"""A calibration in a notebook: its card, and its fit on Matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..lattice.orientation import describe_orientation
from ..runtime.notebook import get_axes, html_card, lattice_svg

if TYPE_CHECKING:
    from .calibration import Calibration

__all__ = ["calibration_card", "plot_calibration"]

# Residuals are averaged over so many rectangles of the flat.
_RECTANGLES = (12, 9)


def calibration_card(calibration: Calibration) -> str:
    """HTML with a drawing of the lattice and the key figures of a camera."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    width, height = calibration.image_size
    figures = {
        "lattice": f"{shape}, rows {rows}, turned by {turned:+.4f}°",
        "pitch": f"{lattice.pitch:.4f} px",
        "usable radius": f"{lattice.radius:.2f} px",
        "flat": f"{width} x {height} px, {len(lattice)} lenses",
        "lens types": str(calibration.lens_types.count if calibration.lens_types is not None else 1),
        "measured on": f"{calibration.source}, confidence {calibration.confidence:.2f}",
    }
    if np.isfinite(calibration.residual_rms):
        figures["residual"] = f"{calibration.residual_rms:.3f} px RMS of {calibration.lenses_used} lenses"
    drawing = lattice_svg(lattice, calibration.lens_types)
    return html_card("Calibration", figures, drawing, calibration.warnings)


def plot_calibration(calibration: Calibration, ax: Any = None) -> Any:
    """`Calibration.plot`."""
    ax = get_axes(ax)
    lattice = calibration.lattice
    width, height = calibration.image_size
    if calibration.residuals is None:
        centres = lattice.centres()
        ax.scatter(*centres.T, s=2, linewidths=0)
        ax.set_title("Centres of the microimages")
    else:
        places, mean, error = calibration.residuals.mean_over_grid(lattice, *_RECTANGLES)
        arrows = ax.quiver(*places.T, *mean.T, np.hypot(*mean.T) / error, angles="xy", cmap="viridis")
        ax.figure.colorbar(arrows, ax=ax, label="length over its standard error")
        longest = float(np.hypot(*mean.T).max(initial=0.0))
        ax.set_title(f"Mean residuals of the lattice, at most {longest:.2g} px")
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="x [px]", ylabel="y [px]")
    return ax
