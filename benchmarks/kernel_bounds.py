"""Time of each kernel of an analysis, compared with moving the same pixels.

`python -m benchmarks.kernel_bounds [FLAT ...]`

The table shows the processor time on one thread of each kernel of `lfrender.analyze` [ms], its
share, and nanoseconds per pixel of the flat. For comparison it shows a `memcpy` of the grey flat
(float32), and `cv2.resize` of it to as many pixels minus one row and column. The time of some
kernels depends on the texture and the edges of the scene.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from lfcal.runtime import kernels

__all__ = ["main"]

_CAPTURE = Path(__file__).parents[1].parent / "shared" / "captures" / "Fujita2.png"


def _least(call: Callable[[], Any], runs: int) -> float:
    """Least processor time of several calls [s]."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def _measure(flat: NDArray[Any], preset: Any, runs: int) -> tuple[float, dict[str, float]]:
    """Processor time of an analysis and of each kernel in it [s]; the fastest of several runs."""
    camera = lfcal.calibrate(flat)
    every: list[tuple[float, dict[str, float]]] = []
    share_out = kernels.share_out
    spent: dict[str, float] = defaultdict(float)

    def timed(kernel: Any, items: int, arguments: tuple[Any, ...]) -> None:
        start = time.process_time()
        share_out(kernel, items, arguments)
        spent[kernel.py_func.__name__] += time.process_time() - start

    kernels.share_out = timed
    try:
        for _ in range(runs + 1):
            spent.clear()
            total = _least(lambda: lfrender.analyze(flat, camera, preset), 1)
            every.append((total, dict(spent)))
    finally:
        kernels.share_out = share_out
    return min(every[1:], key=lambda run: run[0])


def _move_pixels(height: int, width: int, runs: int) -> dict[str, float]:
    """Processor time [s] to copy and to resample bilinearly an image of 32-bit pixels."""
    gray = np.random.default_rng(0).random((height, width), np.float32)
    out = np.empty_like(gray)
    return {
        "memcpy": _least(lambda: np.copyto(out, gray), runs),
        "cv2.resize": _least(lambda: cv2.resize(gray, (width - 1, height - 1)), runs),
    }


def main() -> None:
    """Print a table for each flat."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flats", nargs="*", type=Path, default=[_CAPTURE])
    parser.add_argument("--preset", default="balanced")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    numba.set_num_threads(1)
    cv2.setNumThreads(1)
    for path in options.flats:
        flat = lfcal.read_flat(path)
        total, spent = _measure(flat, options.preset, options.runs)
        moves = _move_pixels(flat.shape[0], flat.shape[1], options.runs)
        print(
            f"{path.name}, {flat.shape[1]} x {flat.shape[0]}, {options.preset}: {1e3 * total:.0f} "
            f"ms"
        )
        print(f"{'':28}{'ms':>9}{'share':>8}{'ns/px':>8}")
        rows = [
            *sorted(spent.items(), key=lambda item: -item[1]),
            ("outside kernels", total - sum(spent.values())),
        ]
        for name, seconds in [*rows, *moves.items()]:
            share = "" if name in moves else f"{seconds / total:7.1%}"
            print(
                f"{name:28}"
                f"{1e3 * seconds:9.1f}"
                f"{share:>8}{1e9 * seconds / (flat.shape[0] * flat.shape[1]):8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
