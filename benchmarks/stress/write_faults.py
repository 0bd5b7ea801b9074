"""Killed writers and full disks: `python -m benchmarks.stress.write_faults
FOLDER [KILLS]`.

Every output of the project must be absent or whole afterwards. The writers run in forks of a
process that has not started any thread.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lfcal
import lfrender
from lfcal.camera_files.read_write import convert
from lfrender.data.surface import Surface

__all__ = ["full_disk", "kill_writers", "main"]

_SIZE = (900, 700)
# Longest time [s] that a writer lives.
_LIFE = 0.03


def _depth(camera: lfcal.Calibration, value: float) -> lfrender.DepthMap:
    each = np.full(len(camera.lattice), value, np.float32)
    surface = Surface(np.full((350, 450), value, np.float32), (0.0, 0.0), 2.0)
    return lfrender.DepthMap(
        each, 0 * each, 0 * each + 1, each, surface, camera.lattice.pitch, camera.image_size
    )


def _writers() -> dict[str, tuple[Callable[[Path, int], Any], Callable[[Path], Any]]]:
    """How to write version 0 or 1 of each kind of output, and how to read which version a file
    holds.
    """
    lattice = lfcal.Lattice(
        np.array([300.2, 200.7]), np.array([[9.1, 0.1], [4.4, 8.0]]), _SIZE, 4.4
    )
    cameras = [
        lfcal.Calibration(lattice, confidence=0.5, lenses_used=n, warnings=("-" * 200_000 * n,))
        for n in (0, 1)
    ]
    depths = [_depth(cameras[0], 1.0 + n) for n in (0, 1)]
    noise = np.random.default_rng(0).integers(0, 255, (*_SIZE[::-1], 3), dtype=np.uint8)
    pictures = [noise, 255 - noise]

    def shown(path: Path) -> int:
        pixels = lfcal.read_flat(path)
        return [np.array_equal(pixels, picture) for picture in pictures].index(True)

    def picture(path: Path, n: int) -> None:
        lfrender.write_picture(path, pictures[n])

    return {
        "camera.json": (
            lambda path, n: cameras[n].save(path),
            lambda path: lfcal.load(path).lenses_used,
        ),
        "camera.csv": (
            lambda path, n: convert(cameras[n], path),
            lambda path: lfcal.load(path, _SIZE),
        ),
        "depth.npz": (
            lambda path, n: depths[n].save(path),
            lambda path: int(lfrender.DepthMap.load(path).patch_size[0]) - 1,
        ),
        "picture.png": (picture, shown),
        "picture.tif": (picture, shown),
    }


def kill_writers(folder: Path, kills: int, seed: int = 0) -> list[str]:
    """Kill writers at random moments; gives outputs that are neither absent nor whole."""
    rng = np.random.default_rng(seed)
    found = []
    for name, (write, read) in _writers().items():
        path = folder / name
        write(path, 0)
        for number in range(kills):
            if number % 4 == 0:
                path.unlink(missing_ok=True)
            child = os.fork()
            if child == 0:
                for n in range(10_000):
                    write(path, n % 2)
                os._exit(0)
            time.sleep(rng.uniform(0, _LIFE))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            try:
                if path.exists():
                    read(path)
            except Exception as error:
                found.append(f"{name}, kill {number}: {error!r}"[:300])
    return found


def full_disk(folder: Path) -> list[str]:
    """Write onto a nearly full disk; gives faults other than a refusal."""
    found = []
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    for name, (write, read) in _writers().items():
        for before in (False, True):
            path = folder / f"{before:d}{name}"
            if before:
                write(path, 0)
            for room in (0, 1000, 20_000):
                resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
                try:
                    write(path, 1)
                    found.append(f"{name}: {room} bytes were enough")
                except lfcal.OutputError as error:
                    if name not in str(error):
                        found.append(f"{name}: the file is not named: {error}")
                except Exception as error:
                    found.append(f"{name}: {error!r}"[:300])
                finally:
                    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
            if path.exists() != before or (before and not _is_whole(path, read)):
                found.append(f"{name}: what was there before is gone or damaged")
    left = [path.name for path in folder.iterdir() if path.name.startswith(".")]
    return found + [f"{name} is left over" for name in left]


def _is_whole(path: Path, read: Callable[[Path], Any]) -> bool:
    version = read(path)
    return not isinstance(version, int) or version == 0


def main(arguments: list[str]) -> None:
    """Print the faults; exit with 1 if there is one."""
    folder = Path(arguments[0])
    (folder / "full").mkdir(parents=True)
    found = full_disk(folder / "full") + kill_writers(
        folder, int(arguments[1]) if len(arguments) > 1 else 20
    )
    print("\n".join(found) or "every output is absent or whole")
    sys.exit(bool(found))


if __name__ == "__main__":
    main(sys.argv[1:])
