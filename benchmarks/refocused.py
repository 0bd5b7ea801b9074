"""Refocused pictures against true ones: `python -m benchmarks.refocused`.

A true picture is the mean of the views through 150 places of the main lens. For each scene, the
table shows mean PSNR (one gain per channel) and SSIM over a focal stack of eight pictures: of the
light field alone, and with blur by depth where the light field is undersampled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures
from data_synth.simulator import true_view
from lfrender.rendering.refocus import stack_depths

_SIZE = (640, 480)
_PLACES = 150
_PICTURES = 8
#: Scenes by name: the scene, its arguments, and the pitch.
_SCENES: dict[str, tuple[str, dict[str, Any], float]] = {
    "house": ("house", {}, 23.2),
    "slope": ("slope", {"left": 0.2, "right": 0.45}, 27.0),
    "house, deep": ("house", {"far": 0.55, "near": -0.45, "seed": 5}, 23.2),
    "clutter": ("clutter", {"seed": 3}, 31.0),
}


def _true_picture(
    scene: Any, camera: Camera, picture: lfrender.Rendering, focus: float, radius: float
) -> NDArray[np.float64]:
    number = np.arange(_PLACES)
    distance = radius * np.sqrt((number + 0.5) / _PLACES)
    angle = number * np.pi * (3 - 5**0.5)
    height, width = picture.image.shape[:2]
    total = np.zeros((height, width, 3))
    for offset in np.column_stack([distance * np.cos(angle), distance * np.sin(angle)]):
        affine = np.array(picture.affine)
        affine[:, 2] += offset * camera.pitch / focus
        total += true_view(scene, camera, tuple(offset), affine, (width, height), samples=4)
    return total / _PLACES


def _row(name: str) -> str:
    scene_name, arguments, pitch = _SCENES[name]
    camera = Camera.design(size=_SIZE, pitch=pitch, rotation=2.0)
    scene = SCENES[scene_name](camera, **arguments)
    shot = simulate(scene, camera, samples=48, seed=7, noise=(9000.0, 5.0))
    calibration = lfcal.calibrate(shot.white, kind="white")
    depth = lfrender.analyze(shot.flat, calibration)
    sizes = stack_depths(depth, _PICTURES)
    mended = lfrender.focal_stack(shot.flat, calibration, sizes, depth=depth)
    plain = lfrender.focal_stack(shot.flat, calibration, sizes, scale=mended[0].scale)
    figures = []
    for size, *pictures in zip(sizes, plain, mended, strict=True):
        truth = _true_picture(scene, camera, pictures[0], size, calibration.lattice.radius)
        border = 2 * int(np.ceil(pictures[0].scale))
        where = np.zeros(truth.shape[:2], bool)
        where[border:-border, border:-border] = True
        for picture in pictures:
            quality = compare_pictures(picture.image / 255, truth, where & picture.valid)
            figures.append((quality.psnr, quality.ssim))
    (old, old_ssim), (new, new_ssim) = np.reshape(figures, (_PICTURES, 2, 2)).mean(0)
    return f"{name:12} {old:.1f} dB / {old_ssim:.2f}   {new:.1f} dB / {new_ssim:.2f}"


if __name__ == "__main__":
    print(f"{'':12} light field      with blur by depth")
    for scene_name in _SCENES:
        print(_row(scene_name), flush=True)
