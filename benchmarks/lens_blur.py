"""Measured discs of microlenses against the true ones: `python -m benchmarks.lens_blur ../shared |
FIRST LAST`.

Of each ray-traced flat of `truth/`, or of the random cameras and scenes of `benchmarks.detail` with
these seeds, the disc is printed that the rims of its white image tell, and the discs that the
capture tells at its depths: the likeliest one, the least possible one and the true one, with the
rims unknown and known. Of real captures the discs by lens type. Truth is the aperture and focus of
the simulated camera; the last lines count discs that lie above it.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender

__all__ = ["main"]

_CAPTURES = ("Fujita2.png", "Boys2.webp", "MiniGarden2.webp", "R5b.png")
_TOLERANCE = 0.2  # [px] that a disc may lie above the true one


class _Known(NamedTuple):
    name: str
    flat: NDArray[Any]
    white: NDArray[Any]
    aperture: float  # [px]
    focus: NDArray[np.float64]  # (types,) s / D


def _truth_cases(folder: Path) -> Iterator[_Known]:
    for path in sorted(folder.iterdir()):
        if not path.is_dir():
            continue
        camera = json.loads((path / "truth.json").read_text())["camera"]
        focus = np.array(camera["focus_disparity_px"]) / camera["D"]
        flat, white = (lfcal.read_flat(path / f"{name}.png") for name in ("flat", "white"))
        yield _Known(path.name, flat, white, camera["fill"] * camera["D"], focus)


def _random_cases(first: int, last: int) -> Iterator[_Known]:
    from .detail import random_shot

    for seed in range(first, last + 1):
        name, camera, shot = random_shot(seed)
        lattice = camera.calibration().lattice
        # `s / D` of the image plane that each type is focused at.
        distance = 1 / (1 / np.array(camera.microlens_focal_lengths) - 1 / camera.sensor_distance)
        slope = camera.sensor_distance / camera.mla_distance
        focus = (camera.sensor_distance / distance - slope) / (1 + slope)
        # As lens types are ordered: from focus at the largest patches to that at the smallest.
        focus = focus[np.argsort(-np.abs(focus))]
        yield _Known(name, shot.flat, shot.white, camera.fill * lattice.pitch, focus)


def _row(case: _Known) -> tuple[str, list[float]]:
    """A row of the table, and by how much [px] the least discs lie above the true ones."""
    camera = lfcal.calibrate(case.white, kind="white")
    rims = camera.lens_blur
    cells = []
    above = []
    if rims is None:
        cells.append("-")
    else:
        discs, errors = rims.at([0.0])
        truth = case.aperture * np.abs(case.focus)
        found = zip(discs[:, 0], errors[:, 0], strict=True)
        cells.append(
            " ".join(f"{disc:.2f} +- {error:.2f}" for disc, error in found) + f" ({_list(truth)})"
        )
    for one in (replace(camera, lens_blur=None), camera):
        depth = lfrender.analyze(case.flat, one)
        blur = depth.lens_blur
        if blur is None or len(blur.focus) != len(case.focus):
            cells.append("-")
            continue
        truth = case.aperture * np.abs(blur.ratios - case.focus[:, None])
        least = blur.discs - blur.disc_errors
        above += (least - truth).ravel().tolist()
        some = np.unique(np.linspace(0, len(blur.ratios) - 1, 3).astype(int))
        told = [
            f"{blur.ratios[k]:+.2f} D: {_list(blur.discs[:, k])}, {_list(least[:, k])} ({_list(truth[:, k])})"
            for k in some
        ]
        cells.append("; ".join(told))
    return f"| {case.name} | {' | '.join(cells)} |", above


def _list(values: NDArray[np.float64]) -> str:
    return " / ".join(f"{value:.2f}" for value in np.abs(values).ravel())


def _print_capture(path: Path) -> None:
    flat = lfcal.read_flat(path)
    camera = lfcal.calibrate(flat)
    blur = lfrender.analyze(flat, camera).lens_blur
    if blur is None:
        print(f"{path.name}: nothing is measured")
        return
    for ratio, discs, errors in zip(blur.ratios, blur.discs.T, blur.disc_errors.T, strict=True):
        print(
            f"{path.name}: at {ratio:+.2f} D likeliest {_list(discs)}, least {_list(discs - errors)} px"
        )


def main(arguments: list[str]) -> None:
    """Print the tables."""
    warnings.simplefilter("ignore", UserWarning)
    cases = (
        _random_cases(*map(int, arguments))
        if len(arguments) > 1
        else _truth_cases(Path(arguments[0]) / "truth")
    )
    print(
        "| flat | rims (truth) [px] | capture: likeliest, least (truth) [px] | with rims |\n|---|---|---|---|"
    )
    above: list[float] = []
    for case in cases:
        row, more = _row(case)
        above += more
        print(row, flush=True)
    if above:
        over = int((np.array(above) > _TOLERANCE).sum())
        print(
            f"least discs above the truth by more than {_TOLERANCE} px: {over} of {len(above)}, most {max(above):.2f}"
        )
    for name in _CAPTURES if len(arguments) == 1 else ():
        _print_capture(Path(arguments[0]) / "captures" / name)


if __name__ == "__main__":
    main(sys.argv[1:])
