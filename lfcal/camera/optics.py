"""From patch sizes to metres: main lens, microlens array and sensor, with their covariance."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from reprlib import repr as brief
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.arrays import Frozen
from ..runtime.errors import CameraFileError, check_numbers, check_path
from ..runtime.input_file import read_text
from ..runtime.output_file import atomic_write

__all__ = ["OPTICS_PARAMETERS", "Optics", "object_slopes", "turn_to_array"]

Array = NDArray[np.float64]

#: Order of the rows of `Optics.covariance`.
OPTICS_PARAMETERS = (
    "focal_length",
    "mla_distance",
    "sensor_distance",
    "principal_x",
    "principal_y",
    "k1",
    "k2",
    "k3",
    "p1",
    "p2",
    "tilt_x",
    "tilt_y",
    "curvature",
    "pupil",
)
_LENGTHS = ("focal_length", "mla_distance", "sensor_distance", "pixel")
_IN_MM = (*_LENGTHS, "pupil", "microlens_focal_lengths")
_WANTED = ", ".join(f"{name}_mm" for name in _LENGTHS)
# Fields that are tuples, and their lengths.
_VECTORS = {
    "principal_point": 2,
    "radial": 3,
    "tangential": 2,
    "tilt": 2,
    "microlens_focal_lengths": None,
}
# Step of the differences that propagate errors [standard errors of a parameter], and its largest
# size for `s / D`.
_STEP = 0.1
_MOST_STEP = 1e-3
_M_PER_MM = 1e-3
# Largest size of a length, coefficient or covariance: the sizes of their squares are numbers too.
_LARGEST = 1e30


def object_slopes(image: Array, coefficients: Sequence[float] | Array) -> Array:
    """Slopes (n, 2) in front of the main lens for slopes (n, 2) behind it.

    `coefficients` (5,) are k1, k2, k3, p1, p2 of the distortion.
    """
    k1, k2, k3, p1, p2 = coefficients
    x, y = image.T
    square = x * x + y * y
    gain = 1 + square * (k1 + square * (k2 + square * k3))
    bent_x = x * gain + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    bent_y = y * gain + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([bent_x, bent_y])


def turn_to_array(tilt: Sequence[float] | Array) -> Array:
    """Rotation (3, 3) from the main lens to an array that is tilted about x, then about y [rad]."""
    (cx, sx), (cy, sy) = ((np.cos(a), np.sin(a)) for a in tilt)
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    return about_y @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])


@dataclass(frozen=True, eq=False)
class Optics(Frozen):
    """Optics of a focused plenoptic camera: distances, distortion, tilt and their covariance.

    Parameters
    ----------
    focal_length : float [mm]
        `F`, of the main lens.
    mla_distance : float [mm]
        `L`, from the main lens to the microlenses.
    sensor_distance : float [mm]
        `b`, from the microlenses to the sensor.
    pixel : float [mm]
        Side of a pixel.
    principal_point : (float, float) [px] or None
        Point of the flat on the axis of the main lens; None if it is unknown.
    radial : (float, float, float)
        `k1, k2, k3`: the slope `t` behind the main lens is `t (1 + k1 |t|^2 + ...)` in front of it.
        OpenCV distorts in the other direction.
    tangential : (float, float)
        `p1, p2`, in the same direction.
    tilt : (float, float) [rad]
        Tilt of microlens array and sensor together, about the x and the y axis of the flat. With a
        positive first angle the lower part of the flat lies farther from the main lens, with a
        positive second angle its right part lies nearer.
    curvature : float
        Curvature of the image field: the power of the main lens is `(1 + curvature |t|^2) / F`.
    pupil : float [mm]
        Distance of the principal plane of the main lens behind its entrance pupil, seen from the
        scene.
    microlens_focal_lengths : tuple of floats [mm]
        One for each lens type; empty if unknown.
    covariance : (14, 14) float64 or None
        Covariance of `OPTICS_PARAMETERS`, 0 for those that were not fitted; None if not measured.

    Examples
    --------
    >>> optics = Optics(focal_length=50, mla_distance=58, sensor_distance=0.7, pixel=0.005)
    >>> optics.distance([-0.3]).round(3)
    array([0.29])
    """

    focal_length: float
    mla_distance: float
    sensor_distance: float
    pixel: float
    principal_point: tuple[float, float] | None = None
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    curvature: float = 0.0
    pupil: float = 0.0
    microlens_focal_lengths: tuple[float, ...] = ()
    covariance: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in (*_LENGTHS, "curvature", "pupil"):
            (value,) = _numbers(name, (getattr(self, name),), 1)
            if value <= 0 and name in _LENGTHS:
                raise ValueError(f"{name} must be a positive number of mm, got {value!r}")
            self._set(**{name: value})
        for name, length in _VECTORS.items():
            if getattr(self, name) is not None:
                self._set(**{name: _numbers(name, getattr(self, name), length)})
        if self.covariance is not None:
            covariance = check_numbers(self.covariance, "covariance")
            shape = (len(OPTICS_PARAMETERS),) * 2
            if covariance.shape != shape or not np.abs(covariance).max() <= _LARGEST:
                raise ValueError(
                    f"covariance must be 14 x 14 finite numbers, got shape {covariance.shape}"
                )
            self._set(covariance=covariance)

    @property
    def parameters(self) -> Array:
        """(14,) values of `OPTICS_PARAMETERS`; the principal point is NaN if it is unknown."""
        principal = self.principal_point or (np.nan, np.nan)
        lengths = (self.focal_length, self.mla_distance, self.sensor_distance)
        bent = (*self.radial, *self.tangential)
        return np.array([*lengths, *principal, *bent, *self.tilt, self.curvature, self.pupil])

    @property
    def standard_errors(self) -> Array:
        """(14,) standard errors of `OPTICS_PARAMETERS`; NaN if not measured, 0 if not fitted."""
        if self.covariance is None:
            return np.full(len(OPTICS_PARAMETERS), np.nan)
        return np.sqrt(np.maximum(np.diag(self.covariance), 0))

    def with_parameters(self, values: ArrayLike) -> Optics:
        """The same optics with other values (14,) of `OPTICS_PARAMETERS`."""
        v = np.asarray(values, dtype=np.float64).tolist()
        changed: dict[str, Any] = dict(zip(_LENGTHS[:3], v[:3], strict=True))
        changed["principal_point"] = None if np.isnan(v[3]) else v[3:5]
        changed |= {"radial": v[5:8], "tangential": v[8:10], "tilt": v[10:12]}
        return replace(self, **changed, curvature=v[-2], pupil=v[-1])

    def distance(self, ratio: ArrayLike, points: ArrayLike | None = None) -> Array:
        """Distance [m] in front of the main lens of points with signed patch size over pitch `s/D`.

        The formula of docs/geometry.md is `s / D = (b / a - b / L) / (1 + b / L)`, where the image
        lies `a` in front of the microlenses and thus `L - a` behind the main lens. The distance is
        NaN if `ratio` is NaN or belongs to no object, and inf at infinity.

        Parameters
        ----------
        ratio : array_like (...)
        points : array_like (..., 2) [px], optional
            Scene coordinates of the points, for the tilt of the array and the curvature of the
            field; by default all points lie on the axis.
        """
        values = check_numbers(ratio, "ratio")
        where = np.zeros((np.size(ratio), 2))
        if points is not None and self.principal_point is not None:
            where = np.asarray(points, dtype=np.float64).reshape(-1, 2) - self.principal_point
        return self._behind(where, values.ravel())[0].reshape(values.shape)  # type: ignore[no-any-return]

    def positions(self, points: Array, ratio: ArrayLike, middle: ArrayLike | None = None) -> Array:
        """(n, 3) points [m] at scene coordinates (n, 2) [px]: x right, y down, z from the lens.

        `middle` (2,) [px] replaces the principal point if it is unknown.
        """
        centre = self.principal_point if self.principal_point is not None else middle
        if centre is None:
            raise ValueError(
                "middle must be given: the principal point of these optics is not known"
            )
        where = np.asarray(points, dtype=np.float64) - np.asarray(centre, dtype=np.float64)
        distance, slopes = self._behind(where, np.asarray(ratio, dtype=np.float64))
        slopes = object_slopes(slopes, (*self.radial, *self.tangential))
        return np.column_stack([slopes * distance[:, None], distance])

    def distance_error(
        self, ratio: ArrayLike, ratio_error: ArrayLike, points: ArrayLike | None = None
    ) -> Array:
        """Standard errors [m] of `distance`, from the errors of `ratio` and of the calibration.

        Without a covariance, the errors of the calibration are omitted. The result is inf if an
        error is inf, and NaN if the distance is NaN.
        """
        ratio = np.asarray(ratio, dtype=np.float64)
        error = np.asarray(ratio_error, dtype=np.float64)
        step = np.where(
            np.isfinite(error) & (error > 0), np.minimum(_STEP * error, _MOST_STEP), 1e-6
        )
        with np.errstate(invalid="ignore"):
            change = self.distance(ratio + step, points) - self.distance(ratio - step, points)
            variance = (change / (2 * step) * error) ** 2
        if self.covariance is not None:
            # Steps along the principal axes of the covariance move F, L and b together.
            scale = self.standard_errors
            inverse = np.divide(1, scale, out=np.zeros_like(scale), where=scale > 0)
            values, axes = np.linalg.eigh(self.covariance * np.outer(inverse, inverse))
            known = values > values[-1] * 1e-15
            moves = (_STEP * np.sqrt(values[known]) * axes[:, known]).T * scale
            if (np.abs(moves[:, :3]) >= self.parameters[:3]).any():
                # The lengths are not known at all.
                return np.where(np.isnan(variance), np.nan, np.inf)
            for move in moves:
                near = self.with_parameters(self.parameters + move).distance(ratio, points)
                far = self.with_parameters(self.parameters - move).distance(ratio, points)
                with np.errstate(invalid="ignore"):
                    variance = variance + ((near - far) / (2 * _STEP)) ** 2
        return np.sqrt(variance)  # type: ignore[no-any-return]

    def _behind(self, where: Array, ratio: Array) -> tuple[Array, Array]:
        """Distances (n,) [m] of points, and slopes (n, 2) of their rays behind the main lens.

        `where` (n, 2) [px] are scene coordinates relative to the axis, `ratio` (n,) is `s / D`.
        """
        turn = turn_to_array(self.tilt)
        axis = turn[:, 2]
        far = self.mla_distance * axis[2]
        spread = 1 + self.sensor_distance / far
        with np.errstate(divide="ignore", invalid="ignore"):
            near = 1 / (ratio * spread / self.sensor_distance + 1 / far)
            lens = where * (self.pixel / spread)
            across = lens * (1 - near / far)[:, None] - near[:, None] * (axis[:2] / axis[2])
            image = np.column_stack([across, -near]) @ turn
            behind = image[:, 2] + self.mla_distance
            slopes = image[:, :2] / behind[:, None]
            bent = 1 + self.curvature * (slopes**2).sum(1)
            vergence = bent / self.focal_length - 1 / behind
            found = _M_PER_MM * (1 / vergence - self.pupil)
        return np.where((behind > 0) & (vergence >= 0), found, np.nan), slopes

    def to_dict(self) -> dict[str, Any]:
        """The optics as plain numbers, as written by `save`."""
        known = {
            name: value if value is None else np.asarray(value).tolist()
            for name, value in vars(self).items()
        }
        return {f"{name}_mm" if name in _IN_MM else name: value for name, value in known.items()}

    @classmethod
    def from_dict(cls, data: Any) -> Optics:
        """Rebuild from `to_dict`; four lengths are needed. KeyError or ValueError if wrong."""
        if not isinstance(data, dict):
            raise ValueError(f"optics must be an object with {_WANTED}")
        names = [field.name for field in fields(cls)]
        given = {name: data.get(f"{name}_mm", data.get(name)) for name in names}
        known: dict[str, Any] = {name: v for name, v in given.items() if v is not None}
        return cls(**known | {name: data[f"{name}_mm"] for name in _LENGTHS})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the optics as JSON, which `load` reads."""
        with atomic_write(path) as temporary:
            temporary.write_text(json.dumps(self.to_dict(), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Optics:
        """Read the optics in a camera file of `lfcal metric`, or in a JSON file of `save`.

        A JSON file needs `focal_length_mm`, `mla_distance_mm`, `sensor_distance_mm` and `pixel_mm`.
        CameraFileError if a number is missing or wrong.
        """
        file = check_path(path)
        try:
            data = json.loads(read_text(file))
            if isinstance(data, dict) and data.get("optics"):
                data = data["optics"]
            return cls.from_dict(data)
        except (OSError, KeyError, ValueError, TypeError, RecursionError) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            if isinstance(error, OSError):
                reason = f"cannot be read as optics ({error.strerror or error})"
            raise CameraFileError(f"{path}: {reason}; give a JSON object with {_WANTED}") from error


def _numbers(name: str, values: Any, length: int | None) -> tuple[float, ...]:
    try:
        found = tuple(float(v) for v in values if not isinstance(v, (bool, str)))
    except (TypeError, OverflowError):
        found = (np.inf,)
    if not np.abs(found).max(initial=0) <= _LARGEST or len(found) != (length or len(values)):
        raise ValueError(
            f"{name} must be {length or 'a list of'} finite numbers, got {brief(values)}"
        )
    return found
