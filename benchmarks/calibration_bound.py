"""Errors of `lfcal.calibrate` on white images beside the Cramer-Rao bound: `python -m benchmarks.calibration_bound`."""

from __future__ import annotations

import sys
import time

import numpy as np

import lfcal

from .white_images import WhiteImage, standard_cases

__all__ = ["centre_error", "main"]


def centre_error(camera: lfcal.Calibration, truth: WhiteImage) -> float:
    """RMS distance [px] of the found centres from the true ones; infinite for a wrong lattice."""
    found = camera.lattice.centres()
    index = truth.index_of(found)
    distinct = len(np.unique(index, axis=0)) == len(found)
    if not distinct or abs(abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(truth.basis)) - 1) > 0.05:
        return float("inf")
    return float(np.sqrt(((found - truth.centres(index)) ** 2).sum(1).mean()))


def main(chosen: str = "") -> None:
    """Print a table over the standard cases whose name contains `chosen`."""
    print(f"{'case':36s} {'bound px':>9s} {'error px':>9s} {'ratio':>7s} {'s':>5s} kind")
    for name, truth in standard_cases().items():
        if chosen not in name:
            continue
        image = truth.image()
        start = time.perf_counter()
        try:
            camera = lfcal.calibrate(image)
        except lfcal.LightFieldError as error:
            print(f"{name:36s} {error}")
            continue
        spent = time.perf_counter() - start
        bound, error_px = truth.bound(), centre_error(camera, truth)
        print(
            f"{name:36s} {bound:9.6f} {error_px:9.6f} {error_px / bound:7.1f} {spent:5.2f} {camera.source}", flush=True
        )


if __name__ == "__main__":
    main(" ".join(sys.argv[1:]))
