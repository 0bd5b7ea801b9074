"""Random cases by the thousand: `python -m benchmarks.stress.random_cases FILE [--cases N] [--stage
NAME]`.

`hypothesis` draws them in batches, each from its own seed. FILE takes one line of JSON a case;
batches that are whole there are not run again, so that a run can be ended at any time and taken up
later. Another version of hypothesis, or other modules beside it, draw other cases of the same seed:
rows that are wrong hold their case.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import lfcal

from .outcome import SURE, Outcome, calibrate_white, depth_of_plane, picture_of_plane
from .strategies import drawable_planes, lookalikes, planes, whites

__all__ = ["BATCH", "RARE", "STAGES", "main", "outcomes", "run_all", "summary"]

#: Confident and wrong answers must be rarer than this.
RARE = 1e-3
#: Cases of one seed. The first that hypothesis draws is the plainest of all.
BATCH = 25


def _refused(drawn: tuple[str, NDArray[Any]]) -> Outcome:
    try:
        camera = lfcal.calibrate(drawn[1])
    except lfcal.LightFieldError as refusal:
        return Outcome(0.0, np.nan, 0.0, str(refusal))
    return Outcome(
        1.0, np.nan, float(camera.confidence >= SURE), off=float(camera.confidence > 0.5)
    )


#: What is drawn for each stage, and what is done with it.
STAGES: dict[str, tuple[Callable[[], st.SearchStrategy[Any]], Callable[[Any], Outcome]]] = {
    "calibration": (whites, lambda drawn: calibrate_white(*drawn)),
    "lookalikes": (lookalikes, _refused),
    "depth": (planes, depth_of_plane),
    "rendering": (drawable_planes, picture_of_plane),
}


def outcomes(stage: str, batch: int, count: int = BATCH) -> list[tuple[str, Outcome]]:
    """Description and outcome of each case of that batch."""
    strategy, run = STAGES[stage]
    found: list[tuple[str, Outcome]] = []

    # Shrinking looks for the plainest failure; here all of them are counted.
    @seed(batch)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy())
    def draw(case: Any) -> None:
        with np.printoptions(threshold=10):
            found.append((repr(case), run(case)))

    draw()
    return found


def summary(rows: list[dict[str, Any]]) -> tuple[str, bool]:
    """One line about the cases of a stage, and whether wrong answers are rare enough."""
    off, answered = (np.array([row[name] for row in rows]) for name in ("off", "answered"))
    wrong = np.array([row["wrong"] for row in rows])
    line = (
        f"{len(rows):6d} random cases: answered {answered.mean():.1%}, confident and wrong "
        f"{off.mean():.3%} "
        f"({(off > 0).sum()} cases, {(off > 0.1).sum()} of them in more than a tenth), "
        f"by a twentieth of the pitch at {SURE:g}: {wrong.mean():.3%}"
    )
    return line, bool(off.mean() < RARE and wrong.mean() < RARE)


def _done(file: Path) -> dict[tuple[str, int], list[dict[str, Any]]]:
    """Rows of the batches that are whole."""
    rows: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            # A run that was killed ends in half a line.
            continue
        rows[entry["stage"], entry["batch"]] = entry["cases"]
    return rows


def run_all(file: Path, cases: int, stages: tuple[str, ...] = tuple(STAGES)) -> list[str]:
    """Run the batches that are not in `file`; gives the stages with too many wrong answers."""
    done = _done(file)
    for batch in range(-(-cases // BATCH)):
        for stage in stages:
            if (stage, batch) in done:
                continue
            rows = []
            for case, one in outcomes(stage, batch):
                kept = {
                    "answered": one.answered,
                    "error": one.error,
                    "wrong": one.wrong,
                    "off": one.off,
                }
                rows.append(kept | ({"case": case} if one.off or one.wrong else {}))
            done[stage, batch] = rows
            # One write, so that a line is whole or the last one; a new line first ends what a
            # killed run has left.
            with file.open("a", encoding="utf-8") as stream:
                stream.write(
                    "\n" + json.dumps({"stage": stage, "batch": batch, "cases": rows}) + "\n"
                )
    broken = []
    for stage in stages:
        line, rare = summary(
            [row for (of, number), rows in done.items() if of == stage for row in rows]
        )
        print(f"{stage:12} {line}", flush=True)
        if not rare:
            broken.append(f"{stage}: {line}")
    return broken


def main(arguments: list[str]) -> None:
    """Run random cases; exit with 1 if confident wrong answers are not rare."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stress.random_cases", description=__doc__
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--cases", type=int, default=10_000, help="of each stage")
    parser.add_argument("--stage", choices=list(STAGES), action="append")
    options = parser.parse_args(arguments)
    broken = run_all(options.file, options.cases, tuple(options.stage or STAGES))
    sys.exit("\n".join(broken) if broken else 0)


if __name__ == "__main__":
    main(sys.argv[1:])
