"""Outcome of a stress test, and its limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import lfcal
import lfrender
from lfrender.runtime.choices import Preset

from ..white_images import WhiteImage
from .plane_flats import PlaneFlat

__all__ = [
    "SURE",
    "Harm",
    "Outcome",
    "Sweep",
    "calibrate_plane",
    "calibrate_white",
    "depth_of_plane",
    "picture_of_plane",
]

#: Answers of this confidence and more are taken for certain by users.
SURE = 0.7
# Patch sizes off by more than the first share of the pitch are wrong, and lattices off by more than
# the second: so far may two halves of a flat differ before `lfcal.calibrate` refuses it.
_WRONG = 0.05
_ASTRAY = 0.1
# Of one value of a sweep: among 150 lenses chance and the border leave as many.
_ALLOWED = 0.02
# Of `Outcome.off`: patch sizes off by so many px and standard errors, at a confidence above the
# third number.
_OFF_PX = 0.5
_OFF_ERRORS = 4.0
_BELIEVED = 0.5


Harm = Callable[[NDArray[Any]], NDArray[Any]]


@dataclass(frozen=True)
class Outcome:
    """Outcome of one case.

    Parameters
    ----------
    answered : float
        Share of the lenses that have an answer, of a calibration 0 or 1.
    error : float [px]
        RMS of the centres, or median of the patch sizes; NaN without an answer.
    wrong : float
        Share of the lenses whose answer is wrong by more than a twentieth of the pitch and
        confident all the same.
    note : str
        What the answer said, where it was a refusal.
    off : float
        By a stricter measure than `wrong`: share of the lenses in the wrong mode, or off by more
        than half a pixel and four standard errors, at a confidence above one half.
    """

    answered: float
    error: float
    wrong: float
    note: str = ""
    off: float = 0.0


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
        """The limits that `outcome` breaks at `value`; empty if it keeps all."""
        wrong = max(outcome.wrong, outcome.off)
        if wrong > _ALLOWED:
            return f"{wrong:.1%} confident and wrong"
        if not self.limits[0] <= value <= self.limits[1]:
            return ""
        if outcome.answered < self.least:
            return f"{outcome.answered:.1%} answered, promised {self.least:.0%} ({outcome.note})"
        return (
            ""
            if outcome.error <= self.most
            else f"error {outcome.error:.4f} px, promised {self.most:g}"
        )


def _of_camera(camera: lfcal.Calibration, error: float, pitch: float) -> Outcome:
    sure = camera.confidence >= SURE
    astray = not error <= _ASTRAY * pitch
    note = "" if sure else "; ".join(camera.warnings)
    return Outcome(
        1.0, error, float(sure and astray), note, float(astray and camera.confidence > _BELIEVED)
    )


def calibrate_white(
    truth: WhiteImage, exposure: float = 1.0, kind: str = "", harm: Harm | None = None
) -> Outcome:
    """Calibrate on a white image, with its light times `exposure`; clipped where that exceeds
    white.
    """
    image = truth.image(exposure, kind)
    try:
        camera = lfcal.calibrate(image if harm is None else harm(image))
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
    found = camera.lattice.centres()
    lattice = truth.lattice
    index = np.rint(lattice.to_index(found))
    cells = abs(np.linalg.det(camera.lattice.basis)) / abs(np.linalg.det(lattice.basis))
    same = abs(cells - 1) < _ASTRAY and len(np.unique(index, axis=0)) == len(found)
    error = float(np.sqrt(((found - lattice.points(index)) ** 2).sum(1).mean())) if same else np.inf
    return _of_camera(camera, error, truth.pitch)


def depth_of_plane(
    truth: PlaneFlat, preset: Preset = "balanced", harm: Harm | None = None
) -> Outcome:
    """Analyse a flat of a textured plane with its true camera."""
    flat = truth.flat() if harm is None else harm(truth.flat())
    depth = lfrender.analyze(flat, truth.calibration, preset)
    sizes = truth.patch_size(truth.lattice.centres())
    error = np.abs(depth.patch_size - sizes)
    known = depth.mode != 0
    # Near zero both modes are right.
    other = (np.sign(depth.patch_size) != np.sign(sizes)) & (np.abs(depth.patch_size) > _OFF_PX)
    off = (error > _OFF_PX) & (other | (error > _OFF_ERRORS * depth.standard_error))
    off = known & (off | (truth.contrast == 0)) & (depth.confidence > _BELIEVED)
    # Without texture there is nothing to be right about.
    wrong = known if truth.contrast == 0 else known & ~(error <= _WRONG * truth.pitch)
    return Outcome(
        float(known.mean()),
        float(np.median(error[known])) if known.any() else np.nan,
        float((wrong & (depth.confidence >= SURE)).mean()),
        off=float(off.mean()),
    )


def picture_of_plane(truth: PlaneFlat) -> Outcome:
    """Analyse a flat of a textured plane, draw it, and compare the picture with the plane itself.

    A pixel is wrong where it is off by more than the standard deviation of the texture and what the
    noise explains, as half of all pixels are that show another place; it is confident where the
    lens about it is. The error is the RMS of confident pixels over that deviation.
    """
    flat = truth.flat()
    depth = lfrender.analyze(flat, truth.calibration)
    picture = lfrender.render(flat, truth.calibration, depth)
    v, u = np.mgrid[: picture.image.shape[0], : picture.image.shape[1]]
    places = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ picture.affine.T
    wanted = truth.scene(places).reshape(u.shape)
    contrast = truth.exposure * truth.contrast
    white = 1.0 if picture.image.dtype.kind == "f" else np.iinfo(picture.image.dtype).max
    error = np.abs(picture.image / white - np.clip(wanted, 0, 1))
    lens = cKDTree(truth.lattice.centres()).query(places)[1].reshape(u.shape)
    border = (places < truth.pitch).any(1) | (places > np.array(truth.size) - 1 - truth.pitch).any(
        1
    )
    asked = picture.valid & ~border.reshape(u.shape)
    sure = asked & (depth.mode[lens] != 0) & (depth.confidence[lens] > _BELIEVED)
    return Outcome(
        float(sure.sum() / max(1, asked.sum())),
        float(np.sqrt((error[sure] ** 2).mean()) / contrast) if sure.any() and contrast else np.nan,
        0.0,
        off=float(
            (sure & (error > contrast + 4 * truth.noise + 2 / white)).sum() / max(1, asked.sum())
        ),
    )
