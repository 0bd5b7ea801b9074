"""Whether `confidence` is the share of right depths: `python -m benchmarks.reliability [FIRST LAST
[../shared/truth]]`.

The table shows, for each range of the confidence, its mean and the share of lenses whose depth is
right to 0.04 pitches. The lenses come from random scenes (`benchmarks.random_scenes`) and from
flats of another ray tracer in a folder. Lenses that see two depths are left out. Unresolved lenses
are judged by the depth of the surface.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import lfcal
import lfrender

from .random_scenes import draw

__all__ = ["compare", "diagram", "main"]

_SEEDS = (0, 20)
_SAMPLES = 32
# [pitch] errors that are right; lenses are those of the truth that are nearer than this.
_RIGHT = 0.04
_SAME = 0.25
_RANGES = np.array([0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0])


def compare(
    flat: NDArray, centres: NDArray, patch_size: NDArray, mixed: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(n,) confidence, and whether the depth is right, of the lenses whose truth is known."""
    camera = lfcal.calibrate(flat)
    depth = lfrender.analyze(flat, camera)
    apart, near = cKDTree(centres).query(camera.lattice.centres())
    judged = (apart < _SAME * camera.lattice.pitch) & ~mixed[near] & np.isfinite(patch_size[near])
    found = np.where(depth.mode != 0, depth.patch_size, depth.filled_patch_size)
    right = np.abs(found - patch_size[near]) < _RIGHT * camera.lattice.pitch
    return depth.confidence[judged], right[judged]


def diagram(confidence: NDArray[np.float32], right: NDArray[np.bool_]) -> str:
    """Number of lenses, mean confidence and share of right depths for each range."""
    rows = []
    place = np.digitize(confidence, _RANGES[1:-1])
    for n in range(len(_RANGES) - 1):
        among = place == n
        if among.any():
            stated = confidence[among].mean()
            true = right[among].mean()
            rows.append(
                f"{_RANGES[n]:.2f} to {_RANGES[n + 1]:.2f} {among.sum():7d}  {stated:.3f} "
                f"{true:.3f}"
            )
    weight = np.bincount(place, minlength=len(_RANGES) - 1) / len(place)
    gaps = [
        abs(confidence[place == n].mean() - right[place == n].mean()) * weight[n]
        for n in np.unique(place)
    ]
    return "\n".join([*rows, f"mean difference {sum(gaps):.4f}"])


def main(arguments: list[str]) -> None:
    first, last = (int(v) for v in arguments[:2]) if len(arguments) > 1 else _SEEDS
    pooled = []
    for seed in range(first, last):
        _, capture = draw(seed, _SAMPLES)
        truth = capture.truth
        pooled.append(
            compare(
                capture.flat, truth.calibration.lattice.centres(), truth.patch_size, truth.mixed
            )
        )
    if pooled:
        print(diagram(*(np.concatenate(part) for part in zip(*pooled, strict=True))), flush=True)
    for folder in sorted(Path(arguments[2]).iterdir()) if len(arguments) > 2 else []:
        if folder.is_dir():
            truth = np.load(folder / "microlenses.npz")
            flat = lfcal.read_flat(folder / "flat.png")
            print(f"\n{folder.name}")
            print(
                diagram(
                    *compare(
                        flat, truth["centre_px"], truth["disparity_px"], truth["mixed"].astype(bool)
                    )
                )
            )


if __name__ == "__main__":
    main(sys.argv[1:])
