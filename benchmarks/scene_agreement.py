"""Differences of lattices from flats of one camera.

`python -m benchmarks.scene_agreement FLAT FLAT ...`

Each flat is calibrated separately. The table holds the RMS distance of the centres of any two of
them over the field [px], the last column the longest distance of one flat's centres from those of
any other. Flats are image files, or arrays (.npy) as PyAV makes them of a video (`pip install av`
in an environment of its own):

    import av, numpy as np
    for number, frame in enumerate(av.open("Fujita2.vvc", format="vvc").decode(video=0)):
        if number % 30 == 0:
            np.save(f"frame_{number:03d}.npy", frame.to_ndarray(format="rgb24"))

`python -m benchmarks.scene_agreement --changed FLAT ...` changes each flat instead: by noise of
1e-6 of the light (three times), without the first column, without the first row, mirrored, and
turned by half a turn. It prints the stated standard error of the flat as it is, and the RMS
distances of the centres of the changed ones from its own [px], beside the changes of the confidence
where there are any.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfcal

__all__ = ["differences", "main"]


def differences(
    cameras: list[lfcal.Calibration],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, n) RMS and (n, n) longest distance of the centres of any two cameras [px]."""
    rms, longest = np.zeros((2, len(cameras), len(cameras)))
    for a in range(len(cameras)):
        for b in range(a):
            apart = lfcal.compare(cameras[a], cameras[b])
            rms[a, b] = rms[b, a] = apart.rms
            longest[a, b] = longest[b, a] = apart.max
    return rms, longest


def _flat(path: Path) -> NDArray[Any]:
    pixels: NDArray[Any] = (
        np.load(path, allow_pickle=False) if path.suffix == ".npy" else lfcal.read_flat(path)
    )
    return pixels


_Centres = NDArray[np.float64]


def _changes(flat: NDArray[Any]) -> Iterator[tuple[NDArray[Any], Callable[[_Centres], _Centres]]]:
    """Changed flats, each with the places (n, 2) on the flat of places on it."""
    height, width = flat.shape[:2]
    for seed in range(3):
        noise = 1e-6 * np.random.default_rng(seed).standard_normal(flat.shape)
        yield (flat * (1 + noise)).astype(np.float32), lambda places: places
    yield flat[:, 1:], lambda places: places + np.array([1, 0])
    yield flat[1:], lambda places: places + np.array([0, 1])
    yield flat[:, ::-1], lambda places: (width - 1, 0) + places * (-1, 1)
    yield flat[::-1, ::-1], lambda places: (width - 1, height - 1) - places


def _print_changes(name: str, flat: NDArray[Any]) -> None:
    """Print a row: the stated error, and how far each change moves the lattice."""
    try:
        camera = lfcal.calibrate(flat.astype(np.float32))
    except lfcal.CalibrationError as error:
        print(f"{name:32} refused: {error}", flush=True)
        return
    stated = "-"
    if camera.errors is not None:
        stated = f"{np.sqrt((camera.errors.of_centres(camera.lattice) ** 2).mean()):.4f}"
    row = f"{name:32} {camera.confidence:.3f} {stated:>7} |"
    for changed, place in _changes(flat.astype(np.float32)):
        try:
            other = lfcal.calibrate(np.ascontiguousarray(changed))
        except lfcal.CalibrationError:
            row += " refused"
            continue
        places = place(other.lattice.centres())
        away = camera.lattice.points(np.rint(camera.lattice.to_index(places))) - places
        row += f" {np.sqrt((away**2).sum(1).mean()):.4f}"
        if abs(other.confidence - camera.confidence) >= 0.005:
            row += f" ({other.confidence - camera.confidence:+.2f})"
    print(row, flush=True)


def main(paths: list[Path]) -> None:
    """Print the table and its figures for two flats or more."""
    if len(paths) < 2:
        sys.exit("give two flats of one camera or more")
    rms, longest = differences([lfcal.calibrate(_flat(path)) for path in paths])
    width = max(len(path.stem) for path in paths)
    for path, row, far in zip(paths, rms, longest.max(1), strict=True):
        print(
            f"{path.stem:{width}} " + " ".join(f"{value:6.3f}" for value in row) + f"  {far:6.3f}"
        )
    pairs = rms[np.triu_indices(len(paths), 1)]
    print(
        f"RMS of {len(pairs)} pairs: median {np.median(pairs):.3f}, largest {pairs.max():.3f} px;"
        f" {(pairs <= 0.1).sum()} within 0.1 px; longest distance {longest.max():.3f} px"
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--changed"]:
        for argument in sys.argv[2:]:
            _print_changes(argument, _flat(Path(argument)))
        sys.exit()
    main([Path(argument) for argument in sys.argv[1:]])
