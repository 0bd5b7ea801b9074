"""Sweeps of single quantities, and the limits that are promised for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

import lfcal
import lfrender

from ..white_images import WhiteImage
from .harms import dark_corners, dust, hot_pixels, missing_lenses
from .outcome import (
    Harm,
    Outcome,
    Sweep,
    calibrate_plane,
    calibrate_white,
    depth_of_plane,
    picture_of_plane,
)
from .plane_flats import PlaneFlat

__all__ = ["random_plane", "random_white", "sweeps"]

_WHITE = WhiteImage(pitch=14.3, degrees=3.0, decibels=30, bits=8, size=(420, 320))
_PLANE = PlaneFlat(noise=0.005)
_ANY = (-np.inf, np.inf)
Case = TypeVar("Case", WhiteImage, PlaneFlat)


def _white(name: str) -> Callable[[float], Outcome]:
    """Calibration with that field of the white image set to the value."""
    kind = type(getattr(_WHITE, name))
    return lambda value: calibrate_white(_changed(_WHITE, {name: kind(value)}))


def _changed(case: Case, fields: dict[str, Any]) -> Case:
    return replace(case, **fields)  # type: ignore[type-var]


def _pitch(value: float) -> Outcome:
    side = int(max(240, 8 * value))
    return calibrate_white(replace(_WHITE, pitch=value, size=(side, int(0.8 * side))))


def _exposure(value: float) -> Outcome:
    return calibrate_white(replace(_WHITE, decibels=36), value)


def _plane(name: str, **fixed: float) -> Callable[[float], Outcome]:
    """Depth with that field of the plane set to the value."""
    return lambda value: depth_of_plane(_changed(_PLANE, {**fixed, name: value}))


def _depth_pitch(value: float) -> Outcome:
    side = int(np.clip(12 * value, 160, 1500))
    return depth_of_plane(
        replace(_PLANE, pitch=value, size=(side, int(0.8 * side)), grain=max(2.0, value / 40))
    )


def _small(value: float) -> Outcome:
    return depth_of_plane(replace(_PLANE, size=(int(value * 23.2) + 12, 300)))


def _low(value: float) -> Outcome:
    return depth_of_plane(replace(_PLANE, size=(300, int(value * 20.1) + 12)))


def _depth_shear(value: float) -> Outcome:
    return depth_of_plane(_own_cell(_PLANE, (value, 1.0)))


def _depth_oblong(value: float) -> Outcome:
    return depth_of_plane(_own_cell(_PLANE, (0.0, value)))


def _harmed(harm: Callable[[float], Harm]) -> Callable[[float], Outcome]:
    return lambda value: depth_of_plane(_PLANE, harm=harm(value))


def _far(value: float) -> Outcome:
    """The lit far end of a wide dark flat: float32 has steps of 0.008 px at 1e5 px."""
    near = replace(_PLANE, size=(500, 130), cell="square")
    flat = near.flat()
    lattice = near.lattice
    width = int(value)
    wide = np.zeros((130, width), flat.dtype)
    wide[:, -500:] = flat
    moved = lfcal.Lattice(
        lattice.origin + np.array([width - 500, 0]), lattice.basis, (width, 130), lattice.radius
    )
    depth = lfrender.analyze(wide, lfcal.Calibration(moved), roi=(width - 400, 0, width, 130))
    asked = moved.centres()[:, 0] > width - 400
    error = np.abs(depth.patch_size - near.ratio * near.pitch)[asked]
    known = np.isfinite(error)
    return Outcome(
        float(known.mean()),
        float(np.median(error[known])),
        float((error > 0.05 * near.pitch).mean()),
    )


def _white_far(value: float) -> Outcome:
    return calibrate_white(replace(_WHITE, size=(int(value), 120), pitch=20.0))


def _shear(value: float) -> Outcome:
    lattice = lfcal.Lattice(np.zeros(2), np.array([[1.0, 0.0], [value, 1.0]]), (1, 1), 1.0)
    skew = PlaneFlat(
        contrast=0.0, noise=0.01, fill=0.92, pitch=16.0, size=(400, 320), exposure=0.7, kind="u1"
    )
    return calibrate_plane(replace(skew, cell="square", own_cell=tuple(map(tuple, lattice.basis))))


def _own_cell(truth: PlaneFlat, second: tuple[float, float]) -> PlaneFlat:
    return replace(truth, cell="square", own_cell=((1.0, 0.0), second))


def _white_missing(value: float) -> Outcome:
    centres = _WHITE.centres(
        _WHITE.index_of(np.zeros((1, 2)))
        + np.moveaxis(np.mgrid[-60:60, -60:60], 0, -1).reshape(-1, 2)
    )
    inside = (np.abs(centres - np.array(_WHITE.size) / 2) < np.array(_WHITE.size) / 2).all(1)
    return calibrate_white(_WHITE, harm=missing_lenses(centres[inside], _WHITE.pitch, value))


def _white_small(value: float) -> Outcome:
    """A flat that is `value` lenses wide and ten high."""
    return calibrate_white(replace(_WHITE, pitch=20.0, size=(int(20 * value) + 4, 204)))


def _white_oblong(value: float) -> Outcome:
    white = PlaneFlat(
        contrast=0.0, noise=0.01, fill=0.92, pitch=16.0, size=(400, 320), exposure=0.7, kind="u1"
    )
    return calibrate_plane(_own_cell(white, (0.0, value)))


def _depth_missing(value: float) -> Outcome:
    return depth_of_plane(
        _PLANE, harm=missing_lenses(_PLANE.lattice.centres(), _PLANE.pitch, value)
    )


_KINDS = {8.0: "u1", 16.0: "u2", 32.0: "f4"}


def _drawn(name: str, **fixed: float) -> Callable[[float], Outcome]:
    """The picture with that field of the plane set to the value."""
    return lambda value: picture_of_plane(_changed(_PLANE, {"grain": 3.0, **fixed, name: value}))


def _drawn_pitch(value: float) -> Outcome:
    side = int(np.clip(12 * value, 160, 1000))
    return picture_of_plane(
        replace(_PLANE, pitch=value, size=(side, int(0.8 * side)), grain=max(3.0, value / 20))
    )


def _of_pictures() -> tuple[Sweep, ...]:
    """Errors are over the contrast of the plane: 0.2 is 14 dB under the texture."""
    ratios = (0.005, 0.02, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.7, 0.8, 0.909)
    both = tuple(sorted([-r for r in ratios] + list(ratios)))
    turn = tuple(float(d) for d in range(0, 360, 15))
    return (
        Sweep("s / D", "", both, _drawn("ratio"), (-0.7, 0.7), 0.2, 0.9),
        Sweep("noise", "of white", (0, 0.01, 0.03, 0.1, 0.2), _drawn("noise"), (0, 0.03), 0.3),
        Sweep(
            "contrast", "", (0, 0.005, 0.02, 0.05, 0.1, 0.25), _drawn("contrast"), (0.05, 0.25), 0.2
        ),
        Sweep("rotation", "degrees", turn, _drawn("degrees"), _ANY, 0.1),
        Sweep("pitch", "px", (6, 7, 9, 14, 25, 50, 120, 250), _drawn_pitch, (9, 250), 0.2, 0.9),
        Sweep(
            "exposure", "of white", (0.01, 0.03, 0.1, 0.3, 0.6), _drawn("exposure"), (0.1, 0.6), 0.2
        ),
        Sweep("fill factor", "", (0.5, 0.6, 0.7, 0.8, 0.9, 1.0), _drawn("fill"), (0.7, 1), 0.2),
    )


def sweeps() -> dict[str, tuple[Sweep, ...]]:
    """All sweeps by stage."""
    turn = tuple(float(d) for d in range(360))
    ratios = (
        0.005,
        0.01,
        0.02,
        0.05,
        0.1,
        0.2,
        0.3,
        0.45,
        0.6,
        0.7,
        0.74,
        0.8,
        0.9,
        0.97,
        1.0,
        1.1,
        1.5,
        3.0,
    )
    both = tuple(sorted([-r for r in ratios] + list(ratios)))
    return {
        "calibration": (
            Sweep("noise", "dB", (6, 10, 14, 18, 26, 34, 40), _white("decibels"), (14, 40), 0.05),
            Sweep(
                "exposure",
                "of white",
                (0.01, 0.03, 0.1, 0.3, 1, 1.5, 2.5, 5),
                _exposure,
                (0.03, 1.5),
                0.05,
            ),
            Sweep("pitch", "px", (6, 6.5, 7, 9, 12, 20, 40, 90, 160, 250), _pitch, (7, 250), 0.1),
            Sweep("rotation", "degrees", turn, _white("degrees"), _ANY, 0.02),
            Sweep("shear", "of the pitch", (0, 0.1, 0.2, 0.3, 0.4, 0.5), _shear, _ANY, 0.05),
            Sweep(
                "fill factor",
                "",
                (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 1.0),
                _white("fill"),
                (0.6, 1.0),
                0.05,
            ),
            Sweep(
                "distortion",
                "k1",
                (-0.02, -0.01, -0.003, 0, 0.003, 0.01, 0.02),
                _white("k1"),
                (-0.01, 0.01),
                0.05,
            ),
            Sweep("vignetting", "", (0, 0.2, 0.4, 0.6, 0.8, 0.95), _white("outer"), (0, 0.8), 0.05),
            Sweep("hot pixels", "", (0, 30, 100, 300, 1000), _white("hot"), (0, 300), 0.05),
            Sweep("dust", "specks", (0, 3, 10, 30), _white("dust"), (0, 10), 0.05),
            Sweep(
                "missing lenses",
                "share",
                (0, 0.01, 0.05, 0.1, 0.2, 0.4),
                _white_missing,
                (0, 0.1),
                0.05,
            ),
            Sweep("lenses across", "", (1, 2, 3, 4, 5, 6, 8, 12), _white_small, (6, 12), 0.05),
            Sweep(
                "cell height", "of its width", (1, 1.2, 1.5, 2, 3, 5), _white_oblong, (1, 1.5), 0.05
            ),
            Sweep(
                "bits",
                "",
                (8, 16, 32),
                lambda b: calibrate_white(_WHITE, kind=_KINDS[b]),
                _ANY,
                0.02,
            ),
            Sweep("width of the flat", "px", (2000, 10_000, 100_000), _white_far, _ANY, 0.02),
        ),
        "depth": (
            Sweep("s / D", "", both, _plane("ratio"), (-0.72, 0.72), 0.1, 0.9),
            Sweep(
                "contrast",
                "",
                (0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25),
                _plane("contrast", noise=0.01),
                (0.05, 0.25),
                0.1,
            ),
            Sweep(
                "noise", "of white", (0, 0.01, 0.03, 0.1, 0.2, 0.4), _plane("noise"), (0, 0.1), 0.15
            ),
            Sweep(
                "period",
                "of the pitch",
                (0.12, 0.2, 0.3, 0.45, 0.6, 0.9),
                _plane("period"),
                (9, 9),
                0.1,
            ),
            Sweep("rotation", "degrees", turn, _plane("degrees"), _ANY, 0.05),
            Sweep(
                "pitch",
                "px",
                (6, 6.5, 7, 8, 12, 20, 40, 90, 160, 250),
                _depth_pitch,
                (7, 250),
                0.05,
            ),
            Sweep("lenses across", "", (1, 2, 3, 4, 6, 9), _small, (3, 9), 0.05, 0.7),
            Sweep("width of the flat", "px", (1000, 30_000, 100_000), _far, _ANY, 0.05),
            Sweep("lens rows", "", (1, 2, 3, 4, 6, 9), _low, (3, 9), 0.05, 0.7),
            Sweep("shear", "of the pitch", (0, 0.1, 0.2, 0.3, 0.4, 0.5), _depth_shear, _ANY, 0.05),
            Sweep(
                "cell height", "of its width", (1, 1.2, 1.5, 2, 3, 5), _depth_oblong, (1, 1.5), 0.05
            ),
            Sweep(
                "fill factor",
                "",
                (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
                _plane("fill"),
                (0.7, 1),
                0.05,
            ),
            Sweep(
                "vignetting",
                "",
                (0, 0.2, 0.4, 0.6, 0.8, 0.95),
                _harmed(dark_corners),
                (0, 0.8),
                0.05,
            ),
            Sweep(
                "hot pixels",
                "share",
                (0, 1e-4, 1e-3, 3e-3, 0.01, 0.03),
                _harmed(hot_pixels),
                (0, 1e-3),
                0.05,
            ),
            Sweep("dust", "share", (0, 0.003, 0.01, 0.03, 0.1), _harmed(dust), (0, 0.01), 0.05),
            Sweep(
                "missing lenses",
                "share",
                (0, 0.01, 0.05, 0.1, 0.2, 0.4),
                _depth_missing,
                (0, 0.05),
                0.05,
                0.9,
            ),
            Sweep(
                "bits",
                "",
                (8, 16, 32),
                lambda b: depth_of_plane(_changed(_PLANE, {"kind": _KINDS[b]})),
                _ANY,
                0.02,
            ),
            Sweep(
                "exposure",
                "of white",
                (0.01, 0.03, 0.1, 0.3, 0.6, 0.9),
                _plane("exposure"),
                (0.1, 0.6),
                0.05,
            ),
        ),
        "rendering": _of_pictures(),
    }


def random_white(number: int) -> tuple[WhiteImage, float]:
    """A white image with everything drawn at random, and its exposure."""
    rng = np.random.default_rng(number)
    pitch = float(np.exp(rng.uniform(np.log(6), np.log(40))))
    side = int(np.clip(pitch * rng.uniform(5, 22), 60, 440))
    truth = WhiteImage(
        "hexagonal" if rng.integers(2) else "square",
        pitch,
        rng.uniform(0, 360),
        rng.uniform(6, 40),
        int(rng.choice([8, 16])),
        strength=float(rng.choice([0, rng.uniform(-0.3, 0.3)])),
        k1=float(rng.choice([0, rng.uniform(-0.01, 0.01)])),
        hot=int(rng.integers(0, 40)),
        dust=int(rng.integers(0, 5)),
        fill=rng.uniform(0.6, 1.0),
        soft=rng.uniform(0.3, 3),
        gap=rng.uniform(0, 0.6),
        inner=rng.uniform(0, 0.6),
        outer=rng.uniform(0, 0.8),
        size=(side, int(max(40, side * rng.uniform(0.4, 1)))),
        seed=number,
    )
    return truth, float(np.exp(rng.uniform(np.log(0.02), np.log(2))))


def random_plane(number: int) -> PlaneFlat:
    """A random plane; its image may lie on the microlenses or beyond."""
    rng = np.random.default_rng(number)
    pitch = float(np.exp(rng.uniform(np.log(6), np.log(50))))
    side = int(np.clip(pitch * rng.uniform(5, 20), 80, 420))
    return PlaneFlat(
        ratio=float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.02), np.log(3)))),
        cell=str(rng.choice(["hexagonal", "square", "oblong", "sheared"])),
        pitch=pitch,
        degrees=rng.uniform(0, 360),
        size=(side, int(side * rng.uniform(0.5, 1))),
        contrast=float(rng.choice([0, rng.uniform(0, 0.4)], p=[0.1, 0.9])),
        noise=float(rng.choice([0, rng.uniform(0, 0.1)])),
        grain=rng.uniform(1.5, 0.15 * pitch + 1.5),
        fill=float(rng.choice([0, rng.uniform(0.8, 1)])),
        exposure=rng.uniform(0.05, 0.6),
        seed=number,
        kind=rng.choice(["u1", "u2", "f4"]),
    )
