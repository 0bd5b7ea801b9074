"""Differences of frames of a still scene by noise: `python -m benchmarks.steadiness [electrons]`.

Prints the RMS difference of two frames [levels of 255] with `detail="off"` and `"natural"`: drawn
with one depth map; each analysed separately; and the second analysed and drawn with the first as
the previous frame. It also prints the share of unchanged pixels.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.transfer import EXPOSURE, develop

_SIZE = (720, 560)
_READ = 5.0  # [electrons]
_SCENES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "clutter, D = 31 px": ("clutter", {"pitch": 31.0}, {}),
    "clutter, D = 46 px": (
        "clutter",
        {"pitch": 46.0, "lattice": "hex-vertical"},
        {"seed": 5, "count": 25},
    ),
    "house, D = 40 px": ("house", {"pitch": 40.0}, {"seed": 1}),
    "slope, square, D = 28 px": ("slope", {"pitch": 28.0, "lattice": "square"}, {"seed": 4}),
}


def _frames(
    scene: str, optics: dict[str, Any], arguments: dict[str, Any], well: float
) -> tuple[list[NDArray[Any]], lfcal.Calibration]:
    """Two frames that differ only by noise, and the camera."""
    camera = Camera.design(size=_SIZE, **optics)
    shot = simulate(
        SCENES[scene](camera, **arguments), camera, samples=96, seed=7, bits=16, gamma=False
    )
    light = (shot.flat / (65535 * EXPOSURE)).astype(np.float32)
    frames = [
        develop(light, noise=(well, _READ), bits=8, gamma=True, rng=np.random.default_rng(seed))
        for seed in (1, 2)
    ]
    return frames, shot.truth.calibration


def _differ(first: lfrender.Rendering, second: lfrender.Rendering) -> float:
    apart = first.image.astype(float) - second.image
    return float(np.sqrt((apart[first.valid & second.valid] ** 2).mean()))


def _main() -> None:
    well = float(sys.argv[1]) if sys.argv[1:] else 4000.0
    print(
        "| scene | detail | one depth map | each by itself | frame before | unchanged "
        "|\n|---|---|---|---|---|---|"
    )
    for name, (scene, optics, arguments) in _SCENES.items():
        (one, two), camera = _frames(scene, optics, arguments, well)
        depths = [lfrender.analyze(frame, camera) for frame in (one, two)]
        after = lfrender.analyze(two, camera, previous=(one, depths[0]))
        for detail in ("off", "natural"):
            first = lfrender.render(one, camera, depths[0], detail=detail)
            how: dict[str, Any] = {"detail": detail, "scale": first.scale}
            same = lfrender.render(two, camera, depths[0], **how)
            each = lfrender.render(two, camera, depths[1], **how)
            kept = lfrender.render(two, camera, after, previous=(one, depths[0], first), **how)
            found = " | ".join(f"{_differ(first, other):.2f}" for other in (same, each, kept))
            print(
                f"| {name} | {detail} | {found} | {(kept.image == first.image).all(-1).mean():.2f} "
                f"|",
                flush=True,
            )


if __name__ == "__main__":
    _main()
