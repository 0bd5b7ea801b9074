"""Measure run time against error and write the numbers, as CSV and JSON, and plots of them."""

from __future__ import annotations

import argparse
import csv
import json
import platform
import subprocess
import sys
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from .measure import Row, measure

__all__ = ["about", "main", "write"]

_PACKAGES = (
    "lfrender",
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "plenopticam",
    "plenpy",
)
# What is plotted against time, and whether more of it is better.
_ERRORS = {
    "calibration": ("centre RMS px", False),
    "analysis": ("s median px", False),
    "rendering": ("PSNR dB", True),
}


def about() -> dict[str, Any]:
    """Machine, versions and commit of the figures."""
    versions: dict[str, str | None] = {}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    commit = subprocess.run(
        ["git", "rev-parse", "HEAD"],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
        check=False,
    )
    return {
        "machine": {
            "system": platform.platform(),
            "processor": _processor(),
            "python": platform.python_version(),
        },
        "versions": versions,
        "commit": commit.stdout.strip() or None,
        "time": "CPU time of one thread",
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        "unknown",
    )


def write(folder: Path, rows: list[Row]) -> None:
    """Write results.json and results.csv, and with matplotlib one plot for each stage."""
    folder.mkdir(parents=True, exist_ok=True)
    result = {**about(), "rows": [asdict(row) for row in rows]}
    (folder / "results.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    names = list(dict.fromkeys(name for row in rows for name in row.errors))
    with (folder / "results.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["stage", "method", "case", "s per megapixel", "cv2.remap", *names, "note"])
        for row in rows:
            figures = [f"{row.errors[name]:.5g}" if name in row.errors else "" for name in names]
            times = (f"{row.seconds_per_megapixel:.4g}", f"{row.remaps:.4g}")
            table.writerow([row.stage, row.method, row.case, *times, *figures, row.note])
    try:
        _plot(folder, rows)
    except ImportError:
        print("no plots: pip install matplotlib")


def _plot(folder: Path, rows: list[Row]) -> None:
    """One plot for each stage: the mean over the cases of time and error of each method, with the
    front drawn.
    """
    from matplotlib.figure import Figure

    for stage, (error, more) in _ERRORS.items():
        points = {}
        for method in dict.fromkeys(row.method for row in rows if row.stage == stage):
            found = [row for row in rows if (row.stage, row.method) == (stage, method)]
            figures = np.array([(row.remaps, row.errors.get(error, np.nan)) for row in found])
            if np.isfinite(figures).all():
                points[method] = np.exp(np.log(figures[:, 0]).mean()), figures[:, 1].mean()
        figure = Figure(figsize=(7, 4.5), layout="constrained")
        axes = figure.subplots()
        for method, (x, y) in points.items():
            axes.plot(x, y, "s" if method.startswith("baseline") else "o", color=None)
            axes.annotate(method, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
        best = [
            (x, y)
            for x, y in points.values()
            if not any(
                a <= x and (b >= y if more else b <= y) and (a, b) != (x, y)
                for a, b in points.values()
            )
        ]
        axes.plot(*np.array(sorted(best)).T, ":", color="grey", label="front")
        axes.set(
            xscale="log",
            xlabel="CPU time over that of cv2.remap of the flat",
            ylabel=error,
            title=stage,
        )
        if not more:
            axes.set_yscale("log")
        axes.margins(x=0.2)
        axes.grid(True, alpha=0.4)
        axes.legend()
        figure.savefig(folder / f"{stage}.png", dpi=80)


def main(arguments: list[str]) -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks run", description=__doc__)
    parser.add_argument(
        "--full", action="store_true", help="scenes of a megapixel, with three lens types as well"
    )
    parser.add_argument("--quick", action="store_true", help="small scenes (the default)")
    parser.add_argument(
        "--truth", type=Path, help="folder of ray-traced flats to measure on as well"
    )
    parser.add_argument(
        "--peers",
        default=sys.executable,
        metavar="PYTHON",
        help="that may have plenopticam and plenpy",
    )
    parser.add_argument("--runs", type=int, default=2, help="repetitions of each measurement")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("benchmark-results"), help="folder to write to"
    )
    options = parser.parse_args(arguments)
    import cv2
    import numba

    from .cases import of_folder, simulated
    from .peers import measure_peers

    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    cases = chain(simulated(options.full), of_folder(options.truth) if options.truth else ())
    rows = []
    for row in chain(
        chain.from_iterable(measure(case, options.runs) for case in cases),
        measure_peers(options.peers),
    ):
        rows.append(row)
        figures = ", ".join(f"{name} {value:.4g}" for name, value in row.errors.items()) or row.note
        print(
            f"{row.stage:12}{row.method:34}{row.case:18}{row.seconds_per_megapixel:8.3f} s/Mpx"
            f"{row.remaps:9.1f} remaps  {figures}",
            flush=True,
        )
    if not any(row.stage == "peers" for row in rows):
        print(f"neither plenopticam nor plenpy is installed for {options.peers}: not measured")
    write(options.output, rows)
