"""From patch sizes to metres: the thin-lens model behind docs/geometry.md."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import CameraFileError

__all__ = ["Optics"]


@dataclass(frozen=True)
class Optics:
    """Distances of a focused plenoptic camera, all in mm.

    Parameters
    ----------
    focal_length : float [mm]
        Of the main lens.
    mla_distance : float [mm]
        `L`, from the main lens to the microlenses.
    sensor_distance : float [mm]
        `b`, from the microlenses to the sensor.
    pixel : float [mm]
        Side of a pixel.

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

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < np.inf:
                raise ValueError(f"{field.name} must be a positive number of mm, got {value!r}")
            object.__setattr__(self, field.name, float(value))

    def distance(self, ratio: ArrayLike) -> NDArray[np.float64]:
        """Distance [m] in front of the main lens of places with signed patch size over pitch `s / D`.

        docs/geometry.md: `s / D = (b / a - b / L) / (1 + b / L)`, where the image lies `a` in front of the microlenses
        and thus `L - a` behind the main lens. NaN where `ratio` is, or where no object can be imaged there; inf at
        infinity.
        """
        ratio = np.asarray(ratio, dtype=np.float64)
        b, far = self.sensor_distance, self.mla_distance
        with np.errstate(divide="ignore", invalid="ignore"):
            before = 1 / (ratio * (1 + b / far) / b + 1 / far)
            vergence = 1 / self.focal_length - 1 / (far - before)
            found = 1e-3 / vergence  # mm to m
        return np.where((far - before > 0) & (vergence >= 0), found, np.nan)

    def positions(self, points: NDArray[np.float64], ratio: ArrayLike, middle: ArrayLike) -> NDArray[np.float64]:
        """(n, 3) places [m] seen at scene coordinates (n, 2) [px]: x right, y down, z in front of the main lens.

        `middle` (2,) [px] is where the axis of the main lens meets the flat.
        """
        distance = self.distance(ratio)
        spread = 1 + self.sensor_distance / self.mla_distance
        tangent = (points - np.asarray(middle)) * (self.pixel / spread / self.mla_distance)
        return np.column_stack([tangent * distance[:, None], distance])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as JSON, as `load` reads it."""
        Path(path).write_text(json.dumps({f"{name}_mm": value for name, value in asdict(self).items()}, indent=1))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Optics:
        """Read a JSON file with `focal_length_mm`, `mla_distance_mm`, `sensor_distance_mm` and `pixel_mm`.

        Raises
        ------
        CameraFileError
            If the file cannot be read, or a number is missing or wrong.
        """
        names = [field.name for field in fields(cls)]
        remedy = f"give a JSON object with {', '.join(f'{name}_mm' for name in names)}"
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
            return cls(*(data[f"{name}_mm"] for name in names))
        except OSError as error:
            raise CameraFileError(f"{path}: cannot be read as optics ({error.strerror or error}); {remedy}") from error
        except KeyError as error:
            raise CameraFileError(f"{path}: {error} is missing; {remedy}") from error
        except (ValueError, TypeError) as error:
            raise CameraFileError(f"{path}: {error}; {remedy}") from error
