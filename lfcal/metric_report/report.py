"""One HTML page about a metric calibration, which needs no network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

import numpy as np

from ..camera.optics import OPTICS_PARAMETERS
from ..metric.result import MetricCalibration
from ..runtime.output_file import atomic_write, check_output
from .figures import draw_field, draw_poses
from .next_pose import suggest_poses

__all__ = ["write_metric_report"]

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; } td, th { padding: .2rem .9rem; text-align: right; }
th { border-bottom: 1px solid #999; } td:first-child, th:first-child { text-align: left; white-space: nowrap; }
svg { max-width: 100%; height: auto; } .note { color: #555; }
"""


def write_metric_report(
    path: str | os.PathLike[str], found: MetricCalibration, *, title: str = "Metric camera"
) -> None:
    """Write the report of a metric calibration as one HTML file; it appears whole or not at all."""
    check_output(path, {".html"})
    near, far = (f(pose.translation[2] for pose in found.poses) / 1000 for f in (min, max))
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{len(found.poses)} flats of a {escape(str(found.board))}, squares of {found.board.square:g} mm, at "
        f"{near:.3g} to {far:.3g} m; {int(found.used.sum())} corners in single microimages, "
        f"{int((~found.used).sum())} outliers; RMS distance {found.rms:.4f} px.</p>",
        "<h2>Optics</h2>",
        _parameters(found),
        *(f'<p class="note">{escape(note)}.</p>' for note in (*found.warnings, *found.degeneracies)),
        "<h2>Poses of the boards</h2>",
        draw_poses(found),
        _poses_table(found),
        "<h2>Residuals over the field</h2>",
        draw_field(found),
        "<p>Mean residuals of tiles. Arrows that point the same way over a region tell of errors that the model does "
        "not hold.</p>",
        "<h2>Residuals over distance</h2>",
        _depth_table(found),
        "<h2>Reliability of the stated errors</h2>",
        _reliability(found),
        "<h2>What to shoot next</h2>",
        _next(found),
    ]
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>{cells}</table>"


def _parameters(found: MetricCalibration) -> str:
    optics, rows = found.optics, []
    for name, value, error in zip(OPTICS_PARAMETERS, optics.parameters, optics.standard_errors, strict=True):
        if error > 0:
            unit = "mm" if name.endswith(("length", "distance", "pupil")) else "px" if "principal" in name else ""
            if name.startswith("tilt"):
                value, error, unit = np.rad2deg(value), np.rad2deg(error), "degrees"
            rows.append((name.replace("_", " "), f"{value:.6g}", f"{error:.2g}", unit))
    focal = enumerate(optics.microlens_focal_lengths)
    rows += [(f"focal length of lens type {k}", f"{f:.5g}", "", "mm") for k, f in focal]
    return _table(("", "value", "standard error", ""), rows)


def _poses_table(found: MetricCalibration) -> str:
    rows = []
    for pose in found.poses:
        errors, tilt = pose.standard_errors, np.rad2deg(np.arccos(np.clip(pose.rotation[2, 2], -1, 1)))
        figures = (
            f"{pose.translation[2]:.2f}", f"{errors[5]:.3f}", f"{np.hypot(*errors[3:5]):.3f}",
            f"{np.rad2deg(np.linalg.norm(errors[:3])):.4f}", f"{errors[5] / np.sqrt(found.widening):.3f}",
            f"{tilt:.1f}", f"{pose.rms:.4f}", str(pose.observations),
        )  # fmt: skip
        rows.append((pose.name, *figures))
    head = ("flat", "distance [mm]", "+-", "sideways +-", "turn +- [deg]", "Cramer-Rao bound of the distance")
    return _table((*head, "tilt [deg]", "RMS [px]", "corners"), rows)


def _depth_table(found: MetricCalibration) -> str:
    rows = []
    for m in np.argsort([pose.translation[2] for pose in found.poses]):
        mine = (found.observations.pose == m) & found.used
        mean = found.residual[mine].mean(0)
        # Along the baseline: a wrong patch size moves corners away from, or towards, the middle of the lenses.
        offset = found.observations.position[mine] - found.observations.centre[mine]
        stretch = 100 * float((offset * found.residual[mine]).sum() / max((offset**2).sum(), 1e-12))
        pose, shift = found.poses[m], f"{mean[0]:+.4f}, {mean[1]:+.4f}"
        rows.append((f"{pose.translation[2]:.1f}", f"{pose.rms:.4f}", shift, f"{stretch:+.4f} %"))
    return _table(("distance [mm]", "RMS [px]", "mean [px]", "residual patch size"), rows)


def _reliability(found: MetricCalibration) -> str:
    scale = found.noise / float(np.median(found.observations.error))
    distance = np.hypot(*found.residual.T) / (found.observations.error * scale)
    rows = [
        (f"{k} sigma", f"{100 * (distance < k).mean():.1f} %", f"{100 * (1 - np.exp(-k * k / 2)):.1f} %")
        for k in (1, 2, 3)
    ]
    return (
        _table(("corners within", "measured", "expected"), rows)
        + f"<p>Noise of one corner in one microimage, one axis: {found.noise:.4f} px. Variances of all stated errors "
        f"are widened by {found.widening:.2f}, for errors that microimages of a corner and corners of a pose share: "
        "1 is independent noise. The Cramer-Rao bound is the stated error without that.</p>"
    )


def _next(found: MetricCalibration) -> str:
    items = [
        f"<li>at {distance / 1000:.3g} m, {where} of the field, {how}</li>"
        for distance, where, how in suggest_poses(found)
    ]
    if not items:
        return "<p>The board does not fit elsewhere into the field.</p>"
    return f"<p>The poses that make distances surest, the best first:</p><ol>{''.join(items)}</ol>"
