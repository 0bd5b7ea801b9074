"""Figures of the report of a metric calibration, as SVG."""

from __future__ import annotations

from io import StringIO
from typing import Any

import numpy as np

from ..metric.result import MetricCalibration

__all__ = ["draw_field", "draw_poses"]


def draw_poses(found: MetricCalibration) -> str:
    """Boards seen from above and from the side."""
    from matplotlib.figure import Figure

    figure = Figure((9, 5), layout="constrained")
    points = found.board.points.reshape(found.board.rows, found.board.columns, 3)
    rim = points[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]
    for axis, (axes, name) in enumerate(zip(figure.subplots(2, sharex=True), ("above", "the side"), strict=True)):
        axes.plot(0, 0, "ko")
        for number, pose in enumerate(found.poses):
            outline = pose.place(rim) / 1000
            (line,) = axes.plot(outline[:, 2], outline[:, axis], gid=f"pose-{number}-{axis}")
            axes.fill(outline[:, 2], outline[:, axis], alpha=0.25, color=line.get_color())
            axes.annotate(pose.name, outline[0, [2, axis]], fontsize=7)
        axes.set(title=f"from {name}", ylabel="x [m]" if axis == 0 else "y [m]")
    axes.invert_yaxis()
    axes.set_xlabel("distance from the camera [m]")
    return _svg(figure)


def draw_field(found: MetricCalibration) -> str:
    """Mean residual of each tile of the flat as an arrow."""
    from matplotlib.figure import Figure

    width, height = found.calibration.image_size
    side = max(width, height) / 16
    tile = (found.observations.centre[found.used] // side).astype(int)
    key, group, count = np.unique(tile, axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(group.ravel(), found.residual[found.used][:, k]) / count for k in (0, 1)], axis=1)
    kept = count >= 5
    figure = Figure((7, 7 * height / width), layout="constrained")
    axes = figure.subplots()
    # The title keeps room for the key.
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="x [px]", ylabel="y [px]", title=" ")
    arrows = axes.quiver(*((key[kept] + 0.5) * side).T, *means[kept].T, angles="xy", color="firebrick")
    if kept.any():
        largest = float(np.hypot(*means[kept].T).max())
        axes.quiverkey(arrows, 0.9, 1.03, largest, f"{largest:.2g} px", labelpos="W")
    return _svg(figure)


def _svg(figure: Any) -> str:
    """A figure without the head of a file, for a page."""
    text = StringIO()
    figure.savefig(text, format="svg")
    return text.getvalue()[text.getvalue().index("<svg") :]
