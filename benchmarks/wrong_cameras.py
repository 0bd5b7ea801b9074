"""Shares of noticed wrong cameras and of false alarms.

`python -m benchmarks.wrong_cameras FIRST LAST [FLAT CAMERA.json]...`

Each seed simulates a scene and a white image of a random camera. The camera is calibrated on the
white image and checked against the scene, unchanged and in degraded forms. Wrong cameras are
turned by 90 or 5 degrees, mirrored, shifted by a third of a pitch in a random direction or by half
a cell, 0.5 or 3 % too long or short, stretched by 0.045 pitches in the corners (another camera of
the same kind), or have their lens types in another order. Whether `analyze` in Python notices them
is counted as well, where the lattice is wrong. Captures with their cameras may be added. Two cases
are counted separately: forms whose message says that no microimages can be seen, and cameras whose
lattice does not change when it is turned or mirrored (within 0.06 pitches).

Last, each scene and capture is calibrated alone, and the camera is checked on it as if it were
another flat: contradictions are printed with the confidence that was stated.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal
from lfrender.flat.validation import check_flat, verify_camera

from .random_scenes import draw

__all__ = ["main"]

_SAMPLES = 24
_SAME = 0.06
_STRETCH = 0.045
_TURN = np.array([[0, 1], [-1, 0]])
_MIRROR = np.array([[-1, 0], [0, 1]])
_ANGLE = np.radians(5)
_FIVE_DEGREES = np.array([[np.cos(_ANGLE), np.sin(_ANGLE)], [-np.sin(_ANGLE), np.cos(_ANGLE)]])
_LONGER = 1.03


def _forms(flat: NDArray[Any], rng: np.random.Generator) -> Iterator[tuple[str, NDArray[Any]]]:
    """The flat unchanged and in degraded forms."""
    eight = flat if flat.dtype == np.uint8 else (flat // 257).astype(np.uint8)
    yield "as it is", flat
    yield "a quarter as bright", eight // 4
    yield (
        "noise of 6 levels",
        np.clip(eight + rng.normal(0, 6, flat.shape), 0, 255).astype(np.uint8),
    )
    yield (
        "JPEG 50",
        np.asarray(cv2.imdecode(cv2.imencode(".jpg", eight, [1, 50])[1], cv2.IMREAD_UNCHANGED)),
    )


def _wrong_cameras(
    camera: lfcal.Calibration, rng: np.random.Generator
) -> Iterator[tuple[str, lfcal.Calibration]]:
    lattice = camera.lattice
    types = camera.lens_types
    middle = (np.array(lattice.image_size) - 1) / 2
    angle = rng.uniform(0, 2 * np.pi)
    third = lattice.pitch / 3 * np.array([np.cos(angle), np.sin(angle)])
    scale = 1 + 0.005 * rng.choice([-1, 1])
    stretch = 1 + rng.choice([-1, 1]) * _STRETCH * lattice.pitch / float(np.hypot(*middle))
    changes = {
        "turned": _TURN,
        "mirrored": _MIRROR,
        "pitch": scale * np.eye(2),
        "stretched": stretch * np.eye(2),
        "5 degrees": _FIVE_DEGREES,
        "3 %": _LONGER * np.eye(2),
    }
    for name, matrix in changes.items():
        origin = middle + (lattice.origin - middle) @ matrix
        basis = lattice.basis @ matrix
        yield (
            name,
            replace(camera, lattice=replace(lattice, origin=origin, basis=basis, distortion=None)),
        )
    half = lattice.basis.sum(0) / 2
    for name, shift in (("shifted", third), ("half a cell", half)):
        yield name, replace(camera, lattice=replace(lattice, origin=lattice.origin + shift))
    if types is not None and types.ordered:
        order = rng.permutation(types.count)
        while (order == np.arange(types.count)).all():
            order = rng.permutation(types.count)
        yield (
            "type order",
            replace(
                camera,
                lens_types=lfcal.LensTypes(order[types.cell].astype(np.int8), True, types.focus),
            ),
        )


def _is_same(one: lfcal.Lattice, other: lfcal.Lattice) -> bool:
    away = other.to_index(one.centres())
    return (
        float(np.linalg.norm((away - np.rint(away)) @ other.basis, axis=1).max())
        < _SAME * one.pitch
    )


def _is_silent(flat: NDArray[Any], camera: lfcal.Calibration) -> bool:
    """Whether `lfrender.analyze` takes the camera without an error or a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            verify_camera(check_flat(flat, camera), camera)
        except (UserWarning, lfcal.CameraError):
            return False
    return True


def _check_own(name: str, flat: NDArray[Any], count: Counter[str]) -> None:
    """Count whether the camera found on a flat is contradicted there."""
    try:
        camera = lfcal.calibrate(flat)
    except lfcal.CalibrationError:
        count["own: refused"] += 1
        return
    problem = lfcal.check_camera(flat, replace(camera, flats=())).problem
    count["own"] += 1
    if problem is not None:
        count["own: contradicted"] += 1
        print(f"{name}: own camera, confidence {camera.confidence_text}: {problem}", flush=True)


def main(arguments: list[str]) -> None:
    """Print every mistake, and the numbers of right and wrong cameras and of mistakes."""
    first = int(arguments[0])
    last = int(arguments[1])
    files = arguments[2:]
    count: Counter[str] = Counter()
    rng = np.random.default_rng(first)

    def captures() -> Iterator[tuple[str, NDArray[Any], lfcal.Calibration]]:
        for seed in range(first, last):
            text, capture = draw(seed, _SAMPLES)
            yield f"{seed} {text}", capture.flat, lfcal.calibrate(capture.white, kind="white")
        for flat, camera in zip(files[::2], files[1::2], strict=True):
            yield flat, lfcal.read_flat(flat), lfcal.load(camera)

    for name, flat, camera in captures():
        for form, pixels in _forms(flat, rng):
            check = lfcal.check_camera(pixels, camera)
            problem = check.problem
            count["right"] += 1
            count["right: said that no microimages can be seen"] += not check.checked
            if problem is not None:
                count["false alarms"] += 1
                print(f"{name}, {form}: false alarm: {problem}", flush=True)
            for kind, wrong in _wrong_cameras(camera, rng):
                if kind in ("turned", "mirrored") and _is_same(wrong.lattice, camera.lattice):
                    count["the same lattice"] += 1
                    continue
                count[f"wrong: {kind}"] += 1
                check = lfcal.check_camera(pixels, wrong)
                if check.checked and kind != "type order" and _is_silent(pixels, wrong):
                    count[f"silent in Python: {kind}"] += 1
                if not check.checked:
                    count["wrong: said that no microimages can be seen"] += 1
                elif check.problem is None:
                    count[f"missed: {kind}"] += 1
                    print(f"{name}, {form}: {kind} is not noticed", flush=True)
        _check_own(name, flat, count)
    print(dict(count))


if __name__ == "__main__":
    main(sys.argv[1:])
