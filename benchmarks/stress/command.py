"""The stress suite as a command: sweeps, random cases and damaged files."""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .file_faults import fuzz
from .outcome import Outcome, Sweep, calibrate_white, depth_of_plane
from .sweeps import random_plane, random_white, sweeps

__all__ = ["main", "of_random_cases", "quick_values"]

_FIELDS = ("value", "answered", "error px", "confident and wrong", "broken")


def quick_values(sweep: Sweep) -> tuple[float, ...]:
    """About a dozen of the values, both ends among them."""
    step = max(1, len(sweep.values) // 12)
    return tuple(dict.fromkeys((*sweep.values[::step], sweep.values[-1])))


def of_random_cases(stage: str, numbers: range) -> Iterator[tuple[int, Outcome]]:
    """Outcomes of the random cases of these numbers."""
    for number in numbers:
        if stage == "depth":
            yield number, depth_of_plane(random_plane(number))
        else:
            yield number, calibrate_white(*random_white(number))


def _plot(path: Path, sweep: Sweep, rows: list[tuple[float, Outcome]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    shares, errors = figure.subplots(2, sharex=True)
    x = [value for value, _ in rows]
    shares.plot(x, [one.answered for _, one in rows], marker=".", label="answered")
    shares.plot(x, [one.wrong for _, one in rows], marker=".", label="confident and wrong")
    errors.plot(x, [one.error for _, one in rows], marker=".", label="error [px]")
    errors.set(yscale="log", xlabel=f"{sweep.name} [{sweep.unit}]" if sweep.unit else sweep.name)
    for axes in (shares, errors):
        axes.grid(True)
        axes.legend()
        axes.axvspan(*np.clip(sweep.limits, min(x), max(x)), alpha=0.1)
    figure.savefig(path, dpi=80)


def main(arguments: list[str]) -> None:
    """Run the suite; exit with 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks stress", description=__doc__)
    parser.add_argument(
        "--full",
        action="store_true",
        help="all values, 10,000 random cases, 100 kills of each writer",
    )
    parser.add_argument("--cases", type=int, help="so many random cases of each stage")
    parser.add_argument(
        "--log", type=Path, help="file that keeps the random cases: a later run goes on from there"
    )
    parser.add_argument("--only", default="", help="sweeps whose name contains this")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        help="folder for CSV files, and plots where matplotlib is there",
    )
    options = parser.parse_args(arguments)
    broken = []
    for stage, several in sweeps().items():
        for sweep in several:
            if options.only not in f"{stage} {sweep.name}":
                continue
            values = sweep.values if options.full else quick_values(sweep)
            rows = [(value, sweep.run(value)) for value in values]
            wrong = [
                f"{value:g}: {sweep.broken(value, one)}"
                for value, one in rows
                if sweep.broken(value, one)
            ]
            broken += [f"{stage}, {sweep.name} {what}" for what in wrong]
            worst = max((one.wrong for _, one in rows), default=0.0)
            print(
                f"{stage:12} {sweep.name:18} {len(rows):4d} values, confident and wrong at most "
                f"{worst:.2%}, "
                f"limits {'broken at ' + '; '.join(wrong) if wrong else 'kept'}",
                flush=True,
            )
            if options.output:
                _write(options.output, stage, sweep, rows)
    if not options.only:
        broken += _random(options.cases or (10_000 if options.full else 25), options.log)
        broken += _files(1000 if options.full else 100, 100 if options.full else 20)
    sys.exit("\n".join(broken) if broken else 0)


def _write(folder: Path, stage: str, sweep: Sweep, rows: list[tuple[float, Outcome]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{stage}_{sweep.name.replace(' ', '_').replace('/', 'over')}.csv"
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(_FIELDS)
        for value, one in rows:
            table.writerow((value, one.answered, one.error, one.wrong, sweep.broken(value, one)))
    try:
        _plot(path.with_suffix(".png"), sweep, rows)
    except ImportError:
        print("no plots: pip install matplotlib")


def _random(cases: int, log: Path | None) -> list[str]:
    from .random_cases import run_all

    if log is not None:
        return run_all(log, cases)
    with tempfile.TemporaryDirectory() as folder:
        return run_all(Path(folder) / "cases.jsonl", cases)


def _files(damages: int, kills: int) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        tried, faults = fuzz(Path(folder), range(damages))
        print(f"files        {tried} damaged files, {len(faults)} not refused in order", flush=True)
        broken = [str(fault) for fault in faults]
        # In processes of their own: the memory of one is measured, the other must have no threads.
        for module, number in (("file_values", damages), ("write_faults", kills)):
            command = [sys.executable, "-m", f"benchmarks.stress.{module}"]
            command += [str(Path(folder) / module), str(number)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            print(f"files        {module}, {number} each: {done.stdout.strip()}", flush=True)
            if done.returncode:
                broken.append(done.stdout + done.stderr)
    return broken
