"""What the shortcuts of the depth analysis save, and what they cost: `python -m benchmarks.shortcuts [FLAT ...]`.

Ray-traced scenes, or the flats named on the command line, or with `--random N` so many cards before a wall,
planes or slopes (`--scene`) taken by random cameras, are analysed exhaustively and with all shortcuts. Printed are the
CPU time on one thread, the share of the lenses whose answers differ by more than 0.05 px or that only one of the
two resolves, and what was left out; of ray-traced scenes also the errors of both against the truth.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import SCENES, Camera, Capture, Scene, simulate
from data_synth.scenes import blank, plane
from data_synth.surfaces import Patch

_SIZE, _PITCH = (1400, 1000), 23.2
# A flat on which what every call takes hardly counts. Toward its corners microimages are darker on one side.
_LARGE = (2800, 2000)
_RUNS = 5
_DIFFERENT = 0.05
# Full well and readout noise [electrons] of a middling sensor.
_NOISE = (12000.0, 5.0)


def _card(camera: Camera, ratio: float, share: float) -> Patch:
    """A textured card at `s / D = ratio` in the middle of the flat, over a share of it."""
    size = np.array([camera.width, camera.height])
    low, high = size * (1 - share**0.5) / 2, size * (1 + share**0.5) / 2
    wide = plane(camera, ratio=ratio).surfaces[0]
    assert isinstance(wide, Patch)
    corner, right, below = camera.place([low, (high[0], low[1]), (low[0], high[1])], camera.depth_at(ratio))
    rows, columns = (int(n * share**0.5) for n in wide.texture.shape[:2])
    return Patch(corner, right - corner, below - corner, wide.texture[:rows, :columns])


def _mostly_blank(camera: Camera, share: float) -> Scene:
    return Scene("mostly blank", (*blank(camera, ratio=0.2).surfaces, _card(camera, 0.3, share)))


def _scenes(camera: Camera) -> dict[str, Callable[[], Scene]]:
    return {
        "card of 10 %": lambda: _mostly_blank(camera, 0.1),
        "card of 5 %": lambda: _mostly_blank(camera, 0.05),
        "plane": lambda: plane(camera, ratio=0.3),
        "far plane": lambda: plane(camera, ratio=-0.15),
        "slope": lambda: SCENES["slope"](camera),
        "house": lambda: SCENES["house"](camera),
        "clutter": lambda: SCENES["clutter"](camera),
    }


def _timed(calls: list[Callable[[], lfrender.DepthMap]]) -> tuple[list[lfrender.DepthMap], list[float]]:
    """Answers and the least CPU time [s] of each call; the calls take turns, so that a busy machine slows all alike."""
    answers = [call() for call in calls]
    times = [np.inf] * len(calls)
    for _ in range(_RUNS):
        for k, call in enumerate(calls):
            start = time.process_time()
            call()
            times[k] = min(times[k], time.process_time() - start)
    return answers, times


def _differing(full: lfrender.DepthMap, quick: lfrender.DepthMap) -> float:
    both = (full.mode == 0) & (quick.mode == 0)
    return float(np.mean(~(both | (np.abs(full.patch_size - quick.patch_size) <= _DIFFERENT))))


def _errors(depths: list[lfrender.DepthMap], capture: Capture) -> str:
    known = (capture.truth.mode != 0) & ~capture.truth.mixed
    errors = [np.abs(depth.patch_size - capture.truth.patch_size)[known] for depth in depths]
    figures = [f"{np.nanmedian(e):.3f} {np.nanpercentile(e, 95):.3f} {np.mean(e > _DIFFERENT):.3f}" for e in errors]
    return f"  error median, 95 %, share > {_DIFFERENT}: {' against '.join(figures)} px"


def _row(name: str, flat: NDArray[Any], calibration: lfcal.Calibration, capture: Capture | None = None) -> None:
    (full, quick), (slow, fast) = _timed(
        [lambda: lfrender.analyze(flat, calibration, skip=False), lambda: lfrender.analyze(flat, calibration)]
    )
    saved = ", ".join(f"{what} {share:.2f}" for what, share in quick.saved.items())
    truth = _errors([full, quick], capture) if capture is not None else ""
    print(
        f"{name:18} {slow:.3f} s -> {fast:.3f} s ({slow / fast:.1f} x)"
        f"  differing {100 * _differing(full, quick):5.2f} %  saved {saved}{truth}",
        flush=True,
    )


def _still_row(capture: Capture) -> None:
    """A second frame that differs from the first by its noise alone."""
    calibration = capture.truth.calibration
    rng = np.random.default_rng(1)
    first, second = (
        np.clip(np.rint(capture.flat + rng.normal(0, 2.0, capture.flat.shape)), 0, 255).astype(np.uint8) for _ in "ab"
    )
    before = lfrender.analyze(first, calibration)
    (quick, after), (fast, still) = _timed(
        [lambda: lfrender.analyze(second, calibration), lambda: lfrender.analyze(second, calibration,
                                                                               previous=(first, before))]
    )  # fmt: skip
    print(
        f"{'still':18} {fast:.3f} s -> {still:.3f} s ({fast / still:.1f} x)"
        f"  differing from the first frame {100 * _differing(before, after):.2f} %,"
        f" from the second alone {100 * _differing(quick, after):.2f} %  saved still {after.saved['still']:.2f}",
        flush=True,
    )


def _random_row(number: int, scene: str) -> None:
    """A scene taken by a random camera with random noise: a card over a random share of a blank one, or one plane."""
    rng = np.random.default_rng(number)
    pitch, across = float(np.exp(rng.uniform(np.log(12), np.log(60)))), rng.uniform(25, 45)
    camera = Camera.design(
        (int(pitch * across), int(0.8 * pitch * across)), pitch,
        lattice="hex" if rng.integers(2) else "square", rotation=float(rng.uniform(-15, 15)),
    )  # fmt: skip
    share = rng.uniform(0.03, 0.3)
    noise = float(np.exp(rng.uniform(np.log(800), np.log(20000)))), float(rng.uniform(2, 10))
    ratio = float(rng.choice([-1, 1]) * rng.uniform(0.12, 0.5))
    drawn, name = {
        "card": (_mostly_blank(camera, share), f"card of {share:.0%}"),
        "plane": (plane(camera, ratio=ratio), f"plane at {ratio:.2f} D"),
        "slope": (SCENES["slope"](camera), "slope"),
    }[scene]
    capture = simulate(drawn, camera, samples=24, seed=number, noise=noise)
    _row(f"{number}: {pitch:.0f} px, {name}", capture.flat, capture.truth.calibration, capture)


def main(arguments: list[str]) -> None:
    """Print one line for each scene, or for each flat that is named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shortcuts", description=__doc__)
    parser.add_argument("flats", nargs="*")
    parser.add_argument("--random", type=int, default=0, metavar="N")
    parser.add_argument("--scene", choices=("card", "plane", "slope"), default="card", help="what --random takes")
    options = parser.parse_args(arguments)
    numba.set_num_threads(1)
    for path in options.flats:
        flat = lfcal.read_flat(path)
        _row(path.split("/")[-1], flat, lfcal.calibrate(flat))
    for number in range(options.random):
        _random_row(number, options.scene)
    if options.flats or options.random:
        return
    camera, large = (Camera.design(size, _PITCH, rotation=1.3) for size in (_SIZE, _LARGE))
    scenes = {name: (camera, scene) for name, scene in _scenes(camera).items()}
    square, large_square, short, coarse = (
        Camera.design((1100, 1200), 28.0, lattice="square", rotation=5.0),
        Camera.design((2200, 2400), 28.0, lattice="square", rotation=5.0),
        Camera.design(_LARGE, 17.3, rotation=2.0),
        Camera.design(_LARGE, 70.0, rotation=1.3),
    )
    scenes |= {f"large, {share} %": (large, partial(_mostly_blank, large, share / 100)) for share in (10, 5)}
    scenes |= {f"square, {share} %": (square, partial(_mostly_blank, square, share / 100)) for share in (10, 3)}
    scenes |= {"large short, 10 %": (short, partial(_mostly_blank, short, 0.1))}
    scenes |= {"large square, 10 %": (large_square, partial(_mostly_blank, large_square, 0.1))}
    scenes |= {f"70 px, {share} %": (coarse, partial(_mostly_blank, coarse, share / 100)) for share in (10, 20)}
    scenes |= {"large plane": (large, partial(plane, large, ratio=0.3))}
    for name, (taken_by, scene) in scenes.items():
        capture = simulate(scene(), taken_by, samples=48, seed=2, noise=_NOISE)
        _row(name, capture.flat, capture.truth.calibration, capture)
        if name == "house":
            _still_row(capture)


if __name__ == "__main__":
    main(sys.argv[1:])
