"""Modes and times on captures of scenes in one mode: `python -m benchmarks.real_captures
../shared/captures/*.webp`.

The mode of the scene is the mode of most lenses. The command prints the share of textured lenses
in another mode.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import lfcal
import lfrender
from lfrender.runtime.choices import Preset


def _row(path: Path, preset: Preset) -> str:
    flat = lfcal.read_flat(path)
    calibration = lfcal.calibrate(flat)
    lfrender.render(flat, calibration, lfrender.analyze(flat, calibration, preset))
    times = [(time.perf_counter(), time.process_time())]
    lfcal.calibrate(flat)
    times.append((time.perf_counter(), time.process_time()))
    depth = lfrender.analyze(flat, calibration, preset)
    times.append((time.perf_counter(), time.process_time()))
    picture = lfrender.render(flat, calibration, depth)
    times.append((time.perf_counter(), time.process_time()))
    wall, cpu = np.diff(times, axis=0).T
    textured = depth.confidence > 0
    mode = np.sign(np.nanmedian(depth.patch_size))
    return (
        f"{path.stem:20} {preset:9} pitch {calibration.lattice.pitch:.3f} px, confidence "
        f"{calibration.confidence:.3f}"
        f"  mode {mode:+.0f}: right {(depth.mode == mode)[textured].mean():.4f}"
        f" wrong {(depth.mode == -mode)[textured].mean():.4f} of {textured.sum()} textured lenses"
        f"  picture {picture.image.shape[1]} x {picture.image.shape[0]}"
        f"  calibrate {wall[0]:.2f} ({cpu[0]:.2f}) analyze {wall[1]:.2f} ({cpu[1]:.2f})"
        f" render {wall[2]:.2f} ({cpu[2]:.2f}) s wall (CPU)"
    )


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(_row(Path(argument), "balanced"), flush=True)
