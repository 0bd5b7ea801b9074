"""Differences of lattices from flats of one camera.

`python -m benchmarks.scene_agreement FLAT FLAT ...`

Each flat is calibrated separately. The table holds the RMS distance of the centres of any two of
them over the field [px], the last column the longest distance of one flat's centres from those of
any other. Flats are image files, or arrays (.npy) as PyAV makes them of a video (`pip install av`
in an environment of its own):

    import av, numpy as np
    for number, frame in enumerate(av.open("Fujita2.vvc", format="vvc").decode(video=0)):
        if number % 30 == 0:
            np.save(f"frame_{number:03d}.npy", frame.to_ndarray(format="rgb24"))
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal

__all__ = ["differences", "main"]


def differences(
    cameras: list[lfcal.Calibration],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, n) RMS and (n, n) longest distance of the centres of any two cameras [px]."""
    rms, longest = np.zeros((2, len(cameras), len(cameras)))
    for a in range(len(cameras)):
        for b in range(a):
            apart = lfcal.compare(cameras[a], cameras[b])
            rms[a, b] = rms[b, a] = apart.rms
            longest[a, b] = longest[b, a] = apart.max
    return rms, longest


def _flat(path: Path) -> NDArray[Any]:
    pixels: NDArray[Any] = (
        np.load(path, allow_pickle=False) if path.suffix == ".npy" else lfcal.read_flat(path)
    )
    return pixels


def main(paths: list[Path]) -> None:
    """Print the table and its figures for two flats or more."""
    if len(paths) < 2:
        sys.exit("give two flats of one camera or more")
    rms, longest = differences([lfcal.calibrate(_flat(path)) for path in paths])
    width = max(len(path.stem) for path in paths)
    for path, row, far in zip(paths, rms, longest.max(1), strict=True):
        print(
            f"{path.stem:{width}} " + " ".join(f"{value:6.3f}" for value in row) + f"  {far:6.3f}"
        )
    pairs = rms[np.triu_indices(len(paths), 1)]
    print(
        f"RMS of {len(pairs)} pairs: median {np.median(pairs):.3f}, largest {pairs.max():.3f} px;"
        f" {(pairs <= 0.1).sum()} within 0.1 px; longest distance {longest.max():.3f} px"
    )


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
