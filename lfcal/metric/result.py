"""Result of the metric calibration: the camera with its optics, poses of boards and residuals."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..boards.board import Board
from ..camera.calibration import Calibration
from ..camera.optics import Optics
from ..runtime.arrays import Array, Booleans, Frozen
from ..runtime.output_file import atomic_write
from ..runtime.page import html_table
from .bundle_adjustment import Adjusted, Observations
from .camera_model import INTERNAL, SHAPE

__all__ = ["BoardPose", "MetricCalibration", "pose_of"]


@dataclass(frozen=True, eq=False)
class BoardPose(Frozen):
    """The pose of a board: `X_camera = rotation @ X_board + translation`.

    The origin of the camera is the middle of the main lens (its entrance pupil), x points right, y
    down, z to the scene. The origin of the board is its first corner, x points along the rows, y
    down, z away from the camera.

    Parameters
    ----------
    name : str
        Name of the flat.
    rotation : (3, 3) float64
    translation : (3,) float64 [mm]
    covariance : (6, 6) float64
        Covariance of a small turn of the rotated board about the axes of the camera [rad] and of
        the translation [mm], with the errors of the camera.
    rms : float [px]
        RMS distance between observed and predicted corners in microimages, without outliers.
    observations : int
        Number of corners in microimages, without outliers.

    Examples
    --------
    >>> import lfcal, numpy as np
    >>> position = np.array([0.0, 0.0, 800.0])
    >>> pose = lfcal.BoardPose("one", np.eye(3), position, np.eye(6) / 100, 0.02, 900)
    >>> pose.standard_errors[3:].tolist()  # of the translation [mm]
    [0.1, 0.1, 0.1]
    >>> pose.place(np.array([[7.0, 0.0, 0.0]])).tolist()  # [mm] from the main lens
    [[7.0, 0.0, 800.0]]
    """

    name: str
    rotation: Array
    translation: Array
    covariance: Array
    rms: float
    observations: int

    @property
    def standard_errors(self) -> Array:
        """(6,) of turn [rad] and translation [mm]."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0))

    def place(self, board_points: Array) -> Array:
        """(n, 3) points of the board [mm] in the frame of the camera [mm]."""
        return np.asarray(board_points, np.float64) @ self.rotation.T + self.translation

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        errors = self.standard_errors
        return {
            "flat": self.name,
            "rotation": self.rotation.tolist(),
            "translation_mm": self.translation.tolist(),
            "turn_error_degrees": np.rad2deg(errors[:3]).tolist(),
            "translation_error_mm": errors[3:].tolist(),
            "rms_px": self.rms,
            "observations": self.observations,
        }


@dataclass(frozen=True, eq=False, repr=False)
class MetricCalibration(Frozen):
    """A camera whose optics were measured on flats of a board.

    Parameters
    ----------
    calibration : Calibration
        The given camera with `optics`.
    board : Board
    poses : tuple of BoardPose
        Poses of the flats on which the board was found.
    fitted : tuple of str
        Names of the parameters that were fitted because the data require them.
    observations : Observations
        Corners in microimages, sorted by pose.
    residual : (n, 2) float64 [px]
        Observed minus predicted positions.
    used : (n,) bool
        False for outliers.
    noise : float [px]
        Median standard error of one corner in one microimage, along one axis, from the residuals.
    widening : float
        Variance factor, at least 1, for errors that the microimages of a corner or the corners of a
        pose share.
    degeneracies : tuple of str
        Parameters that hardly separate, and combinations that are well known instead.
    warnings : tuple of str
    board_shape : (5,) float64 [mm]
        Deviation of the board from a flat square one, as `camera_model.SHAPE`; 0 if not fitted.

    Examples
    --------
    >>> found = lfcal.calibrate_metric(flats, camera, lfcal.Board(9, 6, 7.0))  # doctest: +SKIP
    >>> len(found.poses), found.optics.focal_length, found.rms  # doctest: +SKIP
    """

    calibration: Calibration
    board: Board
    poses: tuple[BoardPose, ...]
    fitted: tuple[str, ...]
    observations: Observations
    residual: Array
    used: Booleans
    noise: float
    widening: float
    degeneracies: tuple[str, ...]
    warnings: tuple[str, ...]
    board_shape: Array = field(default_factory=lambda: np.zeros(len(SHAPE)))

    def __repr__(self) -> str:
        return (
            f"MetricCalibration({len(self.poses)} poses, {len(self.residual)} corners, "
            f"{self.rms:.3f} px RMS)"
        )

    def _repr_html_(self) -> str:
        optics = self.optics
        names = ("focal length", "main lens to microlenses", "microlenses to sensor")
        lengths = (optics.focal_length, optics.mla_distance, optics.sensor_distance)
        figures = {name: f"{length:.4g} mm" for name, length in zip(names, lengths, strict=True)}
        return html_table(repr(self), figures, [*self.warnings, *self.degeneracies])

    @property
    def optics(self) -> Optics:
        """Optics of the camera."""
        assert self.calibration.optics is not None
        return self.calibration.optics

    @property
    def rms(self) -> float:
        """RMS distance between observed and predicted corners [px], without outliers."""
        return float(np.sqrt((self.residual[self.used] ** 2).sum(1).mean()))

    def save_poses(self, path: str | os.PathLike[str]) -> None:
        """Write the poses and the board as JSON."""
        board = {
            "pattern": self.board.pattern,
            "columns": self.board.columns,
            "rows": self.board.rows,
            "square_mm": self.board.square,
            "shape_mm": dict(zip(SHAPE, self.board_shape.tolist(), strict=True)),
        }
        data = {
            "schema": "lfcal-poses",
            "version": 1,
            "board": board,
            "fitted": list(self.fitted),
            "rms_px": self.rms,
            "poses": [pose.to_dict() for pose in self.poses],
        }
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def pose_of(
    found: Adjusted, m: int, board: Board, observations: Observations, name: str
) -> BoardPose:
    """Pose `m` of an adjusted camera, with the origin at the first corner of the board."""
    turn = found.poses.rotation[m]
    shift = found.poses.translation[m]
    own = slice(len(INTERNAL) + 6 * m, len(INTERNAL) + 6 * m + 6)
    x, y, z = middle = turn @ board.middle
    change = np.eye(6)
    change[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    used = (observations.pose == m) & (found.weight > 0)
    rms = float(np.sqrt((found.residual[used] ** 2).sum(1).mean()))
    return BoardPose(
        name,
        turn,
        shift - middle,
        change @ found.covariance[own, own] @ change.T,
        rms,
        int(used.sum()),
    )
