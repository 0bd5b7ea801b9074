"""Time and error of every method and setting on one case."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

import lfcal
import lfrender
from lfrender.data.depth_map import default_scale
from lfrender.runtime.choices import Preset

from .baselines import hough_lattice, matched_patch_sizes, tiled
from .cases import Case

__all__ = ["Row", "measure"]

_PRESETS: tuple[Preset, ...] = ("fast", "balanced")


@dataclass(frozen=True)
class Row:
    """Time and errors of one method on one case.

    Parameters
    ----------
    stage : {"calibration", "analysis", "rendering", "peers"}
    method, case : str
    seconds_per_megapixel : float
        CPU time of one thread per megapixel of the flat, the least of several runs.
    remaps : float
        The same over that of `cv2.remap` of the flat onto a grid of its own size.
    errors : dict of str to float
        By name; NaN with the refusal in `note` where there is no answer.
    """

    stage: str
    method: str
    case: str
    seconds_per_megapixel: float
    remaps: float
    errors: dict[str, float]
    note: str = ""


def _timed(call: Callable[[], Any], runs: int) -> tuple[Any, float]:
    """The answer and the least CPU time [s]; a first call compiles."""
    answer = call()
    least = np.inf
    for _ in range(runs):
        start = time.process_time()
        call()
        least = min(least, time.process_time() - start)
    return answer, least


def _remap_time(case: Case, runs: int) -> float:
    height, width = case.flat.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return _timed(lambda: cv2.remap(case.flat, x + 0.3, y + 0.3, cv2.INTER_LINEAR), 3 * runs)[1]


def measure(case: Case, runs: int = 2) -> Iterator[Row]:
    """All methods on a case; `runs` repetitions of each."""
    unit = max(_remap_time(case, runs), 1e-9)

    def row(
        stage: str, method: str, call: Callable[[], Any], judge: Callable[[Any], dict[str, float]]
    ) -> Row:
        try:
            answer, spent = _timed(call, runs)
        except (lfcal.LightFieldError, ValueError) as refusal:
            return Row(stage, method, case.name, float("nan"), float("nan"), {}, str(refusal)[:200])
        return Row(stage, method, case.name, spent / case.megapixels, spent / unit, judge(answer))

    def lattice_error(lattice: lfcal.Lattice) -> dict[str, float]:
        return {"centre RMS px": case.centre_rms(lattice)}

    flat = case.flat
    true = case.calibration
    lattice = case.calibration.lattice
    yield row("calibration", "white", lambda: lfcal.calibrate(case.white).lattice, lattice_error)
    yield row("calibration", "scene", lambda: lfcal.calibrate(flat, "scene").lattice, lattice_error)
    yield row(
        "calibration",
        "baseline: Hough circles, white",
        lambda: hough_lattice(case.white),
        lattice_error,
    )
    depths = {}
    for preset in _PRESETS:
        for skip in (True, False):
            method = preset if skip else f"{preset}, exhaustive"
            yield row(
                "analysis",
                method,
                # Commands check the camera once, before the analysis.
                partial(lfrender.analyze, flat, true, preset, skip=skip, check=False),
                lambda depth: case.depth_errors(depth.patch_size),
            )
        depths[preset] = lfrender.analyze(flat, true, preset, check=False)
    yield row(
        "analysis",
        "baseline: template",
        lambda: matched_patch_sizes(flat, lattice),
        case.depth_errors,
    )
    depth = depths["balanced"]
    sizes = matched_patch_sizes(flat, lattice)
    for name, scale in (("full resolution", default_scale(depth)), ("0.3 D", 0.3 * lattice.pitch)):
        for blend in (True, False):
            yield row(
                "rendering",
                f"{'blended' if blend else 'nearest lens'}, {name}",
                partial(lfrender.render, flat, true, depth, scale=scale, blend=blend),
                case.picture_merit,
            )
        yield row(
            "rendering",
            f"baseline: tiles, {name}",
            partial(tiled, flat, lattice, sizes, scale),
            case.picture_merit,
        )
