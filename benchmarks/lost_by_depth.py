"""Loss of PSNR by wrong depth: `python -m benchmarks.lost_by_depth FIRST LAST`.

Random houses and clutter (scenes with depth edges) of `benchmarks.random_scenes`, with 256 rays a
pixel, are drawn with the depth of `balanced` and with the true depth of every scene point, at 0.15
and 0.3 pitches per pixel. Both are compared with the ray-traced picture, at places with a
resolvable depth.
"""

from __future__ import annotations

import sys

import numpy as np

import lfcal
import lfrender
from data_synth import Capture
from data_synth.metrics import compare_pictures, resample

from .random_scenes import draw
from .true_surface import with_true_surface

__all__ = ["main"]

_SCALES = (0.15, 0.3)  # [pitch] per pixel
_RESOLVABLE = 0.75  # [pitch]


def psnr(
    depth: lfrender.DepthMap, capture: Capture, camera: lfcal.Calibration, scale: float
) -> float:
    """PSNR [dB] of the picture drawn with this depth."""
    truth = capture.truth
    pitch = camera.lattice.pitch
    picture = lfrender.render(capture.flat, camera, depth, scale=scale * pitch, detail="off")
    shape = picture.image.shape[:2]
    wanted, inside = resample(truth.reference, truth.reference_affine, shape, picture.affine)
    beyond = ~(np.abs(truth.reference_patch_size) < _RESOLVABLE * pitch)
    lost, _ = resample(beyond * 1.0, truth.reference_affine, shape, picture.affine)
    border = int(np.ceil(picture.scale))
    inner = np.zeros(shape, bool)
    inner[border:-border, border:-border] = True
    found = picture.image / np.float64(np.iinfo(picture.image.dtype).max)
    return compare_pictures(found, wanted, inside & inner & picture.valid & (lost == 0)).psnr


def main(arguments: list[str]) -> None:
    """Print a row for each scene, the mean and the worst."""
    first, last = map(int, arguments)
    rows = []
    for seed in range(first, last + 1):
        name, capture = draw(seed, 256)
        if not name.startswith(("house", "clutter")):
            continue
        camera = lfcal.calibrate(capture.flat)
        depth = lfrender.analyze(capture.flat, camera)
        truth = capture.truth
        true = with_true_surface(depth, truth.reference_patch_size, truth.reference_affine)
        rows.append(
            [psnr(true, capture, camera, s) - psnr(depth, capture, camera, s) for s in _SCALES]
        )
        print(f"{seed} {name}: {rows[-1][0]:.2f} / {rows[-1][1]:.2f} dB", flush=True)
    mean = np.mean(rows, 0)
    worst = np.max(rows, 0)
    print(f"mean {mean[0]:.2f} / {mean[1]:.2f} dB, worst {worst[0]:.2f} / {worst[1]:.2f} dB")


if __name__ == "__main__":
    main(sys.argv[1:])
