"""Time, memory and error of `lfcal.calibrate` on large white images: `python -m
benchmarks.calibration_speed [--giga]`.

Each image is calibrated in a process of its own, four times where it is small enough: the median of
the last three counts, and compiling does not. Memory is the peak of the whole process, the flat
included.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

import lfcal

from .white_images import WhiteImage

__all__ = ["drawn", "error_of_some", "main"]

_SIZES = {"3": (2000, 1500), "12": (4000, 3000), "48": (8000, 6000), "542": (24862, 21818)}
# Megapixels, shape, pitch [px], channels, bits, and where microimages are cut how strongly
# (`WhiteImage.strength`).
_CASES = [
    ("3", "hexagonal", "14.3", "1", "8"),
    ("12", "hexagonal", "6.3", "1", "8"),
    ("12", "hexagonal", "14.3", "1", "8"),
    ("12", "hexagonal", "14.3", "3", "8"),
    ("12", "square", "35.4", "1", "16"),
    ("12", "hexagonal", "70.4", "1", "8"),
    ("48", "hexagonal", "14.3", "1", "8"),
    ("3", "hexagonal", "9.97", "1", "8", "0.3"),
    ("12", "hexagonal", "9.97", "1", "8", "0.3"),
    ("12", "hexagonal", "14.3", "1", "8", "-0.3"),
    ("12", "square", "35.4", "1", "16", "0.3"),
    ("12", "hexagonal", "70.4", "1", "8", "-0.3"),
]
_GIGA = [
    ("542", "hexagonal", "75", "1", "8"),
    ("542", "hexagonal", "75", "3", "8"),
    ("542", "hexagonal", "20", "3", "8"),
    ("542", "square", "12", "1", "16"),
    ("542", "hexagonal", "6.1", "3", "8"),
]
_SOME = 200_000
# Of so many calibrations, after one that compiles and finds memory, the median time counts.
_RUNS = 3


@njit(cache=True, nogil=True, parallel=True)
def _draw(origin, basis, inverse, radius, gap, inner, outer, noise, full, out):
    height, width, channels = out.shape
    for y in prange(height):
        state = np.uint32(y * 2654435761 + 12345)
        for x in range(width):
            wx = x - origin[0]
            wy = y - origin[1]
            i0 = np.floor(wx * inverse[0, 0] + wy * inverse[1, 0])
            j0 = np.floor(wx * inverse[0, 1] + wy * inverse[1, 1])
            near = 1e30
            for corner in range(4):
                i = i0 + corner % 2
                j = j0 + corner // 2
                dx = wx - i * basis[0, 0] - j * basis[1, 0]
                dy = wy - i * basis[0, 1] - j * basis[1, 1]
                near = min(near, dx * dx + dy * dy)
            disc = min(max(radius - np.sqrt(near) + 0.5, 0.0), 1.0) * (
                1 - inner * near / (radius * radius)
            )
            field = ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2) * 2
            chance = 0.0
            for _ in range(4):
                state = np.uint32(state * np.uint32(1664525) + np.uint32(1013904223))
                chance += state / 4294967296.0 - 0.5
            # The sum of four even chances has a standard deviation of the root of a third.
            light = (gap + (1 - gap) * disc) * (1 - outer * field) + noise * chance / np.sqrt(1 / 3)
            for c in range(channels):
                out[y, x, c] = min(max(0.8 * light * full + 0.5, 0.0), full)


def drawn(truth: WhiteImage, channels: int) -> NDArray[Any]:
    """(h, w) or (h, w, 3) white image drawn in place, its edges one pixel wide; no defects, cut or
    distortion.
    """
    width, height = truth.size
    kind: Any = np.uint8 if truth.bits == 8 else np.uint16
    out = np.empty((height, width, channels), kind)
    radius = truth.fill * np.hypot(*(np.array([(1, 0), (0, 1), (1, -1)]) @ truth.basis).T).min() / 2
    _draw(
        truth.origin,
        truth.basis,
        np.linalg.inv(truth.basis),
        radius,
        truth.gap,
        truth.inner,
        truth.outer,
        truth.noise,
        float(2**truth.bits - 1),
        out,
    )
    return out[..., 0] if channels == 1 else out


def error_of_some(camera: lfcal.Calibration, truth: WhiteImage) -> float:
    """RMS distance [px] of evenly spread centres from the true ones; inf for a wrong lattice."""
    found = camera.lattice.centres()
    found = found[:: max(1, len(found) // _SOME)]
    if abs(abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(truth.basis)) - 1) > 0.05:
        return float("inf")
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


def _measure(
    megapixels: str, shape: str, pitch: str, channels: str, bits: str, cut: str = "0"
) -> None:
    """Print one line of the table."""
    import resource

    truth = WhiteImage(
        shape, float(pitch), 3.0, 26.0, int(bits), float(cut), size=_SIZES[megapixels]
    )
    small = replace(truth, pitch=14.3, size=(1000, 750))
    lfcal.calibrate(small.image() if truth.strength else drawn(small, int(channels)))
    image = truth.image() if truth.strength else drawn(truth, int(channels))
    times = []
    for _ in range(1 if megapixels == "542" else 1 + _RUNS):
        wall = time.perf_counter()
        spent = time.process_time()
        camera = lfcal.calibrate(image)
        times.append((time.perf_counter() - wall, time.process_time() - spent))
    wall, spent = np.median(times[-_RUNS:], axis=0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        2**30 if sys.platform == "darwin" else 2**20
    )
    colour = {"3": "RGB"}.get(channels, "grey")
    kind = f"{shape[:3]} {pitch} px, {colour} {bits} bit{' cut' * bool(truth.strength)}"
    print(
        f"{megapixels:>4s} {kind:28s} {wall:7.2f} {spent:7.2f} {peak:8.2f} "
        f"{image.nbytes / 2**30:8.2f} "
        f"{error_of_some(camera, truth):9.5f} {camera.source}",
        flush=True,
    )


def main(arguments: list[str]) -> None:
    """Print the table; with `--giga` of 542-megapixel images, which need 4 GB."""
    if arguments and arguments[0] == "--one":
        _measure(*arguments[1:])
        return
    print(
        f"{'Mpx':>4s} {'image':28s} {'wall s':>7s} {'CPU s':>7s} {'peak GiB':>8s} "
        f"{'flat GiB':>8s} {'error px':>9s}",
        flush=True,
    )
    for case in _GIGA if "--giga" in arguments else _CASES:
        subprocess.run(
            [sys.executable, "-m", "benchmarks.calibration_speed", "--one", *case], check=True
        )


if __name__ == "__main__":
    main(sys.argv[1:])
