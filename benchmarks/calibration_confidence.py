"""Is the confidence of a calibration a probability? `python -m benchmarks.calibration_confidence
FIRST LAST [SHARED]`.

For each seed: the scene and the white image of a random camera (`benchmarks.random_scenes`), the
scene of one of square apertures with gaps, of three lens types of different radii, or with colour
filters, and every third seed a picture that is not a flat (`benchmarks.no_flats`). With SHARED, the
white images in that folder are added. A result is right if no centre is missing and all centres
lie within a twentieth of the pitch of the true ones.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal
from data_synth import SCENES, Camera, Capture, simulate

from .no_flats import draw_no_flat
from .random_scenes import draw

__all__ = ["draw_kind", "main"]

_SAMPLES = 8
_SURE = 0.9
_RIGHT = 0.05


def draw_kind(seed: int) -> tuple[str, Capture]:
    """Description and capture of a camera of one of the kinds, in turn, before a random scene."""
    rng = np.random.default_rng([seed, 52])
    kind = ("square aperture", "three radii", "mosaic")[seed % 3]
    pitch = float(np.exp(rng.uniform(*np.log((12.0, 60.0)))))
    width = int(pitch * rng.uniform(24, 46))
    size = (width, int(0.75 * width))
    turned = float(rng.uniform(-25, 25))
    if kind == "square aperture":
        camera = Camera.design(
            size, pitch, "square", turned, microimage_fill=float(rng.uniform(0.82, 0.97))
        )
        camera = camera.replace(square_aperture=True)
    else:
        lattice = str(rng.choice(["hex", "hex-vertical"]))
        camera = Camera.design(size, pitch, lattice, turned, focus=(0.08, 0.2, 0.32))
        if kind == "three radii":
            shares = rng.permutation([1.0, *rng.uniform(0.86, 1.0, 2)])
            camera = camera.replace(
                type_apertures=tuple(shares.tolist()), stray=float(rng.uniform(0, 0.3))
            )
        else:
            mosaic = str(rng.choice(["RGGB", "BGGR", "GRBG", "GBRG"]))
            camera = camera.replace(mosaic=mosaic, filters=tuple(rng.uniform(0.5, 1.0, 3).tolist()))
    name = str(rng.choice(["house", "plane", "slope", "clutter"]))
    noise = float(np.exp(rng.uniform(*np.log((800.0, 20000.0))))), float(rng.uniform(2.0, 6.0))
    gamma = bool(rng.random() < 0.7)
    capture = simulate(
        SCENES[name](camera, seed=seed),
        camera,
        samples=_SAMPLES,
        seed=seed,
        noise=noise,
        gamma=gamma,
    )
    return f"{name}, {kind}, {pitch:.1f} px, {turned:+.0f} degrees, {noise[0]:.0f} e", capture


def _is_right(found: lfcal.Lattice, centres: NDArray[np.float64], pitch: float) -> bool:
    """Whether the lattice has exactly the true centres (n, 2) [px]."""
    index = np.rint(found.to_index(centres))
    apart = np.hypot(*(found.points(index) - centres).T)
    # Neighbours on the found lattice are neighbours in truth.
    return bool(
        np.sqrt((apart**2).mean()) < _RIGHT * pitch and abs(found.pitch / pitch - 1) < _RIGHT
    )


def _cases(
    first: int, last: int, shared: Path | None
) -> Iterator[tuple[str, str, NDArray[Any], Any]]:
    """Group, name, flat, and true centres and pitch, or None where the picture is no flat."""
    for seed in range(first, last):
        text, capture = draw(seed, _SAMPLES)
        lattice = capture.truth.calibration.lattice
        yield "scenes", f"{seed} {text}", capture.flat, (lattice.centres(), lattice.pitch)
        yield "white images", f"{seed} {text}", capture.white, (lattice.centres(), lattice.pitch)
        text, capture = draw_kind(seed)
        lattice = capture.truth.calibration.lattice
        yield (
            "scenes, other kinds",
            f"{seed} {text}",
            capture.flat,
            (lattice.centres(), lattice.pitch),
        )
        if seed % 3 == 0:
            name, pixels = draw_no_flat(seed // 3)
            yield "no flats", f"{seed // 3} {name}", pixels, None
    for file in sorted(
        p for folder in ("kinds", "whites") for p in ((shared or Path()) / folder).glob("*.npz")
    ):
        table = np.load(file)
        centres = table["centre_px"]
        index = table["ij"]
        picture = next(
            file.with_suffix(suffix)
            for suffix in (".png", ".jpg")
            if file.with_suffix(suffix).exists()
        )
        design = np.column_stack([np.ones(len(index)), index])
        origin, *basis = np.linalg.lstsq(design, centres, rcond=None)[0]
        pitch = lfcal.Lattice(origin, np.array(basis), (1, 1), 1.0).pitch
        yield "white images of others", file.stem, lfcal.read_flat(picture), (centres, pitch)


def main(arguments: list[str]) -> None:
    """Print all results that are wrong, refused or doubted, and the counts of each group."""
    first = int(arguments[0])
    last = int(arguments[1])
    count: dict[str, Counter[str]] = {}
    for group, name, flat, truth in _cases(
        first, last, Path(arguments[2]) if len(arguments) > 2 else None
    ):
        try:
            camera = lfcal.calibrate(flat)
        except lfcal.LightFieldError as error:
            result = "refused"
            text = str(error)
        else:
            right = truth is not None and _is_right(camera.lattice, *truth)
            result = (
                f"{'right' if right else 'wrong'}, "
                f"{'sure' if camera.confidence >= _SURE else 'doubted'}"
            )
            text = (
                f"{camera.source} {camera.lattice.pitch:.2f} px, confidence {camera.confidence:.2f}"
            )
        count.setdefault(group, Counter())[result] += 1
        if result != ("refused" if truth is None else "right, sure"):
            print(f"{group}: {name}: {result}: {text}", flush=True)
    for group, results in count.items():
        print(f"{group}: {dict(results)}")
    every: Counter[str] = sum(count.values(), Counter())
    sure = every["right, sure"] + every["wrong, sure"]
    print(f"of {sure} results of confidence {_SURE} and more, {every['wrong, sure']} are wrong")


if __name__ == "__main__":
    main(sys.argv[1:])
