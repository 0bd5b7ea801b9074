"""Pictures of ray-traced flats against their references: `python -m benchmarks.pictures
[../shared/truth]`.

The table shows PSNR and SSIM of all-in-focus pictures at 0.15 D, 0.3 D and the default scale,
without restored detail. They are drawn with the depth of two presets and with the true depth, which
shows the loss by drawing alone. Without a folder, scenes are simulated that differ in pitch,
lattice, mode, clutter and noise; for comparison, each place is read from the nearest lens with its
true patch size.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfrender.data.depth_map import default_scale
from lfrender.data.surface import Surface
from lfrender.flat.lens_graph import nearest_lens

from .true_surface import with_true_surface
from .truth_flats import SCALES, merit

# The largest |s / D| that a depth is asked for.
_RESOLVABLE = 0.75
# Each pixel of the reference depth covers 2 x 2 pixels of the flat.
_TRUTH_GRID = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5]])


def _rows(folder: Path) -> str:
    flat = lfcal.read_flat(folder / "flat.png")
    calibration = lfcal.calibrate(flat)
    found = lfrender.analyze(flat, calibration)
    size = np.load(folder / "reference_depth.npz")["disparity_px"].astype(np.float32)
    true = with_true_surface(found, size, _TRUTH_GRID)
    pitch = calibration.lattice.pitch
    lines = []
    for scale in (*(share * pitch for share in SCALES), default_scale(found)):
        merits = [
            merit(
                lfrender.render(flat, calibration, depth, scale=scale, detail="off"), folder, pitch
            )
            for depth in (found, true)
        ]
        figures = " | ".join(f"{one.psnr:.1f} dB / {one.ssim:.3f}" for one in merits)
        lines.append(f"| {folder.name} | {scale:.1f} | {figures} |")
    return "\n".join(lines)


@dataclass(frozen=True)
class _Simulated:
    """A scene, the camera that sees it, and how it is stored."""

    scene: str
    camera: dict[str, Any]
    arguments: dict[str, Any] = field(default_factory=dict)
    stored: dict[str, Any] = field(default_factory=dict)


_SCENES = {
    "house, both modes, D = 17 px": _Simulated("house", {"pitch": 17.3, "rotation": 7.0}),
    "clutter, binocular, square, D = 31 px": _Simulated(
        "clutter", {"pitch": 31.0, "lattice": "square"}
    ),
    "clutter, binocular, D = 46 px, noise": _Simulated(
        "clutter",
        {"pitch": 46.0, "lattice": "hex-vertical"},
        {"seed": 5, "count": 25},
        {"noise": (3000, 5)},
    ),
    "slope, telescopic, D = 35 px": _Simulated(
        "slope",
        {"pitch": 35.0, "rotation": 12.0},
        {"left": 0.2, "right": 0.5},
        {"noise": (3000, 5)},
    ),
    "plane, telescopic, sheared, D = 23 px, 16-bit linear": _Simulated(
        "plane",
        {"pitch": 23.2, "lattice": "sheared"},
        {"ratio": 0.33},
        {"bits": 16, "gamma": False},
    ),
    "slope, binocular, three lens types, D = 24 px": _Simulated(
        "slope", {"pitch": 24.0, "focus": (-0.2, -0.33, -0.5)}, {}, {"noise": (3000, 5)}
    ),
}
_SIZE = (720, 560)


def _simulated_rows(name: str, how: _Simulated) -> str:
    camera = Camera.design(size=_SIZE, **how.camera)
    shot = simulate(
        SCENES[how.scene](camera, **how.arguments), camera, samples=64, seed=7, **how.stored
    )
    truth = shot.truth
    calibration = lfcal.calibrate(shot.white, kind="white")
    depth = lfrender.analyze(shot.flat, calibration)
    first = (float(truth.reference_affine[0, 2]), float(truth.reference_affine[1, 2]))
    spacing = float(truth.reference_affine[0, 0])
    size = truth.reference_patch_size
    true = with_true_surface(depth, size, truth.reference_affine)
    v, u = np.mgrid[: size.shape[0], : size.shape[1]] * spacing
    lens = nearest_lens(
        truth.calibration.lattice.centres(),
        np.stack([u + first[0], v + first[1]], -1).reshape(-1, 2),
    )
    own = truth.patch_size[lens].reshape(size.shape).astype(np.float32)
    tiled = replace(
        depth, surface=Surface(np.nan_to_num(own, nan=float(np.nanmedian(own))), first, spacing)
    )

    def score(picture: lfrender.Rendering) -> str:
        shape = picture.image.shape[:2]
        wanted, inside = resample(truth.reference, truth.reference_affine, shape, picture.affine)
        lost, _ = resample(
            (~(np.abs(size) < _RESOLVABLE * camera.pitch)) * 1.0,
            truth.reference_affine,
            shape,
            picture.affine,
        )
        border = int(np.ceil(picture.scale))
        inner = np.zeros(shape, bool)
        inner[border:-border, border:-border] = True
        white = np.float64(np.iinfo(picture.image.dtype).max)
        found = compare_pictures(
            picture.image / white, wanted, inside & inner & picture.valid & (lost == 0)
        )
        return f"{found.psnr:.1f} dB / {found.ssim:.3f}"

    lines = []
    for scale in (*(share * camera.pitch for share in SCALES), default_scale(depth)):
        pictures = [
            lfrender.render(shot.flat, calibration, which, scale=scale, detail="off")
            for which in (depth, true)
        ]
        pictures.append(lfrender.render(shot.flat, calibration, tiled, scale=scale, blend=False))
        lines.append(
            f"| {name} | {scale:.1f} | {' | '.join(score(picture) for picture in pictures)} |"
        )
    return "\n".join(lines)


def _main() -> None:
    arguments = sys.argv[1:]
    if not arguments:
        print("| scene | pixels per pitch | balanced | true depth | nearest lens, true depth |")
        print("|---|---|---|---|---|")
        for name, how in _SCENES.items():
            print(_simulated_rows(name, how), flush=True)
        return
    print("| scene | pixels per pitch | balanced | true depth |\n|---|---|---|---|")
    for path in sorted(Path(arguments[0]).iterdir()):
        if path.is_dir():
            print(_rows(path), flush=True)


if __name__ == "__main__":
    _main()
