"""Sample data: simulated captures with their truth, made on demand, the same on every machine.

So that documentation, tutorials and reports of bugs are about the same pixels:
`lfrender.data.house()` is traced once and read from the cache after that. Another version of the
simulator makes its own.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal import OutputError

from ..runtime.types import Entries, Size

if TYPE_CHECKING:
    from data_synth import BoardShoot, Camera, Capture

__all__ = [
    "SENSOR_NOISE",
    "board",
    "cache_folder",
    "clutter",
    "house",
    "periodic",
    "plane",
    "ramp",
    "slope",
]

#: Noise of a pixel of the simulated sensors: full well, and standard deviation of reading
#: [electrons].
SENSOR_NOISE = (9000.0, 5.0)


def cache_folder() -> Path:
    """Folder of samples and fetched captures: `$LFRENDER_CACHE`, or the user's cache.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.cache_folder().name
    'lfrender'
    """
    import platformdirs

    return Path(
        os.environ.get("LFRENDER_CACHE") or platformdirs.user_cache_dir("lfrender", appauthor=False)
    )


def _scene(name: str, about: str) -> Callable[..., Capture]:
    """The public function that makes the sample `name`."""

    def make(
        *,
        size: Size = (800, 600),
        pitch: float = 23.2,
        samples: int = 16,
        seed: int = 0,
        **camera: Any,
    ) -> Capture:
        from data_synth import SCENES, Camera, load_capture, simulate

        design = Camera.design(size=size, pitch=pitch, **camera)
        recipe: Entries = {"samples": samples, "seed": seed}

        def trace() -> Capture:
            return simulate(SCENES[name](design, seed=seed), design, noise=SENSOR_NOISE, **recipe)

        sample: Capture = _cached(name, design, recipe, load_capture, trace)
        return sample

    make.__name__ = make.__qualname__ = name
    make.__doc__ = f"""{about}

    `size` is width and height of the flat, `pitch` the distance between neighbouring microimages
    [px], `samples` the number of rays per pixel and microlens. `seed` sets scene, sampling and
    noise; `camera` are further arguments of `data_synth.Camera.design`, such as `lattice="square"`
    or `rotation=3`. Returns a `data_synth.Capture` with `flat`, `white`, `camera` and the `truth`.
    OutputError if the cache cannot be written.

    Examples
    --------
    >>> import lfrender
    >>> sample = lfrender.data.{name}(size=(120, 90), samples=1)
    >>> sample.flat.shape, sample.truth.calibration.lattice.pitch
    ((90, 120, 3), 23.2)
    """
    return make


house = _scene("house", "The house behind branches: telescopic and binocular places on one flat.")
clutter = _scene(
    "clutter", "Balls, boxes and cards before a wall, binocular, depth edges everywhere."
)
plane = _scene("plane", "One plane that faces the camera, binocular.")
slope = _scene("slope", "One slanted plane, binocular.")
ramp = _scene("ramp", "A smooth ramp of brightness, on which every seam shows.")
periodic = _scene("periodic", "Texture that repeats, whose depth is ambiguous.")


def board(
    *,
    size: Size = (800, 600),
    pitch: float = 23.2,
    poses: int = 6,
    samples: int = 16,
    seed: int = 0,
    **camera: Any,
) -> BoardShoot:
    """Photographs of a checkerboard in random poses, for metric calibration.

    Arguments are those of `house`.

    Returns a `data_synth.BoardShoot` with `flats`, `white`, `camera`, and the poses.

    Examples
    --------
    >>> import lfrender
    >>> shoot = lfrender.data.board(poses=2, size=(300, 240))
    >>> len(shoot.flats), shoot.white.shape
    (2, (240, 300))
    """
    from data_synth import BoardShoot, Camera, shoot_board

    design = Camera.design(size=size, pitch=pitch, **camera)
    recipe: Entries = {"poses": poses, "samples": samples, "seed": seed}
    shoot: BoardShoot = _cached(
        "board", design, recipe, BoardShoot.load, lambda: shoot_board(design, **recipe)
    )
    return shoot


def _cached(
    name: str,
    camera: Camera,
    recipe: Entries,
    load: Callable[[Path], Any],
    make: Callable[[], Any],
) -> Any:
    """A sample from its folder in the cache, made and saved there if it is not whole."""
    about = json.dumps(
        [_simulator_digest(), dataclasses.asdict(camera), recipe], sort_keys=True, default=list
    )
    folder = (
        cache_folder() / "samples" / f"{name}-{hashlib.sha256(about.encode()).hexdigest()[:16]}"
    )
    if folder.is_dir():
        try:
            return load(folder)
        except (OSError, ValueError, KeyError):
            # Damaged, or left by a run that was killed: made again.
            shutil.rmtree(folder, ignore_errors=True)
    sample = make()
    unfinished = folder.with_name(f"{folder.name}.{secrets.token_hex(4)}")
    try:
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        sample.save(unfinished)
        unfinished.replace(folder)
    except OSError as error:
        # Another process may have been faster; its files are the same.
        if not folder.is_dir():
            problem = f"cannot be written ({error.strerror or error})"
            remedy = "set LFRENDER_CACHE to another folder"
            raise OutputError(f"{folder}: {problem}; {remedy}") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    # Read again, so that the first call and all later ones give the same.
    return load(folder)


@cache
def _simulator_digest() -> str:
    """SHA-256 of the sources of the simulator: what another version makes is another sample."""
    import data_synth

    sources = sorted(
        (item for item in files(data_synth).iterdir() if item.name.endswith(".py")),
        key=lambda s: s.name,
    )
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
