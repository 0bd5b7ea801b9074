"""Killed renderings in tiles: `python -m benchmarks.stress.tile_faults FOLDER [KILLS]`.

A process of its own renders a small flat in tiles over and over, and is killed at a random moment.
Then the picture must be absent or whole, and rendering once more must make it, from the tiles that
were finished, bit for bit.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import tifffile

import lfcal
import lfrender
from lfrender.large.render import LargePicture

from .plane_flats import PlaneFlat

__all__ = ["NAMES", "kill_renderings", "main", "render_for_ever"]

#: A picture of each kind that is written in another way, by its name.
NAMES = ("picture.tif", "packed.tif", "picture.zarr", "picture.png")
_SIZE = (900, 700)
_PATCH = 9.0
_TILE = 40
# A rendering lives for up to so long [s] after its process is ready: several of them.
_LIFE = 1.5


def _render(folder: Path, name: str) -> LargePicture:
    camera = lfcal.load(folder / "camera.json")
    with lfcal.open_flat(folder / "flat.tif") as source:
        return lfrender.render_large(
            source,
            folder / name,
            camera,
            patch_size=_PATCH,
            tile=_TILE,
            compress=name.startswith("packed"),
        )


def render_for_ever(folder: Path, name: str) -> None:
    """Render again and again until the process is killed."""
    number = 0
    while True:
        _render(folder, name)
        print("ready", flush=True)
        # Every other time there is an earlier picture to be replaced.
        if number % 2:
            (shutil.rmtree if name.endswith("zarr") else Path.unlink)(folder / name)
        number += 1


def kill_renderings(folder: Path, kills: int, seed: int = 0) -> tuple[list[str], int]:
    """Kill renderings at random moments.

    Returns
    -------
    found : list of str
        What was neither absent nor whole, or could not be gone on with.
    resumed : int
        How many kills left finished tiles that were used again.
    """
    rng = np.random.default_rng(seed)
    shot = PlaneFlat(size=_SIZE)
    shot.calibration.save(folder / "camera.json")
    tifffile.imwrite(folder / "flat.tif", shot.flat())
    whole = lfrender.render(
        lfcal.read_flat(folder / "flat.tif"), lfcal.load(folder / "camera.json"), patch_size=_PATCH
    )
    found = []
    resumed = 0
    for number in range(kills):
        name = NAMES[number % len(NAMES)]
        command = [
            sys.executable,
            "-m",
            "benchmarks.stress.tile_faults",
            str(folder),
            name,
            "forever",
        ]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2]
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(rng.uniform(0, _LIFE))
            process.send_signal(signal.SIGKILL)
        path = folder / name
        try:
            if path.exists() and not np.array_equal(lfcal.read_flat(path), whole.image):
                found.append(f"{name}, kill {number}: another picture")
        # This is a hunt for what is not foreseen.
        except Exception as error:
            found.append(f"{name}, kill {number}: {error!r}"[:300])
        try:
            resumed += _render(folder, name).kept > 0
            if not np.array_equal(lfcal.read_flat(path), whole.image):
                found.append(f"{name}, kill {number}: gone on with to another picture")
        except Exception as error:
            found.append(f"{name}, kill {number}: cannot be gone on with: {error!r}"[:300])
        left = sorted(p.name for p in folder.iterdir() if p.name.startswith("."))
        found.extend(f"{one} is left over" for one in left)
        (shutil.rmtree if name.endswith("zarr") else Path.unlink)(path)
    return found, resumed


def main(arguments: list[str]) -> None:
    """Print the faults; exit with 1 if there is one."""
    folder = Path(arguments[0])
    if arguments[2:] == ["forever"]:
        render_for_ever(folder, arguments[1])
    folder.mkdir(parents=True)
    kills = int(arguments[1]) if len(arguments) > 1 else 20
    found, resumed = kill_renderings(folder, kills)
    print(
        "\n".join(found)
        or f"{kills} kills: every picture absent or whole, and {resumed} gone on with"
    )
    sys.exit(bool(found))


if __name__ == "__main__":
    main(sys.argv[1:])
