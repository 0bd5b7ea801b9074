"""The report of a metric calibration, and its advice."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from lfcal import Board, BoardPose, Calibration, Lattice, MetricCalibration
from lfcal.metric.bundle_adjustment import BASE, Observations, adjust
from lfcal.metric.uncertainty import optics_of
from lfcal.metric_report.next_pose import suggest_poses
from lfcal.metric_report.report import write_metric_report


@pytest.fixture(scope="module")
def found():
    """Four boards far away, seen by the model itself with 0.02 px of noise."""
    import importlib.util
    from pathlib import Path

    place = Path(__file__).parents[1] / "metric" / "_cameras.py"
    spec = importlib.util.spec_from_file_location("metric_test_cameras", place)
    cameras = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(cameras)
    rng = np.random.default_rng(2)
    where = cameras.poses(rng, 5, near=700, far=1100)
    values = cameras.camera(k1=-0.5)
    seen = cameras.observe(values, where, rng, 0.02)
    seen = Observations(
        seen.pose, seen.corner, seen.centre, seen.position, np.full(len(seen), 0.02)
    )
    fitted = adjust(values, cameras.PIXEL, where, cameras.BOARD, seen, BASE)
    lattice = Lattice((0, 0), [[28.3, 0], [14.15, 24.5]], (1600, 1200), 13.0)
    errors = np.sqrt(np.diag(fitted.covariance))[14:-5].reshape(-1, 6)
    board = Board(9, 6, 7.0)
    placed = tuple(
        BoardPose(f"{m}.png", r, t - r @ board.middle, np.diag(errors[m] ** 2), 0.03, 100)
        for m, (r, t) in enumerate(
            zip(fitted.poses.rotation, fitted.poses.translation, strict=True)
        )
    )
    optics = optics_of(fitted, cameras.PIXEL)
    return MetricCalibration(
        replace(Calibration(lattice), optics=optics),
        board,
        placed,
        fitted.free,
        seen,
        fitted.residual,
        fitted.weight > 0,
        0.02,
        1.0,
        ("F and L hardly separate <&>",),
        (),
    )


def test_the_page_shows_errors_poses_residuals_and_advice_without_network(found, tmp_path):
    write_metric_report(tmp_path / "page.html", found)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for words in (
        "focal length",
        "Cramer-Rao",
        "hardly separate &lt;&amp;&gt;",
        "2 sigma",
        "What to shoot next",
    ):
        assert words in page
    assert page.count('id="pose-') == 10  # five boards from above and from the side
    assert not re.search(
        r"""(src|href)=["']https?:""",
        re.sub(r"<metadata>.*?</metadata>", "", page, flags=re.DOTALL),
    )


def test_values_stand_beside_their_errors_and_none_is_a_negative_zero(found, tmp_path):
    write_metric_report(tmp_path / "page.html", found)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert re.search(r"<td>focal length</td><td>\d+\.\d+ \u00b1 \d", page)
    assert "+-" not in page and "e+0" not in page
    assert not re.search(r"<td>-0\.0+( %)?</td>", page)
    # Each row has the colour of its board, and text of the drawings can be read at 390 px.
    colours = re.findall(r"--colour:(#\w{6})", page)
    assert len(set(colours)) == 5 and all(f"stroke: {colour}" in page for colour in colours)
    widths = [float(width) for width in re.findall(r'<svg[^>]*? width="([\d.]+)pt"', page)]
    assert widths and max(widths) < 330


def test_boards_far_away_ask_for_a_near_one(found):
    first, *_ = suggested = suggest_poses(found)
    assert len(set(suggested)) == 3
    assert first[0] < min(pose.translation[2] for pose in found.poses)
