"""What a simulation hands out: the flat, its white image, and the truth, with their files."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .camera import Camera

__all__ = ["Capture", "Truth", "load_capture", "read_png", "write_png"]

_SCHEMA = "lfsynth-capture"
_VERSION = 1
_ARRAYS = (
    "patch_size",
    "mode",
    "magnification",
    "mixed",
    "contrast",
    "lens_type",
    "disparity",
    "reference_affine",
    "reference_patch_size",
)


@dataclass(frozen=True)
class Truth:
    """What is exactly known about a simulated capture. Per-lens arrays follow
    `calibration.lattice.centres()`.

    Parameters
    ----------
    calibration : lfcal.Calibration
        True lattice of microimage centres (chief rays through the microlens centres), radius and
        vignetting.
    patch_size : (n,) float64 [px]
        Signed `s` of what each lens shows at its centre, NaN where that is nothing.
    mode : (n,) int8
        1 telescopic, -1 binocular, 0 unresolvable: `|s|` above 0.75 D, or no texture, or nothing
        there.
    magnification : (n,) float64
        `D / |s|`, NaN where mode is 0.
    mixed : (n,) bool
        Several depths within 0.36 D of the centre.
    contrast : (n,) float64
        Standard deviation over mean of the linear luminance within 0.36 D of the centre.
    lens_type : (n,) int8
        Index of the microlens focal length.
    disparity : (H, W) float32 [px]
        Signed `s` of what each sensor pixel sees through its lens, NaN outside microimages.
    reference : (h, w, 3) uint8 or uint16
        All-in-focus picture: a pinhole at the main-lens centre, same transfer curve as the flat, no
        noise.
    reference_affine : (2, 3) float64
        Reference pixel `(u, v, 1)` to scene coordinates `X` [flat px].
    reference_patch_size : (h, w) float32 [px]
        Signed `s` on the grid of the reference.

    Examples
    --------
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> truth = simulate(SCENES["plane"](camera, ratio=-0.3), camera, samples=1).truth
    >>> set(truth.mode.tolist()) <= {-1, 0}
    True
    """

    calibration: Calibration
    patch_size: NDArray[np.float64]
    mode: NDArray[np.int8]
    magnification: NDArray[np.float64]
    mixed: NDArray[np.bool_]
    contrast: NDArray[np.float64]
    lens_type: NDArray[np.int8]
    disparity: NDArray[np.float32]
    reference: NDArray[Any]
    reference_affine: NDArray[np.float64]
    reference_patch_size: NDArray[np.float32]


@dataclass(frozen=True)
class Capture:
    """One simulated exposure.

    Parameters
    ----------
    flat : (H, W, 3) uint8 or uint16
        Raw picture, order R, G, B; (H, W) of a camera with a mosaic.
    white : (H, W) uint8 or uint16
        White image of the same camera.
    truth : Truth
    camera : Camera
    recipe : dict
        How it was made, as plain values: scene, samples, seed, noise, bits, gamma, exposure.

    Examples
    --------
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> capture = simulate(SCENES["plane"](camera), camera, samples=1)
    >>> capture.flat.dtype, capture.truth.calibration.source
    (dtype('uint8'), 'truth')
    """

    flat: NDArray[Any]
    white: NDArray[Any]
    truth: Truth
    camera: Camera
    recipe: dict[str, Any]

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write flat.png, white.png, reference.png, truth.npz, camera.json (for lfcal and lfrender)
        and truth.json.

        Each file appears whole or not at all, truth.json last.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        for name, picture in (
            ("flat", self.flat),
            ("white", self.white),
            ("reference", self.truth.reference),
        ):
            _write(target / f"{name}.png", _png(picture))
        arrays = io.BytesIO()
        np.savez_compressed(arrays, **{name: getattr(self.truth, name) for name in _ARRAYS})
        _write(target / "truth.npz", arrays.getvalue())
        self.truth.calibration.save(target / "camera.json")
        about = {
            "schema": _SCHEMA,
            "version": _VERSION,
            "camera": dataclasses.asdict(self.camera),
            "recipe": self.recipe,
            "calibration": self.truth.calibration.to_dict(),
            "summary": self.summary(),
        }
        _write(target / "truth.json", (json.dumps(about, indent=2) + "\n").encode())

    def summary(self) -> dict[str, Any]:
        """Counts of lenses by mode, the range of `s / D`, and sizes, as plain values."""
        truth = self.truth
        seen = truth.patch_size[np.isfinite(truth.patch_size)] / self.camera.pitch
        return {
            "scene": self.recipe["scene"],
            "width": self.camera.width,
            "height": self.camera.height,
            "pitch": self.camera.pitch,
            "lenses": len(truth.mode),
            "telescopic": int((truth.mode == 1).sum()),
            "binocular": int((truth.mode == -1).sum()),
            "unresolvable": int((truth.mode == 0).sum()),
            "mixed": int(truth.mixed.sum()),
            "patch_size_over_pitch": [float(seen.min()), float(seen.max())] if len(seen) else None,
        }


def load_capture(folder: str | os.PathLike[str]) -> Capture:
    """Read what `Capture.save` wrote.

    Raises
    ------
    OSError
        If a file is missing or cannot be read.
    ValueError
        If a file is not part of a capture, or damaged.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> capture = simulate(SCENES["blank"](camera), camera, samples=1)
    >>> with TemporaryDirectory() as folder:
    ...     capture.save(folder)
    ...     load_capture(folder).flat.shape
    (90, 120, 3)
    """
    source = Path(folder)
    try:
        about = json.loads((source / "truth.json").read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{source / 'truth.json'}: not valid JSON ({error})") from error
    if (
        not isinstance(about, dict)
        or about.get("schema") != _SCHEMA
        or about.get("version") != _VERSION
    ):
        raise ValueError(
            f"{source}: not a capture that this version of lfsynth wrote; simulate it again"
        )
    try:
        camera = Camera(**about["camera"])
        calibration = Calibration.from_dict(about["calibration"])
        with np.load(source / "truth.npz") as stored:
            arrays = {name: stored[name] for name in _ARRAYS}
        recipe = about["recipe"]
    except (KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{source}: truth is incomplete or damaged ({error}); simulate it again"
        ) from error
    size = (camera.height, camera.width)
    flat, white, reference = (
        read_png(source / f"{name}.png") for name in ("flat", "white", "reference")
    )
    if (
        flat.shape != (size if camera.mosaic else (*size, 3))
        or white.shape != size
        or arrays["disparity"].shape != size
    ):
        raise ValueError(f"{source}: flat, white image and truth differ in size; simulate it again")
    return Capture(
        flat, white, Truth(calibration=calibration, reference=reference, **arrays), camera, recipe
    )


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a picture, grey or RGB; the file appears whole or not at all."""
    _write(path, _png(picture))


def _png(picture: NDArray[Any]) -> bytes:
    ordered = picture[..., ::-1] if picture.ndim == 3 else picture
    done, data = cv2.imencode(".png", np.ascontiguousarray(ordered))
    if not done:
        raise OSError("picture cannot be encoded as PNG")
    return data.tobytes()


def read_png(path: Path) -> NDArray[Any]:
    """Read a picture, grey or RGB; ValueError if it is none."""
    picture = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise ValueError(f"{path}: not a picture; simulate it again")
    return np.ascontiguousarray(picture[..., ::-1]) if picture.ndim == 3 else picture


def _write(path: Path, data: bytes) -> None:
    # Not from `tempfile`: its files are private to the user, a capture is not.
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
