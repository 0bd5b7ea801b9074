"""Comparison of results without special processor instructions.

`python -m benchmarks.stress.other_processor`.

Kernels are compiled without the instructions that only this processor has, into another folder.
This takes minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender

from ..white_images import WhiteImage
from .plane_flats import PlaneFlat

__all__ = ["LIMIT", "differences", "main", "results"]

#: Results may differ by so much, relative to the largest of their kind.
LIMIT = 1e-5


def results() -> dict[str, NDArray[np.float64]]:
    """Centres of a small white image, and depth and picture of a small slanted plane, by name."""
    white = WhiteImage(pitch=14.3, degrees=3.0, decibels=30, bits=8, size=(260, 200))
    # Of whole grey levels one more or less would be a difference.
    plane = PlaneFlat(ratio=0.3, slant=(0.8, -0.5), noise=0.01, size=(220, 180), kind="f4")
    depth = lfrender.analyze(plane.flat(), plane.calibration)
    picture = lfrender.render(plane.flat(), plane.calibration, depth)
    return {
        "centres": lfcal.calibrate(white.image()).lattice.centres(),
        "patch sizes": np.nan_to_num(depth.patch_size.astype(float)),
        "confidence": depth.confidence.astype(float),
        "picture": picture.image.astype(float),
    }


def differences(
    ours: dict[str, NDArray[np.float64]], theirs: dict[str, NDArray[np.float64]]
) -> dict[str, float]:
    """Largest difference by name, over the largest value; infinite where shapes differ."""
    return {
        name: float(np.abs(values - theirs[name]).max() / np.abs(values).max())
        if values.shape == theirs[name].shape
        else float("inf")
        for name, values in ours.items()
    }


def main() -> None:
    """Print the differences; exit with 1 if one is too large."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "theirs.npz"
        environment = os.environ | {
            "NUMBA_CPU_NAME": "generic",
            "NUMBA_CPU_FEATURES": "",
            "NUMBA_CACHE_DIR": folder,
        }
        code = "import sys, numpy; from benchmarks.stress.other_processor import results; "
        code += "numpy.savez(sys.argv[1], **results())"
        subprocess.run([sys.executable, "-c", code, str(file)], env=environment, check=True)
        with np.load(file) as theirs:
            found = differences(results(), dict(theirs))
    for name, value in found.items():
        print(f"{name:12} differ by {value:.1e} at most")
    sys.exit(any(not value <= LIMIT for value in found.values()))


if __name__ == "__main__":
    main()
