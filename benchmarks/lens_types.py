"""Depth before arrays of several lens types: `python -m benchmarks.lens_types [SEED ...]`.

Clutter is ray-traced before lenses of one type and of three, which are focused at three sets of depths, at two pitches,
with noise. Only the flats are given; judged as in `benchmarks.random_scenes`.
"""

from __future__ import annotations

import sys

from data_synth import SCENES, Camera, simulate

from .random_scenes import judge

_SEEDS = (50, 51)
_PITCHES, _ACROSS, _ROTATION = (19.7, 42.0), 34, 11.0
# Where lenses are focused [s / D].
_FOCUS: dict[str, float | tuple[float, float, float]] = {
    "one type": 0.04, "binocular": (-0.5, -0.32, -0.14), "about infinity": (-0.1, 0.04, 0.18),
    "telescopic": (0.08, 0.2, 0.32),
}  # fmt: skip
_SAMPLES, _NOISE = 64, (12000.0, 5.0)


def main(arguments: list[str]) -> None:
    for seed in [int(v) for v in arguments] or _SEEDS:
        for pitch in _PITCHES:
            size = int(_ACROSS * pitch), int(0.75 * _ACROSS * pitch)
            for name, focus in _FOCUS.items():
                camera = Camera.design(size, pitch, rotation=_ROTATION, focus=focus)
                scene = SCENES["clutter"](camera, seed=seed)
                found = judge(simulate(scene, camera, samples=_SAMPLES, seed=seed, noise=_NOISE))
                print(
                    f"{seed:3d} {pitch:4.1f} px, {name:15} modes {found.right:.4f}  s median {found.median:.4f}"
                    f" 95 % {found.most:.3f} px  within its error {found.within:.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1:])
