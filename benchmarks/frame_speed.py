"""Speed from array to array, calibrated and warm: `python -m benchmarks.frame_speed [FRAME ...]`.

Frames of one camera, images or `.npy` arrays, or else a ray-traced scene with noise, are analysed
and rendered all in focus with `fast` and `balanced`, on one thread and on all; they also follow one
another with shortcuts, to and fro. Then a flat of 135 megapixels is rendered at one patch size, and
a quarter of it. Printed are medians of several runs, wall [ms], beside a memory copy of the flat
and `cv2.remap` or `cv2.resize` to as many pixels in turns with them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.runtime.choices import Preset

_RUNS = 7
_STEPS = 20
_SIZE = (1400, 1000)
_PITCH = 23.2
# Patch sizes of two analyses that differ by more than this share of the pitch are different depths.
_APART = 0.04
_LARGE = (14142, 9546)
_LARGE_PITCH = 74.7
_SHARES = (0.1, 0.15, -0.15, 0.44, -0.44)


def _medians(*calls: Callable[[], Any]) -> list[float]:
    """Median wall time [ms] of each call; the calls take turns, so that a busy machine slows all
    alike.
    """
    times = np.empty((_RUNS, len(calls)))
    for run in range(-1, _RUNS):
        for k, call in enumerate(calls):
            start = time.perf_counter()
            call()
            times[run, k] = 1e3 * (time.perf_counter() - start)
    return np.median(times, 0).tolist()


def _remap(flat: NDArray[Any]) -> Callable[[], Any]:
    """Bilinear reading of every pixel of the flat, a little aside."""
    y, x = np.mgrid[: flat.shape[0], : flat.shape[1]].astype(np.float32)
    x = x + np.float32(0.3)
    y = y + np.float32(0.4)
    return lambda: cv2.remap(flat, x, y, cv2.INTER_LINEAR)


def _frame_rows(frames: list[NDArray[Any]], camera: lfcal.Calibration) -> None:
    flat = frames[0]
    print(
        f"{flat.shape[1]} x {flat.shape[0]}, pitch {camera.lattice.pitch:.1f} px, "
        f"{len(camera.lattice)} lenses"
    )
    all_threads = numba.get_num_threads()
    presets: tuple[Preset, ...] = "fast", "balanced"
    for preset in presets:
        walls = []
        depth = lfrender.analyze(flat, camera, preset)

        def analysed(preset: Preset = preset) -> None:
            lfrender.analyze(flat, camera, preset)

        def drawn(depth: lfrender.DepthMap = depth) -> None:
            lfrender.render(flat, camera, depth)

        for threads in sorted({1, all_threads}):
            numba.set_num_threads(threads)
            cv2.setNumThreads(threads)
            analysis, drawing, remap, copy = _medians(analysed, drawn, _remap(flat), flat.copy)
            walls.append(analysis + drawing)
            print(
                f"  {preset:9} {threads} threads: analyze {analysis:6.1f} + "
                f"render {drawing:6.1f} = {walls[-1]:6.1f} ms  "
                f"({walls[-1] / remap:.1f} x remap of {remap:.1f} ms, "
                f"{walls[-1] / copy:.0f} x copy of {copy:.1f} ms)"
            )
        print(f"  {preset:9} all threads {walls[0] / walls[-1]:.2f} times as fast as one")
        if len(frames) > 1:
            _next_row(frames, camera, preset, depth)


def _next_row(
    frames: list[NDArray[Any]], camera: lfcal.Calibration, preset: Preset, depth: lfrender.DepthMap
) -> None:
    """Frames after one another, to and fro: their depth and picture, what was kept, and how far
    they are from frames on their own.
    """
    there_and_back = [*range(1, len(frames)), *range(len(frames) - 2, -1, -1)]
    before = (frames[0], depth, lfrender.render(frames[0], camera, depth))
    alone = [lfrender.analyze(frame, camera, preset) for frame in frames]
    times = []
    told = []
    for step in range(-2, max(_STEPS, len(there_and_back))):
        k = there_and_back[step % len(there_and_back)]
        start = time.perf_counter()
        after = lfrender.analyze(frames[k], camera, preset, previous=before[:2])
        middle = time.perf_counter()
        picture = lfrender.render(frames[k], camera, after, previous=before)
        # The first steps compile.
        if step >= 0:
            times.append([1e3 * (middle - start), 1e3 * (time.perf_counter() - middle)])
            same = (
                (picture.image == before[2].image)
                .reshape(*picture.image.shape[:2], -1)
                .all(2)
                .mean()
            )
            both = (alone[k].mode != 0) & (after.mode != 0)
            apart = np.abs(alone[k].patch_size - after.patch_size)[both] > _APART * depth.pitch
            told.append(
                [after.saved.get("still", 0.0), after.saved.get("steady", 0.0), same, apart.mean()]
            )
        before = (frames[k], after, picture)
    (analysis, drawing), whole = np.median(times, 0), np.sum(times, 1)
    still, steady, same, apart = 100 * np.mean(told, 0)
    print(
        f"  {preset:9} next frame: analyze {analysis:.1f} + render {drawing:.1f} ms, "
        f"median {np.median(whole):.1f}, mean {whole.mean():.1f} ms of {len(whole)}, "
        f"{still:.0f} % of the lenses still, {steady:.0f} % steady, "
        f"{same:.0f} % of the pixels kept; "
        f"{apart:.1f} % of the lenses more than {_APART} D from the depth of frames"
        " on their own"
    )


def _patch_times(flat: NDArray[Any], camera: lfcal.Calibration, s: float) -> list[float]:
    """Median wall times [ms] of rendering at one patch size, and of resizing to as many pixels."""
    shape = lfrender.render(flat, camera, patch_size=s).image.shape

    def resized() -> None:
        cv2.resize(flat, shape[1::-1], interpolation=cv2.INTER_LINEAR)

    def drawn() -> None:
        lfrender.render(flat, camera, patch_size=s)

    return _medians(drawn, resized)


def _fixed_rows() -> None:
    width, height = _LARGE
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (height // 8 + 1, width // 8 + 1, 3), dtype=np.uint8)
    flat = np.repeat(np.repeat(coarse, 8, 0), 8, 1)[:height, :width].copy()
    d = _LARGE_PITCH
    for share in _SHARES:
        times = []
        for part in (flat, flat[: height // 2, : width // 2].copy()):
            size = (part.shape[1], part.shape[0])
            lattice = lfcal.Lattice(
                np.array([40.3, 37.9]), np.array([[d, 0.3], [-0.3, d]]), size, d / 2 - 1
            )
            camera = lfcal.Calibration(lattice=lattice)
            times.append(_patch_times(part, camera, share * d))
        (whole, resize), (quarter, _) = times
        print(
            f"  s = {share:+.2f} D of {width * height / 1e6:.0f} megapixels: {whole:.0f} ms, "
            f"{whole / resize:.2f} x"
            f" resize of {resize:.0f} ms; a quarter of the area {whole / quarter:.2f} times as fast"
        )


def main(paths: list[str]) -> None:
    """Print the figures of the frames in `paths`, or of a ray-traced scene, and those of one patch
    size.
    """
    if paths:
        frames = [
            np.load(path) if path.endswith(".npy") else lfcal.read_flat(path) for path in paths
        ]
        camera = lfcal.calibrate(frames[0])
    else:
        design = Camera.design(_SIZE, _PITCH, rotation=1.3)
        shot = simulate(SCENES["house"](design), design, samples=48, seed=2)
        rng = np.random.default_rng(1)
        frames = [
            np.clip(np.rint(shot.flat + rng.normal(0, 2.0, shot.flat.shape)), 0, 255).astype(
                np.uint8
            )
            for _ in "ab"
        ]
        camera = shot.truth.calibration
    _frame_rows(frames, camera)
    _fixed_rows()


if __name__ == "__main__":
    main(sys.argv[1:])
