"""Gain of `detail="natural"` on random pictures: `python -m benchmarks.natural FIRST LAST`.

PSNR [dB] of the picture with `"off"`, and the gain of `"natural"`, for the random cameras and
scenes of `benchmarks.detail` with these seeds, at 0.15 and 0.3 pitches a pixel, with the depth that
is found. The reference is averaged over the area of an output pixel. The last lines are the mean
gain of each kind of scene, and how many pictures lose more than 0.1 dB.
"""

from __future__ import annotations

import sys
import warnings
from collections import defaultdict

import numpy as np

import lfrender
from lfcal import LightFieldError

from .coarse import measure_psnr
from .detail import random_case

__all__ = ["main"]

_SHARES = (0.15, 0.3)  # [pitch] per pixel
_SAMPLES = 40  # rays per pixel: the noise of the tracer lies below that of the sensor
_LOSS = 0.1  # [dB]


def main(first: int, last: int) -> None:
    """Print a row for each picture, and the summary."""
    warnings.simplefilter("ignore", UserWarning)
    gains: dict[str, list[list[float]]] = defaultdict(list)
    print("| scene | off [dB] | natural at 0.15 D | off [dB] | natural at 0.3 D |")
    print("|---|---|---|---|---|")
    for seed in range(first, last + 1):
        try:
            case = random_case(seed, samples=_SAMPLES)
            depth = lfrender.analyze(case.flat, case.camera)
        except LightFieldError as error:
            print(f"| {seed}: {error} |", flush=True)
            continue
        row = []
        cells = []
        for share in _SHARES:
            scale = share * case.camera.lattice.pitch
            off = measure_psnr(case, depth, scale, "off")
            row.append(measure_psnr(case, depth, scale, "natural") - off)
            cells.append(f"{off:.2f} | {row[-1]:+.2f}")
        kind = case.name.split(": ")[1].split(",")[0]
        gains[kind].append(row)
        print(f"| {case.name} | {' | '.join(cells)} |", flush=True)
    for kind, rows in sorted(gains.items()):
        table = np.array(rows)
        means = " / ".join(f"{gain:+.2f}" for gain in table.mean(0))
        least = " / ".join(f"{gain:+.2f}" for gain in table.min(0))
        print(f"{len(table)} of kind {kind}: {means} dB in the mean, {least} dB at least")
    whole = np.concatenate([np.array(rows) for rows in gains.values()])
    print(f"{(whole < -_LOSS).sum()} of {whole.size} pictures lose more than {_LOSS} dB")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
