"""Errors of `lfcal.calibrate` on white images, compared with the Cramer-Rao bound.

`python -m benchmarks.calibration_bound` measures the standard cases, or those whose name contains
an argument. `--random N [SEED]` measures N random cases, `--cut N [SEED]` cut ones with other
edges. A row ends with `beyond` if the error exceeds its promised limit, and with `doubt` if the
calibration warns that another disc may be the lens.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import lfcal

from .white_images import WhiteImage, cut_cases, random_cases, standard_cases

__all__ = ["centre_error", "main"]


def centre_error(camera: lfcal.Calibration, truth: WhiteImage) -> float:
    """RMS distance [px] of the found centres from the true ones; infinite for a wrong lattice."""
    found = camera.lattice.centres()
    index = truth.index_of(found)
    distinct = len(np.unique(index, axis=0)) == len(found)
    if (
        not distinct
        or abs(abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(truth.basis)) - 1)
        > 0.05
    ):
        return float("inf")
    return float(np.sqrt(((found - truth.centres(index)) ** 2).sum(1).mean()))


def promised(truth: WhiteImage, bound: float) -> float:
    """Largest promised error of the centres [px], from the Cramer-Rao bound `bound` [px]."""
    if truth.strength:
        return 0.02 if truth.decibels >= 26 else 0.05
    if truth.k1:
        return 0.02
    return min(3 * bound, 0.005) if truth.decibels >= 26 else 3 * bound


def main(arguments: list[str]) -> None:
    """Print a table; exit with 1 if an error exceeds its promised limit."""
    if arguments[:1] in (["--random"], ["--cut"]):
        cases = (random_cases if arguments[0] == "--random" else cut_cases)(
            int(arguments[1]), int(arguments[2]) if len(arguments) > 2 else 0
        )
    else:
        cases = {
            name: truth for name, truth in standard_cases().items() if " ".join(arguments) in name
        }
    beyond = 0
    print(
        f"{'case':48s} {'bound px':>9s} {'error px':>9s} {'ratio':>7s} {'stated':>9s} {'s':>5s} "
        f"kind"
    )
    for name, truth in cases.items():
        image = truth.image()
        bound = truth.bound()
        start = time.perf_counter()
        try:
            camera = lfcal.calibrate(image)
        except lfcal.LightFieldError as error:
            beyond += 1
            print(f"{name:48s} beyond: {error}", flush=True)
            continue
        spent = time.perf_counter() - start
        error_px = centre_error(camera, truth)
        errors = camera.errors
        stated = (
            np.nan
            if errors is None
            else float(np.sqrt((errors.of_centres(camera.lattice) ** 2).mean()))
        )
        doubtful = any("overlap of two discs" in text for text in camera.warnings)
        missed = not error_px <= promised(truth, bound)
        beyond += missed
        print(
            f"{name:48s} {bound:9.6f} {error_px:9.6f} {error_px / bound:7.1f} {stated:9.6f} "
            f"{spent:5.2f} "
            f"{camera.source}{'  beyond' if missed else ''}{'  doubt' if doubtful else ''}",
            flush=True,
        )
    print(f"{beyond} of {len(cases)} beyond what is promised")
    sys.exit(bool(beyond))


if __name__ == "__main__":
    main(sys.argv[1:])
