"""Measured discs of microlenses against the true ones: `python -m benchmarks.lens_blur ../shared |
FIRST LAST | boards FIRST LAST | boards ../shared`.

Of each ray-traced flat of `truth/`, or of the random cameras and scenes of `benchmarks.detail` with
these seeds, the disc is printed that the rims of its white image tell, and the discs that the
capture tells at its depths: the likeliest one, the least possible one and the true one, with the
rims unknown and known. Of real captures the discs by lens type. With `boards`, the discs that
`calibrate_metric` measures on boards before the random cameras of `benchmarks.metric_cameras`, or,
of `../shared`, on its ray-traced boards. Truth is the aperture and focus of the simulated camera;
the last lines count discs that lie above it.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import Camera

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


def _true_focus(camera: Camera) -> NDArray[np.float64]:
    """(types,) `s / D` of the image plane that each type of microlens is focused at."""
    distance = 1 / (1 / np.array(camera.microlens_focal_lengths) - 1 / camera.sensor_distance)
    slope = camera.sensor_distance / camera.mla_distance
    return np.asarray((camera.sensor_distance / distance - slope) / (1 + slope))


def _random_cases(first: int, last: int) -> Iterator[_Known]:
    from .detail import random_shot

    for seed in range(first, last + 1):
        name, camera, shot = random_shot(seed)
        lattice = camera.calibration().lattice
        focus = _true_focus(camera)
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
            f"{blur.ratios[k]:+.2f} D: {_list(blur.discs[:, k])}, {_list(least[:, k])} "
            f"({_list(truth[:, k])})"
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
            f"{path.name}: at {ratio:+.2f} D likeliest {_list(discs)}, "
            f"least {_list(discs - errors)} px"
        )


def _print_boards(
    name: str,
    flats: list[NDArray[Any]],
    white: NDArray[Any],
    square: float,
    pixel: float,
    aperture: float,
    focus: Callable[[lfcal.Calibration], NDArray[np.float64]],
) -> None:
    """What `calibrate_metric` measures; `focus` gives the true ones in the order of a camera's lens
    types.
    """
    array = lfcal.calibrate(white, kind="white")
    for told, camera in (("with rims", array), ("boards alone", replace(array, lens_blur=None))):
        board = lfcal.Board(9, 6, square)
        found = lfcal.calibrate_metric(flats, camera, board, pixel=pixel).calibration
        blur = found.lens_blur
        true = focus(found)
        if blur is None or not blur.tells_aperture or len(true) != len(blur.focus):
            print(f"| {name} | {told} | not told |", flush=True)
            continue
        truth = aperture * np.abs(blur.ratios - true[:, None])
        off = blur.discs - truth
        foci = " / ".join(
            f"{one:+.3f} +- {error:.3f} ({right:+.3f})"
            for one, error, right in zip(blur.focus, blur.focus_error, true, strict=True)
        )
        print(
            f"| {name} | {told} | {blur.aperture:.2f} +- {blur.aperture_error:.2f} "
            f"({aperture:.2f}) | {foci} | {blur.ratios.min():+.2f} to {blur.ratios.max():+.2f} | "
            f"{off.min():+.2f} to {off.max():+.2f} | "
            f"{np.sqrt(np.mean((off / blur.disc_errors) ** 2)):.2f} |",
            flush=True,
        )


def _print_shared_boards(folder: Path) -> None:
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    known = truth["camera"]
    near = known["mla_to_sensor_mm"]
    slope = near / known["mainlens_to_mla_mm"]
    focus = (near / known["microlens_f_mm"][0] - 1 - slope) / (1 + slope)
    aperture = known["microlens_aperture_mm"] / known["microlens_pitch_mm"] * known["D_px"]
    flats = [lfcal.read_flat(folder / pose["file"]) for pose in truth["poses"]]
    white = lfcal.read_flat(folder / "white.png")
    _print_boards(
        "boards/",
        flats,
        white,
        truth["board"]["square_mm"],
        known["pixel_mm"],
        aperture,
        lambda found: np.array([focus]),
    )


def _print_random_boards(first: int, last: int) -> None:
    from data_synth import shoot_board

    from .metric_cameras import random_camera

    for seed in range(first, last + 1):
        camera, ratios = random_camera(seed)
        shoot = shoot_board(camera, 8, ratios=ratios, samples=32, seed=seed)
        true = _true_focus(camera)

        def focus(
            found: lfcal.Calibration,
            camera: Camera = camera,
            true: NDArray[np.float64] = true,
        ) -> NDArray[np.float64]:
            """The true foci by the types of lenses in the middle of the flat."""
            lattice = camera.lattice
            if found.lens_types is None:
                return true[:1]
            centres = found.lattice.centres()
            near = np.argsort(np.hypot(*(centres - np.array(lattice.image_size) / 2).T))[:50]
            own = found.lens_types.of(found.lattice.indices()[near])
            step = (centres[near] - lattice.origin) @ np.linalg.inv(lattice.basis)
            i, j = np.rint(step).astype(int).T
            simulated = (i - j) % len(true)
            kinds = range(found.lens_types.count)
            return np.array([true[np.bincount(simulated[own == kind]).argmax()] for kind in kinds])

        _print_boards(
            str(seed),
            list(shoot.flats),
            shoot.white,
            shoot.square,
            camera.pixel,
            camera.fill * camera.lattice.pitch,
            focus,
        )


_BOARDS_HEAD = (
    "| boards | told by | aperture (truth) [px] | foci (truth) [s / D] | depths [s / D] | "
    "discs off the truth [px] | off / stated |\n|---|---|---|---|---|---|---|"
)


def main(arguments: list[str]) -> None:
    """Print the tables."""
    warnings.simplefilter("ignore", UserWarning)
    if arguments[0] == "boards":
        print(_BOARDS_HEAD)
        if len(arguments) == 2:
            _print_shared_boards(Path(arguments[1]) / "boards")
        else:
            _print_random_boards(*map(int, arguments[1:]))
        return
    cases = (
        _random_cases(*map(int, arguments))
        if len(arguments) > 1
        else _truth_cases(Path(arguments[0]) / "truth")
    )
    print(
        "| flat | rims (truth) [px] | capture: likeliest, least (truth) [px] | with rims |\n"
        "|---|---|---|---|"
    )
    above: list[float] = []
    for case in cases:
        row, more = _row(case)
        above += more
        print(row, flush=True)
    if above:
        over = int((np.array(above) > _TOLERANCE).sum())
        print(
            f"least discs above the truth by more than {_TOLERANCE} px: {over} of {len(above)}, "
            f"most {max(above):.2f}"
        )
    for name in _CAPTURES if len(arguments) == 1 else ():
        _print_capture(Path(arguments[0]) / "captures" / name)


if __name__ == "__main__":
    main(sys.argv[1:])
