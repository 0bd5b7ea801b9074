"""Views against the true ones of simulated scenes: `python -m benchmarks.view_grid [COUNT]`, by
default 5 x 5.

The table shows PSNR (one gain per channel) over all views of the grid, of the middle view, and of
the corner views, compared with plain tiling: all lenses contribute patches of one size around the
viewpoint. Then follow the processor seconds for all views of a frame on one thread, calibrated and
with compiled kernels.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.simulator import true_view
from lfrender.flat.lens_graph import nearest_lens
from lfrender.rendering.viewpoints import grid_offsets, still_depth

_SIZE = (640, 480)
#: Scenes by name: arguments of the scene and of the camera.
_SCENES: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "house, both modes, D = 23 px": ("house", {}, {"pitch": 23.2, "rotation": 2.0}),
    "clutter, binocular, D = 31 px": ("clutter", {"seed": 3}, {"pitch": 31.0}),
    "slope, telescopic, D = 27 px": ("slope", {"left": 0.2, "right": 0.45}, {"pitch": 27.0}),
    "plane, binocular, three lens types, D = 24 px": (
        "plane",
        {"ratio": -0.31},
        {"pitch": 24.0, "focus": (-0.2, -0.33, -0.5)},
    ),
}
_CAPTURES = Path(__file__).parents[1].parent / "shared" / "captures"


def _tiled(
    flat: NDArray[Any],
    camera: lfcal.Calibration,
    size: float,
    offset: tuple[float, float],
    picture: Any,
    still: float,
) -> NDArray[np.float64]:
    """The view on the grid of `picture`, each pixel read from the lens with the nearest centre with
    one patch size.
    """
    lattice = camera.lattice
    height, width = picture.image.shape[:2]
    v, u = np.mgrid[:height, :width]
    moved = np.asarray(offset) * lattice.pitch / still
    drawn = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], -1) @ picture.affine.T + moved
    centre = lattice.centres()[nearest_lens(lattice.centres(), drawn)]
    read = centre + offset - (drawn - centre) * size / lattice.pitch
    channels = [
        map_coordinates(flat[..., c].astype(float), read.T[::-1], order=1, mode="nearest")
        for c in range(3)
    ]
    return np.stack(channels, -1).reshape(height, width, 3)


def _error(picture: NDArray[Any], truth: NDArray[Any], where: NDArray[np.bool_]) -> float:
    """Mean squared error with one gain per channel, of white 1."""
    p = picture[where]
    t = truth[where]
    gain = (p * t).sum(0) / (p * p).sum(0)
    return float(np.mean((p * gain - t) ** 2))


def _row(
    name: str, scene_name: str, arguments: dict[str, Any], design: dict[str, Any], count: int
) -> str:
    camera = Camera.design(size=_SIZE, **design)
    scene = SCENES[scene_name](camera, **arguments)
    shot = simulate(scene, camera, samples=48, seed=7, noise=(9000.0, 5.0))
    calibration = lfcal.calibrate(shot.white, kind="white")
    depth = lfrender.analyze(shot.flat, calibration)
    offsets = grid_offsets(count, count, 0.7 * calibration.lattice.radius)
    still = still_depth(depth)
    scale = 0.3 * camera.pitch
    middle = float(np.median(depth.patch_size[np.isfinite(depth.patch_size)]))
    errors = []
    for offset, view in zip(
        offsets,
        lfrender.views(shot.flat, calibration, depth, offsets=offsets, scale=scale),
        strict=True,
    ):
        drawn = view.affine + np.column_stack(
            [np.zeros((2, 2)), np.array(offset) * camera.pitch / still]
        )
        truth = true_view(scene, camera, offset, drawn, view.image.shape[1::-1])
        border = int(np.ceil(2 * scale))
        where = np.zeros(view.valid.shape, bool)
        where[border:-border, border:-border] = True
        own = _error(view.image / 255.0, truth, where & view.valid)
        tiled = _tiled(shot.flat, calibration, middle, offset, view, still) / 255.0
        errors.append((own, _error(tiled, truth, where)))
    found = -10 * np.log10(errors)
    grid = -10 * np.log10(np.mean(errors, axis=0))
    centre = found[len(found) // 2]
    corners = found[[0, count - 1, -count, -1]].mean(0)
    cells = [f"{pair[0]:.1f} / {pair[1]:.1f}" for pair in (grid, centre, corners)]
    return f"| {name} | {' | '.join(cells)} |"


def _seconds(count: int) -> None:
    path = _CAPTURES / "Fujita2.png"
    if not path.exists():
        return
    numba.set_num_threads(1)
    flat = lfcal.read_flat(path)
    calibration = lfcal.calibrate(flat)
    offsets = grid_offsets(count, count, 0.7 * calibration.lattice.radius)
    print("\n| Fujita2, preset | pixels per pitch | analyze [s] | views [s] |\n|---|---|---|---|")
    for preset in ("balanced", "fast"):
        for scale in (None, 0.35 * calibration.lattice.pitch):
            times = []
            for _ in range(3):
                start = time.process_time()
                depth = lfrender.analyze(flat, calibration, preset)
                middle = time.process_time()
                pictures = [
                    picture.scale
                    for picture in lfrender.views(
                        flat, calibration, depth, offsets=offsets, scale=scale
                    )
                ]
                times.append((middle - start, time.process_time() - middle))
            best = np.array(times).min(0)
            print(f"| {preset} | {pictures[0]:.1f} | {best[0]:.2f} | {best[1]:.2f} |", flush=True)


def _main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print(
        "| PSNR [dB], lfrender / tiling with one patch size | grid | middle | corners "
        "|\n|---|---|---|---|"
    )
    for name, (scene, arguments, design) in _SCENES.items():
        print(_row(name, scene, arguments, design, count), flush=True)
    _seconds(count)


if __name__ == "__main__":
    _main()
