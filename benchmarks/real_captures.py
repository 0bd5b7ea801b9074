"""Modes and times on captures of scenes in one mode: `python -m benchmarks.real_captures
../shared/captures/*.webp`.

The mode of the scene is the mode of most lenses. The command prints the share of textured lenses
in another mode.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import lfcal
import lfrender
from lfrender.runtime.choices import Preset


def measure(path: Path, preset: Preset) -> dict[str, Any]:
    """Shares of the modes of textured lenses, and the seconds of each stage."""
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
    return {
        "name": path.stem,
        "pitch": calibration.lattice.pitch,
        "confidence": calibration.confidence,
        "mode": float(mode),
        "right": float((depth.mode == mode)[textured].mean()),
        "wrong": float((depth.mode == -mode)[textured].mean()),
        "textured": int(textured.sum()),
        "size": picture.image.shape[1::-1],
        "wall": wall.tolist(),
        "cpu": cpu.tolist(),
    }


def _row(path: Path, preset: Preset) -> str:
    found = measure(path, preset)
    stages = zip(("calibrate", "analyze", "render"), found["wall"], found["cpu"], strict=True)
    times = " ".join(f"{name} {wall:.2f} ({cpu:.2f})" for name, wall, cpu in stages)
    return (
        f"{found['name']:20} {preset:9} pitch {found['pitch']:.3f} px, confidence "
        f"{found['confidence']:.3f}  mode {found['mode']:+.0f}: right {found['right']:.4f} wrong "
        f"{found['wrong']:.4f} of {found['textured']} textured lenses  picture "
        f"{found['size'][0]} x {found['size'][1]}  {times} s wall (CPU)"
    )


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(_row(Path(argument), "balanced"), flush=True)
