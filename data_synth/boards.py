"""Photographs of a checkerboard in random poses, with all that is true about them: for metric
calibration.
"""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .capture import read_png, write_png
from .surfaces import Patch, Scene
from .transfer import develop

__all__ = ["BoardShoot", "shoot_board"]

Array = NDArray[np.float64]

_COLUMNS = 9
_ROWS = 6
# The widest square inside a microimage, of the pitch: four squares about a corner must fit.
_SQUARE_SHARE = 0.5
_TEXELS = 48  # of a square
_DARK = 0.04
_LIGHT = 0.9
_WALL = 0.25
_LEAST_TILT = 12.0  # degrees
_LARGEST_TILT = 38.0


@dataclass(frozen=True)
class BoardShoot:
    """Flats of a checkerboard of 9 x 6 inner corners.

    Parameters
    ----------
    flats : tuple of (H, W) uint8 arrays
    white : (H, W) uint8
    rotations : (n, 3, 3) float64
        Of the boards: `X_camera = rotation @ X_board + translation`, x right, y down, z away from
        the camera.
    translations : (n, 3) float64 [mm]
    square : float [mm]
    camera : Camera

    Examples
    --------
    >>> from data_synth import Camera, shoot_board
    >>> shoot = shoot_board(Camera.design(size=(500, 400), pitch=28.3), poses=2, samples=1)
    >>> shoot.flats[0].shape, shoot.white.shape
    ((400, 500), (400, 500))
    """

    flats: tuple[NDArray[np.uint8], ...]
    white: NDArray[np.uint8]
    rotations: Array
    translations: Array
    square: float
    camera: Camera

    @property
    def points(self) -> Array:
        """(54, 3) corners on the board [mm], row by row."""
        return _corners() * self.square

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write `flat_00.png` ..., `white.png`, `camera.json` (the true array) and `truth.json`."""
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        names = [f"flat_{n:02d}.png" for n in range(len(self.flats))]
        for name, picture in zip([*names, "white.png"], [*self.flats, self.white], strict=True):
            write_png(target / name, picture)
        self.camera.calibration().save(target / "camera.json")
        poses = [
            {"file": name, "R": turn.tolist(), "t_mm": shift.tolist()}
            for name, turn, shift in zip(names, self.rotations, self.translations, strict=True)
        ]
        about = {
            "schema": "lfsynth-board",
            "camera": dataclasses.asdict(self.camera),
            "board": {"inner_corners": [_COLUMNS, _ROWS], "square_mm": self.square},
            "poses": poses,
        }
        (target / "truth.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> BoardShoot:
        """Read what `save` has written."""
        target = Path(folder)
        about = json.loads((target / "truth.json").read_text(encoding="utf-8"))
        flats = tuple(read_png(target / pose["file"]) for pose in about["poses"])
        turns, shifts = (np.array([pose[key] for pose in about["poses"]]) for key in ("R", "t_mm"))
        camera = Camera(**about["camera"])
        square = about["board"]["square_mm"]
        return cls(flats, read_png(target / "white.png"), turns, shifts, square, camera)

    def summary(self) -> dict[str, Any]:
        """Counts and sizes as plain values."""
        return {
            "scene": "board",
            "flats": len(self.flats),
            "square_mm": self.square,
            "distances_mm": [round(float(z), 1) for z in self.translations[:, 2]],
        }


def shoot_board(
    camera: Camera,
    poses: int = 12,
    *,
    ratios: tuple[float, float] = (-0.5, -0.18),
    samples: int = 32,
    seed: int = 0,
    noise: tuple[float, float] | None = (12000.0, 5.0),
    gamma: bool = True,
) -> BoardShoot:
    """Photograph a checkerboard in random poses, at distances whose `s / D` runs over `ratios`.

    Parameters
    ----------
    camera : Camera
        With distortion and tilt, if it has any.
    poses : int
    ratios : (float, float)
        Of one sign: telescopic (positive) or binocular (negative).
    samples, seed, noise, gamma
        As in `simulate`.

    Examples
    --------
    >>> from data_synth import Camera, shoot_board
    >>> shoot = shoot_board(Camera.design(size=(500, 400), pitch=28.3), poses=2, samples=1)
    >>> len(shoot.flats)
    2
    """
    if ratios[0] * ratios[1] <= 0 or poses < 1:
        raise ValueError(f"give one pose or more and s/D of one sign, got {poses} and {ratios}")
    if camera.mosaic or camera.stray:
        raise ValueError("boards are photographed without mosaic and stray light")
    from . import tracing
    from .intersection import pack

    rng = np.random.default_rng(seed)
    span = np.linspace(*ratios, poses)
    depths = camera.depth_at(span)
    focal = (camera.mla_distance + camera.sensor_distance) / camera.pixel
    square = float(
        np.round(_SQUARE_SHARE * camera.pitch / (focal * np.abs(span) / depths).max(), 3)
    )
    texture = _texture()
    flats = []
    turns = []
    shifts = []
    for number, depth in enumerate(depths):
        turn, middle = _pose(camera, float(depth), square, focal, rng)
        shift = middle - turn @ (_corners().mean(0) * square)
        origin = turn @ (np.array([-2.0, -2.0, 0.0]) * square) + shift
        across = turn[:, 0] * (_COLUMNS + 3) * square
        down = turn[:, 1] * (_ROWS + 3) * square
        table, texels = pack(Scene("board", (Patch(origin, across, down, texture),)))
        wall = (_WALL,) * 3
        light = tracing.sensor(table, texels, wall, camera, samples, seed + 2 * number)[..., 0]
        flats.append(develop(light, noise=noise, bits=8, gamma=gamma, rng=rng))
        turns.append(turn)
        shifts.append(shift)
    light = tracing.sensor(table[:0], texels, (1.0,) * 3, camera, samples, seed + 1)[..., 3]
    white = develop(light, noise=noise, bits=8, gamma=gamma, rng=rng)
    return BoardShoot(tuple(flats), white, np.array(turns), np.array(shifts), square, camera)


def _corners() -> Array:
    column, row = np.meshgrid(np.arange(_COLUMNS), np.arange(_ROWS))
    return np.column_stack([column.ravel(), row.ravel(), np.zeros(column.size)]).astype(np.float64)


def _texture() -> NDArray[np.float32]:
    """10 x 7 squares, the first one dark, with a light margin one square wide."""
    row, column = np.mgrid[-1 : _ROWS + 2, -1 : _COLUMNS + 2]
    inside = (row >= 0) & (row <= _ROWS) & (column >= 0) & (column <= _COLUMNS)
    light = np.where(inside & ((row + column) % 2 == 0), _DARK, _LIGHT).astype(np.float32)
    grey = np.repeat(np.repeat(light, _TEXELS, 0), _TEXELS, 1)
    return np.ascontiguousarray(np.repeat(grey[..., None], 3, 2))


def _pose(
    camera: Camera, depth: float, square: float, focal: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """A rotation, and a place of the board's middle at `depth` where all of its corners lie on the
    flat.
    """
    corners = (_corners() - _corners().mean(0)) * square
    size = np.array([camera.width, camera.height])
    for _ in range(2000):
        way = rng.uniform(0, 2 * np.pi)
        roll = rng.uniform(-0.5, 0.5)
        tilt = np.deg2rad(rng.uniform(_LEAST_TILT, _LARGEST_TILT))
        turn = _about([np.cos(way), np.sin(way), 0.0], tilt) @ _about([0.0, 0.0, 1.0], roll)
        place = (rng.uniform(0.05, 0.95, 2) * size - camera.principal_point) / focal * depth
        middle = np.array([*place, depth])
        seen = corners @ turn.T + middle
        flat = seen[:, :2] / seen[:, 2:] * focal + camera.principal_point
        margin = 1.5 * camera.pitch
        if ((flat > margin) & (flat < size - margin)).all():
            return turn, middle
    raise ValueError(
        "the board does not fit into the field of the camera; give flats of more pixels or a "
        "larger |s / D|"
    )


def _about(axis: list[float], angle: float) -> Array:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
