"""Sample data: simulated captures with their truth, made on demand and kept, the same on every machine.

So that documentation, tutorials and reports of bugs are about the same pixels: `lfrender.data.house()` is traced once
and read from the cache after that. Another version of the simulator makes its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from lfcal import OutputError

if TYPE_CHECKING:
    from data_synth import BoardShoot, Camera, Capture

__all__ = ["board", "cache_folder", "clutter", "house", "periodic", "plane", "ramp", "slope"]

_Made = TypeVar("_Made")
#: Environment variable that names another folder for the cache; it changes no result.
CACHE_VARIABLE = "LFRENDER_CACHE"
_NOISE = (9000.0, 5.0)


def cache_folder() -> Path:
    """Where samples and fetched captures are kept: `$LFRENDER_CACHE`, or the user's cache of the system.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.cache_folder().name
    'lfrender'
    """
    given = os.environ.get(CACHE_VARIABLE)
    if given:
        return Path(given)
    import platformdirs

    return Path(platformdirs.user_cache_dir("lfrender", appauthor=False))


def house(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """The house behind branches: telescopic and binocular places on one flat.

    Parameters
    ----------
    size : (int, int) [px]
        Width and height of the flat.
    pitch : float [px]
        Distance between neighbouring microimages.
    samples : int
        Rays per pixel and microlens.
    seed : int
        Of the scene, of sampling and noise.
    **camera
        Further arguments of `data_synth.Camera.design`, such as `lattice="square"` or `rotation=3`.

    Returns
    -------
    data_synth.Capture
        With `flat`, `white`, `camera`, and the `truth`.

    Raises
    ------
    OutputError
        If the cache cannot be written.

    Examples
    --------
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(120, 90), samples=1)
    >>> sample.flat.shape, sample.truth.calibration.lattice.pitch
    ((90, 120, 3), 23.2)
    """
    return _scene("house", size, pitch, samples, seed, camera)


def clutter(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """Balls, boxes and cards before a wall, binocular, depth edges everywhere; arguments as of `house`.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.clutter(size=(120, 90), samples=1).flat.shape
    (90, 120, 3)
    """
    return _scene("clutter", size, pitch, samples, seed, camera)


def plane(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """One plane that faces the camera, binocular; arguments as of `house`.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.plane(size=(120, 90), samples=1).flat.shape
    (90, 120, 3)
    """
    return _scene("plane", size, pitch, samples, seed, camera)


def slope(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """One slanted plane, binocular; arguments as of `house`.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.slope(size=(120, 90), samples=1).flat.shape
    (90, 120, 3)
    """
    return _scene("slope", size, pitch, samples, seed, camera)


def ramp(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """A smooth ramp of brightness, on which every seam shows; arguments as of `house`.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.ramp(size=(120, 90), samples=1).flat.shape
    (90, 120, 3)
    """
    return _scene("ramp", size, pitch, samples, seed, camera)


def periodic(
    *, size: tuple[int, int] = (800, 600), pitch: float = 23.2, samples: int = 16, seed: int = 0, **camera: Any
) -> Capture:
    """Texture that repeats, whose depth is ambiguous; arguments as of `house`.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.data.periodic(size=(120, 90), samples=1).flat.shape
    (90, 120, 3)
    """
    return _scene("periodic", size, pitch, samples, seed, camera)


def board(
    *,
    size: tuple[int, int] = (800, 600),
    pitch: float = 23.2,
    poses: int = 6,
    samples: int = 16,
    seed: int = 0,
    **camera: Any,
) -> BoardShoot:
    """Photographs of a checkerboard in random poses, for metric calibration; arguments as of `house`.

    Returns
    -------
    data_synth.BoardShoot
        With `flats`, `white`, `camera`, and the poses.

    Examples
    --------
    >>> import lfrender
    >>> shoot = lfrender.data.board(poses=2, size=(300, 240))
    >>> len(shoot.flats), shoot.white.shape
    (2, (240, 300))
    """
    from data_synth import shoot_board

    design = _design(size, pitch, camera)
    recipe = {"poses": poses, "samples": samples, "seed": seed}
    return _cached("board", design, recipe, _load_board, lambda: shoot_board(design, poses, samples=samples, seed=seed))


def _design(size: tuple[int, int], pitch: float, options: dict[str, Any]) -> Camera:
    from data_synth import Camera

    return Camera.design(size=size, pitch=pitch, **options)


def _scene(name: str, size: tuple[int, int], pitch: float, samples: int, seed: int, options: dict[str, Any]) -> Capture:
    """A capture of a named scene, from the cache or simulated."""
    from data_synth import SCENES, load_capture, simulate

    camera = _design(size, pitch, options)

    def make() -> Capture:
        return simulate(SCENES[name](camera, seed=seed), camera, samples=samples, seed=seed, noise=_NOISE)

    return _cached(name, camera, {"samples": samples, "seed": seed}, load_capture, make)


def _cached(
    name: str, camera: Camera, recipe: dict[str, Any], load: Callable[[Path], _Made], make: Callable[[], _Made]
) -> _Made:
    """A sample from its folder in the cache, made and saved there if it is not whole."""
    import dataclasses

    about = json.dumps([_simulator_digest(), dataclasses.asdict(camera), recipe], sort_keys=True, default=list)
    folder = cache_folder() / "samples" / f"{name}-{hashlib.sha256(about.encode()).hexdigest()[:16]}"
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
        sample.save(unfinished)  # type: ignore[attr-defined]
        try:
            unfinished.replace(folder)
        except OSError:
            # Another process was faster; its files are the same.
            if not folder.is_dir():
                raise
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error.strerror or error}); set {CACHE_VARIABLE} to another folder"
        ) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    # Read again, so that the first call and all later ones give the same.
    return load(folder)


@cache
def _simulator_digest() -> str:
    """SHA-256 of the sources of the simulator: what another version makes is another sample."""
    import data_synth

    digest = hashlib.sha256()
    for source in sorted(files(data_synth).iterdir(), key=lambda item: item.name):
        if source.name.endswith(".py"):
            digest.update(source.read_bytes())
    return digest.hexdigest()


def _load_board(folder: Path) -> BoardShoot:
    from data_synth import BoardShoot, Camera
    from lfcal import read_flat

    about = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    poses = about["poses"]
    flats = tuple(read_flat(folder / pose["file"]) for pose in poses)
    turns, shifts = (np.array([pose[key] for pose in poses]) for key in ("R", "t_mm"))
    camera = Camera(**about["camera"])
    return BoardShoot(flats, read_flat(folder / "white.png"), turns, shifts, about["board"]["square_mm"], camera)
