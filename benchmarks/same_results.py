"""Whether a change keeps all results: `python -m benchmarks.same_results record|compare FILE.npz
[FOLDER]`.

`record` calibrates, analyses and draws random scenes of random cameras, and the captures, white
images and ray-traced flats in FOLDER (`../shared`), and stores all resulting arrays: centres,
patch sizes, standard errors, confidences, reasons, surfaces and pictures, with the presets `fast`
and `balanced`, next frames, views, tiles and Dask workers. `compare` does the same, prints each
array that differs, and exits with 1 if one differs. Delete the `__pycache__` folders first if a
function has changed that kernels of other files inline.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

import lfcal
import lfrender
from lfrender.rendering.viewpoints import circle_offsets
from lfrender.runtime.choices import Preset

from .random_scenes import draw

__all__ = ["differences", "main", "results"]

Results = dict[str, NDArray]

SEEDS = range(10)
SAMPLES = 64
PRESETS: tuple[Preset, ...] = ("fast", "balanced")
# Files of the folder that are read, by pattern, and which of them are white images.
SCENES = (
    "truth/*/flat.png",
    "captures/*2.png",
    "captures/*.webp",
    "captures/GUV.tif",
    "captures/Letters.png",
)
WHITES = ("whites/*.png", "truth/*/white.png")


def results(folder: Path | None = None) -> Results:
    """All result arrays of the toolkit for random scenes, and for the files in a folder."""
    found: Results = {}
    for seed in SEEDS:
        found |= _scene(f"random scene {seed}", draw(seed, SAMPLES)[1].flat)
    for path in _files(folder, SCENES):
        flat = lfcal.read_flat(path)
        name = "/".join(path.parts[-2:])
        found |= _scene(name, flat)
        if flat.size < 2e7:
            found |= _large(name, flat)
    for path in _files(folder, WHITES):
        found |= _camera("/".join(path.parts[-2:]), lfcal.calibrate(lfcal.read_flat(path), "white"))
    return found


def differences(before: Results, after: Results) -> list[str]:
    """One line for each array that is not the same bit for bit, with its largest difference."""
    lines = []
    for key in sorted(before.keys() | after.keys()):
        if key not in before or key not in after:
            lines.append(f"{key}: only {'before' if key in before else 'after'}")
            continue
        a = before[key]
        b = after[key]
        if a.shape != b.shape or a.dtype != b.dtype:
            lines.append(f"{key}: {a.dtype} {a.shape} before, {b.dtype} {b.shape} after")
        elif a.tobytes() != b.tobytes():
            apart = np.abs(a.astype(float) - b.astype(float))
            lines.append(
                f"{key}: {np.mean(a != b):.2%} of the values differ, by {np.nanmax(apart):.3g} at "
                f"most"
            )
    return lines


def _files(folder: Path | None, patterns: tuple[str, ...]) -> Iterator[Path]:
    if folder is not None:
        for pattern in patterns:
            yield from sorted(folder.glob(pattern))


def _scene(name: str, flat: NDArray) -> Results:
    camera = lfcal.calibrate(flat)
    found = _camera(name, camera)
    changed = flat.copy()
    height, width = (side // 4 for side in flat.shape[:2])
    changed[height : 2 * height, width : 2 * width] = flat[
        2 * height : 3 * height, 2 * width : 3 * width
    ]
    for preset in PRESETS:
        depth = lfrender.analyze(flat, camera, preset)
        picture = lfrender.render(flat, camera, depth)
        found |= _depth(f"{name}, {preset}", depth) | _picture(f"{name}, {preset}", picture)
        following = lfrender.analyze(changed, camera, preset, previous=(flat, depth))
        found |= _depth(f"{name}, next frame, {preset}", following)
        redrawn = lfrender.render(changed, camera, following, previous=(flat, depth, picture))
        found |= _picture(f"{name}, next frame, {preset}", redrawn)
    for ratio in (-0.3, 0.3):
        s = ratio * camera.lattice.pitch
        found |= _picture(
            f"{name}, patch size {ratio:+} D", lfrender.render(flat, camera, patch_size=s)
        )
        found |= _picture(f"{name}, refocused at {ratio:+} D", lfrender.refocus(flat, camera, s))
    found |= _picture(f"{name}, traditional", lfrender.traditional(flat, camera))
    offsets = circle_offsets(2, 0.3 * camera.lattice.radius)
    for number, view in enumerate(lfrender.views(flat, camera, depth, offsets=offsets)):
        found |= _picture(f"{name}, view {number}", view)
    return found


def _large(name: str, flat: NDArray) -> Results:
    """Pictures drawn in tiles, by this process and by two Dask workers."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        source, camera, picture = (
            Path(scratch) / file for file in ("flat.tif", "camera.json", "picture.tif")
        )
        tifffile.imwrite(source, flat)
        lfcal.calibrate(flat).save(camera)
        for workers in (1, 2):
            command = ["render", source, "-c", camera, "-o", picture, "--tile", 600, "--quiet"]
            more = ["--workers", workers] if workers > 1 else []
            subprocess.run(
                [sys.executable, "-m", "lfrender.cli.main", *map(str, command + more)], check=True
            )
            found[f"{name}, in tiles on {workers} workers"] = tifffile.imread(picture)
            picture.unlink()
    return found


def _camera(name: str, camera: lfcal.Calibration) -> Results:
    found = {f"{name}: centres": camera.lattice.centres()}
    if camera.errors is not None:
        found[f"{name}: covariance of the lattice"] = camera.errors.covariance
    return found


def _depth(name: str, depth: lfrender.DepthMap) -> Results:
    fields = ("patch_size", "standard_error", "confidence", "reason", "mode")
    found = {f"{name}: {field}": getattr(depth, field) for field in fields}
    if depth.surface is not None:
        found[f"{name}: surface"] = depth.surface.patch_size
    return found


def _picture(name: str, picture: lfrender.Rendering) -> Results:
    return {f"{name}: picture": picture.image, f"{name}: valid": picture.valid}


def main(arguments: list[str]) -> int:
    action, file, *rest = arguments
    found = results(Path(rest[0]) if rest else None)
    if action == "record":
        np.savez_compressed(file, **found)  # type: ignore[arg-type]
        return 0
    with np.load(file) as kept:
        lines = differences({key: kept[key] for key in kept.files}, found)
    print("\n".join(lines) or f"all {len(found)} arrays are the same")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
