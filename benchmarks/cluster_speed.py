"""Speed of a sequence on worker processes: `python -m benchmarks.cluster_speed [--count N]
[--workers N] [FRAME ...]`.

60 frames of a ray-traced scene with noise, part of which moves, or the `.npy` frames given over and
over, are rendered by one worker process and by two, each with one thread. Printed are seconds from
the first frame to the last picture, once with workers that have just been started and once, with
other frames, with workers that have their kernels loaded; the CPU seconds that the busiest worker
has taken meanwhile, which tell on a machine with other work to do; and the ratios of both numbers
of workers. Pictures of all runs are compared bit for bit.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.sequence.workers import connect

_SIZE = (900, 700)
_PITCH = 23.2
_NOISE = 1.5
# Rows of the flat that move, as a share of all.
_MOVING = 0.25


def _scene() -> tuple[NDArray[Any], lfcal.Calibration]:
    design = Camera.design(_SIZE, _PITCH, rotation=1.3)
    shot = simulate(SCENES["house"](design), design, samples=24, seed=2)
    return shot.flat, shot.truth.calibration


def _write(folder: Path, flats: list[NDArray[Any]], count: int, seed: int) -> None:
    """Write so many frames, each with its own noise, in which a part comes from other places each
    time.
    """
    folder.mkdir()
    rng = np.random.default_rng(seed)
    for k in range(count):
        flat = flats[k % len(flats)].copy()
        if len(flats) == 1:
            rows = int(_MOVING * len(flat))
            flat[:rows] = flat[k % rows : k % rows + rows]
            flat = np.clip(np.rint(flat + rng.normal(0, _NOISE, flat.shape)), 0, 255).astype(
                np.uint8
            )
        tifffile.imwrite(folder / f"f{k:03d}.tif", flat, photometric="rgb")


def _timed(
    workers: int, folder: Path, camera: lfcal.Calibration, preset: str
) -> list[tuple[float, float]]:
    """Wall and CPU seconds that the frames of `a` and then those of `b` take on newly started
    workers.
    """
    seconds = []
    with connect(workers, None) as client:
        for name in ("a", "b"):
            frames = lfrender.open_frames([folder / name])
            before = client.run(time.process_time)
            start = time.perf_counter()
            results = list(
                lfrender.render_frames(
                    frames,
                    folder / f"{name}{workers}",
                    camera,
                    preset=preset,
                    client=client,
                    threads=1,
                )
            )
            wall = time.perf_counter() - start
            after = client.run(time.process_time)
            seconds.append((wall, max(after[worker] - before[worker] for worker in before)))
            failed = [result.message for result in results if result.outcome != "rendered"]
            if failed:
                raise SystemExit(failed[0])
    return seconds


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "frames", nargs="*", type=Path, help="frames of one camera (.npy), else a ray-traced scene"
    )
    parser.add_argument("--count", type=int, default=60, help="number of frames")
    parser.add_argument("--workers", type=int, default=2, help="to be compared with one")
    parser.add_argument("--preset", default="balanced")
    given = parser.parse_args(arguments)
    if given.frames:
        flats = [np.load(path) for path in given.frames]
        camera = lfcal.calibrate(flats[0])
    else:
        flat, camera = _scene()
        flats = [flat]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed, part in enumerate(("a", "b")):
            _write(folder / part, flats, given.count, seed)
        # Kernels are compiled, or loaded, and everything is in the file cache before the clock
        # starts.
        list(
            lfrender.render_frames(
                lfrender.open_frames([folder / "b"]), folder / "b0", camera, preset=given.preset
            )
        )
        height, width = flats[0].shape[:2]
        print(
            f"{given.count} frames of {width} x {height} px, preset {given.preset}, "
            "one thread a worker"
        )
        print(
            f"{'workers':>8s} {'started s':>10s} {'CPU s':>7s} {'warm s':>8s} {'CPU s':>7s} "
            f"{'ms a frame':>11s}"
        )
        times = {}
        for workers in (1, given.workers):
            times[workers] = _timed(workers, folder, camera, given.preset)
            (first, first_cpu), (second, second_cpu) = times[workers]
            each = 1e3 * second / given.count
            print(
                f"{workers:8d} {first:10.2f} {first_cpu:7.2f} {second:8.2f} {second_cpu:7.2f} "
                f"{each:11.1f}",
                flush=True,
            )
        ratios = np.array(times[1]) / times[given.workers]
        for name, (wall, cpu) in zip(("just started", "warm"), ratios, strict=True):
            print(
                f"{given.workers} workers, {name}: {wall:.2f} times as fast as one, "
                f"by CPU time {cpu:.2f} times"
            )
        for path in sorted((folder / "b0").glob("*.tif")):
            for workers in times:
                if path.read_bytes() != (folder / f"b{workers}" / path.name).read_bytes():
                    raise SystemExit(
                        f"{path.name}: {workers} workers make another picture than one process"
                    )
        print("pictures are those of one process, bit for bit")


if __name__ == "__main__":
    main()
