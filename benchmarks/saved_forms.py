"""Captures saved in other ways: `python -m benchmarks.saved_forms FLAT...`.

Each colour flat of 8 bits is calibrated and analysed unchanged, with other gammas, darker, noisy,
gray, smaller, turned, mirrored, compressed, and in 16 bits with a sixteenth and a sixtieth of the
light. Other flats are tested unchanged, turned, mirrored, and with less light. Compared with the
unchanged flat, the command prints the distance of the centres, the share of textured lenses in its
prevailing mode, and the ratio of resolved lenses, or the reason why a form was refused.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender

__all__ = ["main"]

_Form = Callable[[NDArray[Any]], NDArray[Any]]
# Matrices (2, 3) that bring coordinates of the flat as it is to those of the form, by the size of
# the flat.
_Places = Callable[[int, int], list[list[float]]]


def _as_it_is(width: int, height: int) -> list[list[float]]:
    return [[1, 0, 0], [0, 1, 0]]


def _with_gamma(gamma: float) -> _Form:
    return lambda flat: np.rint(65535 * (flat / 255.0) ** gamma).astype(np.uint16)


def _noisy(flat: NDArray[Any]) -> NDArray[Any]:
    noise = np.random.default_rng(1).normal(0, 4, flat.shape)
    return np.clip(np.rint(flat + noise), 0, 255).astype(np.uint8)


def _compressed(quality: int) -> _Form:
    def form(flat: NDArray[Any]) -> NDArray[Any]:
        coded = cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))

    return form


def _dim(divisor: int) -> _Form:
    return lambda flat: np.rint(flat * (65535 / np.iinfo(flat.dtype).max / divisor)).astype(
        np.uint16
    )


_FORMS: dict[str, tuple[_Form, _Places]] = {
    "as it is": (np.asarray, _as_it_is),
    **{f"gamma {gamma}": (_with_gamma(gamma), _as_it_is) for gamma in (0.7, 1.4, 1.8, 2.2)},
    "floats": (lambda flat: (flat / 255).astype(np.float32), _as_it_is),
    **{f"16 bits, 1/{divisor} of light": (_dim(divisor), _as_it_is) for divisor in (16, 60)},
    "half as bright": (lambda flat: flat // 2, _as_it_is),
    "noise of 4 levels": (_noisy, _as_it_is),
    "gray": (lambda flat: cv2.cvtColor(flat, cv2.COLOR_RGB2GRAY), _as_it_is),
    "0.8 times the size": (
        lambda flat: cv2.resize(flat, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA),
        lambda width, height: [
            [round(0.8 * width) / width, 0, 0.5 * round(0.8 * width) / width - 0.5],
            [0, round(0.8 * height) / height, 0.5 * round(0.8 * height) / height - 0.5],
        ],
    ),
    "turned": (
        lambda flat: np.rot90(flat).copy(),
        lambda width, height: [[0, 1, 0], [-1, 0, width - 1]],
    ),
    "mirrored": (
        lambda flat: flat[:, ::-1].copy(),
        lambda width, height: [[-1, 0, width - 1], [0, 1, 0]],
    ),
    **{f"JPEG {quality}": (_compressed(quality), _as_it_is) for quality in (90, 60, 40)},
}


_OF_ANY_TYPE = ("as it is", "16 bits", "turned", "mirrored")


def _off(lattice: lfcal.Lattice, centres: NDArray[np.float64]) -> float:
    """RMS distance of centres from the nearest of a lattice, in pitches."""
    away = lattice.to_index(centres)
    return (
        float(np.sqrt((((away - np.rint(away)) @ lattice.basis) ** 2).sum(1).mean()))
        / lattice.pitch
    )


def main(paths: list[str]) -> None:
    """Print one line for each form of each flat."""
    for path in paths:
        flat = lfcal.read_flat(path)
        height, width = flat.shape[:2]
        centres = np.empty((0, 2))
        usual = 0
        resolved = 1.0
        any_form = flat.dtype == np.uint8 and flat.ndim == 3
        for name, (form, places) in _FORMS.items():
            if not any_form and not name.startswith(_OF_ANY_TYPE):
                continue
            saved = form(flat)
            head = f"{path.split('/')[-1]:26} {name:22}"
            try:
                camera = lfcal.calibrate(saved)
                depth = lfrender.analyze(saved, camera)
            except lfcal.LightFieldError as error:
                print(f"{head} refused: {error}", flush=True)
                continue
            if not len(centres):
                resolved = float(np.isfinite(depth.patch_size).mean())
                centres = camera.lattice.centres()
                usual = int(np.sign(np.nanmedian(depth.patch_size)))
            matrix = np.array(places(width, height))
            there = centres @ matrix[:, :2].T + matrix[:, 2]
            textured = depth.reason != 1
            print(
                f"{head} pitch {camera.lattice.pitch:.3f} px, centres off by "
                f"{_off(camera.lattice, there):.4f} pitches;"
                f" {100 * (depth.mode == usual)[textured].mean():.2f} % of the textured lenses in "
                f"the mode of the flat"
                f" as it is, {100 * (depth.mode == -usual)[textured].mean():.2f} % in the other;"
                f" {100 * np.isfinite(depth.patch_size).mean() / resolved:.1f} % of its resolved "
                f"lenses",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
