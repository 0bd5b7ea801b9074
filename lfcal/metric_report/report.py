"""Page (HTML) about a metric calibration, which needs no network.

Tables and figures (SVG) are put into a template (Jinja).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..camera.optics import OPTICS_PARAMETERS
from ..metric.result import MetricCalibration
from ..runtime.output_file import check_output
from ..runtime.page import to_svg, write_page
from .next_pose import suggest_poses

__all__ = ["write_metric_report"]

_Rows = Sequence[tuple[str, ...]]
# [inch] Width of figures: their text can be read on a phone, which shows them at this width.
_WIDTH = 4.4


def write_metric_report(
    path: str | os.PathLike[str], found: MetricCalibration, *, title: str = "Metric camera"
) -> None:
    """Write the report of a metric calibration as one HTML file; it appears whole or not at all."""
    check_output(path, {".html"})
    near, far = (f(pose.translation[2] for pose in found.poses) / 1000 for f in (min, max))
    write_page(
        path,
        Path(__file__).with_name("assets") / "metric.html",
        found=found,
        title=title,
        near=near,
        far=far,
        parameters=_parameters(found),
        poses=_poses(found),
        colours=_colours(found),
        depths=_depths(found),
        reliability=_reliability(found),
        next=suggest_poses(found),
        drawn_poses=_draw_poses(found),
        drawn_field=_draw_field(found),
    )


def _parameters(found: MetricCalibration) -> _Rows:
    optics = found.optics
    rows = []
    for name, value, error in zip(
        OPTICS_PARAMETERS, optics.parameters, optics.standard_errors, strict=True
    ):
        if error > 0:
            unit = (
                "mm"
                if name.endswith(("length", "distance", "pupil"))
                else "px"
                if "principal" in name
                else ""
            )
            if name.startswith("tilt"):
                value = np.rad2deg(value)
                error = np.rad2deg(error)
                unit = "degrees"
            digits = max(0, int(1 - np.floor(np.log10(error))))
            known = f"{value:z.{digits}f} \u00b1 {error:.{digits}f}"
            rows.append((name.replace("_", " "), known, unit))
    focal = enumerate(optics.microlens_focal_lengths)
    return rows + [(f"focal length of lens type {k}", f"{f:.5g}", "mm") for k, f in focal]


def _poses(found: MetricCalibration) -> _Rows:
    rows = []
    for pose in found.poses:
        errors = pose.standard_errors
        tilt = np.rad2deg(np.arccos(np.clip(pose.rotation[2, 2], -1, 1)))
        rows.append(
            (
                pose.name,
                f"{pose.translation[2]:.2f}",
                f"{errors[5]:.3f}",
                f"{np.hypot(*errors[3:5]):.3f}",
                f"{np.rad2deg(np.linalg.norm(errors[:3])):.4f}",
                f"{errors[5] / np.sqrt(found.widening):.3f}",
                f"{tilt:.1f}",
                f"{pose.rms:.4f}",
                str(pose.observations),
            )
        )
    return rows


def _depths(found: MetricCalibration) -> _Rows:
    rows = []
    for m in np.argsort([pose.translation[2] for pose in found.poses]):
        mine = (found.observations.pose == m) & found.used
        mean = found.residual[mine].mean(0)
        # Along the baseline: a wrong patch size moves corners away from, or towards, the middle of
        # the lenses.
        offset = found.observations.position[mine] - found.observations.centre[mine]
        stretch = 100 * float((offset * found.residual[mine]).sum() / max((offset**2).sum(), 1e-12))
        pose = found.poses[m]
        right, down = (f"{value:z.4f}" for value in mean)
        distance = f"{pose.translation[2]:.1f}"
        rows.append((distance, f"{pose.rms:.4f}", right, down, f"{stretch:z.4f} %"))
    return rows


def _reliability(found: MetricCalibration) -> _Rows:
    scale = found.noise / float(np.median(found.observations.error))
    distance = np.hypot(*found.residual.T) / (found.observations.error * scale)
    return [
        (
            f"{k} sigma",
            f"{100 * (distance < k).mean():.1f} %",
            f"{100 * (1 - np.exp(-k * k / 2)):.1f} %",
        )
        for k in (1, 2, 3)
    ]


def _colours(found: MetricCalibration) -> list[str]:
    """A colour for each pose, from near to far."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    order = np.argsort(np.argsort([pose.translation[2] for pose in found.poses]))
    return [to_hex(colour) for colour in colormaps["turbo"]((order + 0.5) / len(order))]


def _draw_poses(found: MetricCalibration) -> str:
    """Boards seen from above and from the side, in the colours of the table."""
    from matplotlib.figure import Figure

    figure = Figure((_WIDTH, _WIDTH), layout="constrained")
    points = found.board.points.reshape(found.board.rows, found.board.columns, 3)
    rim = points[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]
    for axis, (axes, name) in enumerate(
        zip(figure.subplots(2, sharex=True), ("above", "the side"), strict=True)
    ):
        for number, (pose, colour) in enumerate(zip(found.poses, _colours(found), strict=True)):
            outline = pose.place(rim) / 1000
            axes.fill(outline[:, 2], outline[:, axis], alpha=0.25, color=colour)
            axes.plot(outline[:, 2], outline[:, axis], color=colour, gid=f"pose-{number}-{axis}")
        axes.set(title=f"from {name}", ylabel="x [m]" if axis == 0 else "y [m]")
    axes.invert_yaxis()
    axes.set_xlabel("distance from the camera [m]")
    return to_svg(figure)


def _draw_field(found: MetricCalibration) -> str:
    """Mean residual of each tile of the flat as an arrow."""
    from matplotlib.figure import Figure

    width, height = found.calibration.image_size
    side = max(width, height) / 16
    tile = (found.observations.centre[found.used] // side).astype(int)
    key, group, count = np.unique(tile, axis=0, return_inverse=True, return_counts=True)
    means = np.stack(
        [np.bincount(group.ravel(), found.residual[found.used][:, k]) / count for k in (0, 1)],
        axis=1,
    )
    kept = count >= 5
    figure = Figure((_WIDTH, _WIDTH * height / width), layout="constrained")
    axes = figure.subplots()
    longest = 0.0
    if kept.any():
        longest = float(np.hypot(*means[kept].T).max())
    axes.set(
        xlim=(0, width),
        ylim=(height, 0),
        aspect="equal",
        xlabel="x [px]",
        ylabel="y [px]",
        title=f"the longest arrow is {longest:.2g} px",
    )
    axes.quiver(*((key[kept] + 0.5) * side).T, *means[kept].T, angles="xy", color="firebrick")
    return to_svg(figure)
