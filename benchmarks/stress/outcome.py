"""What one stressed case came to, and the limits it is held to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import lfcal
import lfrender

from ..white_images import WhiteImage
from .plane_flats import PlaneFlat, quantised

__all__ = ["SURE", "Outcome", "Sweep", "calibrate_plane", "calibrate_white", "depth_of_plane"]

#: Answers of this confidence and more are taken for certain by users.
SURE = 0.7
# Patch sizes off by more than the first share of the pitch are wrong, and lattices off by more than the second: so far
# may two halves of a flat differ before `lfcal.calibrate` refuses it.
_WRONG, _ASTRAY = 0.05, 0.1


@dataclass(frozen=True)
class Outcome:
    """What came of one case.

    Parameters
    ----------
    answered : float
        Share of the lenses that have an answer, of a calibration 0 or 1.
    error : float [px]
        RMS of the centres, or median of the patch sizes; NaN without an answer.
    wrong : float
        Share of the lenses whose answer is wrong by more than a twentieth of the pitch and confident all the same.
    note : str
        What the answer said, where it was a refusal.
    """

    answered: float
    error: float
    wrong: float
    note: str = ""


@dataclass(frozen=True)
class Sweep:
    """One quantity driven over its range.

    Parameters
    ----------
    name, unit : str
        Of the quantity.
    values : tuple of float
        In order; the quick form takes those at `quick`.
    run : callable
        Outcome at a value.
    limits : (float, float)
        Between these, all must be answered (a share of `least` of the lenses) to `most` [px].
    """

    name: str
    unit: str
    values: tuple[float, ...]
    run: Callable[[float], Outcome]
    limits: tuple[float, float]
    most: float
    least: float = 0.95

    def broken(self, value: float, outcome: Outcome) -> str:
        """What of the promise `outcome` breaks at `value`; empty where it keeps it."""
        if outcome.wrong > 0.02:
            return f"{outcome.wrong:.1%} confident and wrong"
        if not self.limits[0] <= value <= self.limits[1]:
            return ""
        if outcome.answered < self.least:
            return f"{outcome.answered:.1%} answered, promised {self.least:.0%} ({outcome.note})"
        return "" if outcome.error <= self.most else f"error {outcome.error:.4f} px, promised {self.most:g}"


def _of_camera(camera: lfcal.Calibration, error: float, pitch: float) -> Outcome:
    sure = camera.confidence >= SURE
    return Outcome(1.0, error, float(sure and not error <= _ASTRAY * pitch), "" if sure else "; ".join(camera.warnings))


def calibrate_white(truth: WhiteImage, exposure: float = 1.0, kind: str = "") -> Outcome:
    """Calibrate on a white image, with its light times `exposure`; clipped where that exceeds white."""
    image = truth.image()
    if exposure != 1.0 or kind:
        light = truth.light()
        light += truth.noise * np.random.default_rng(truth.seed + 1).standard_normal(light.shape)
        image = quantised(0.8 * exposure * light, "u1" if (kind or f"u{truth.bits // 8}") == "u1" else "u2")
        if kind == "f4":
            image = quantised(0.8 * exposure * light, "f4")
    try:
        camera = lfcal.calibrate(image)
    except lfcal.LightFieldError as refusal:
        return Outcome(0.0, np.nan, 0.0, str(refusal))
    found = camera.lattice.centres()
    index = truth.index_of(found)
    cells = abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(truth.basis))
    same = abs(cells - 1) < _ASTRAY and len(np.unique(index, axis=0)) == len(found)
    error = float(np.sqrt(((found - truth.centres(index)) ** 2).sum(1).mean())) if same else np.inf
    return _of_camera(camera, error, truth.pitch)


def calibrate_plane(truth: PlaneFlat) -> Outcome:
    """Calibrate on a flat of a textured plane."""
    try:
        camera = lfcal.calibrate(truth.flat())
    except lfcal.LightFieldError as refusal:
        return Outcome(0.0, np.nan, 0.0, str(refusal))
    found, lattice = camera.lattice.centres(), truth.lattice
    index = np.rint(lattice.to_index(found))
    cells = abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(lattice.basis))
    same = abs(cells - 1) < _ASTRAY and len(np.unique(index, axis=0)) == len(found)
    error = float(np.sqrt(((found - lattice.points(index)) ** 2).sum(1).mean())) if same else np.inf
    return _of_camera(camera, error, truth.pitch)


def depth_of_plane(truth: PlaneFlat, preset: str = "balanced") -> Outcome:
    """Analyse a flat of a textured plane with its true camera."""
    depth = lfrender.analyze(truth.flat(), truth.calibration, preset)
    error = np.abs(depth.patch_size - truth.patch_size(truth.lattice.centres()))
    known = depth.mode != 0
    # Without texture there is nothing to be right about.
    wrong = known if truth.contrast == 0 else known & ~(error <= _WRONG * truth.pitch)
    return Outcome(
        float(known.mean()),
        float(np.median(error[known])) if known.any() else np.nan,
        float((wrong & (depth.confidence >= SURE)).mean()),
    )
