"""A light-field microscope: objective, tube lens, microlenses in the image plane, sensor in their
focal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.gain.gain_map import Vignetting

__all__ = ["Microscope"]

# Directions and radii at which the light of a microimage is tabled.
_RINGS = 64


@dataclass(frozen=True)
class Microscope:
    """An unfocused light-field microscope (Levoy et al. 2006), telecentric, with square
    microlenses.

    The defaults are those of a 60x water immersion objective behind microlenses of 100 micrometres.

    Parameters
    ----------
    lenses : (int, int)
        Columns and rows of whole microlenses on the flat.
    pitch : float [px]
        Of the microlenses.
    rotation : float [degrees]
        Of the lattice on the sensor, clockwise on the screen.
    pixel : float [um]
        Side of a pixel on the sensor.
    magnification, na, medium_index : float
        Of the objective with its tube lens; index of the medium of the specimen.
    microlens_focal_length : float [um]
    wavelength : float [um]
        In vacuum; used by `propagate_flat` alone.

    Examples
    --------
    >>> from data_synth.microscopy import Microscope
    >>> microscope = Microscope(lenses=(21, 21))
    >>> round(microscope.pupil_radius, 2), microscope.size
    (7.69, (323, 323))
    """

    lenses: tuple[int, int] = (21, 21)
    pitch: float = 15.4
    rotation: float = 0.0
    pixel: float = 6.5
    magnification: float = 60.0
    na: float = 1.2
    medium_index: float = 1.35
    microlens_focal_length: float = 2500.0
    wavelength: float = 0.593

    def __post_init__(self) -> None:
        if not 0 < self.na < self.medium_index:
            raise ValueError(
                f"na must lie between 0 and medium_index ({self.medium_index}), got {self.na}"
            )
        if min(self.lenses) < 3:
            raise ValueError(f"lenses must be at least 3 x 3, got {self.lenses}")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the flat [px]."""
        columns, rows = self.lenses
        return round(columns * self.pitch), round(rows * self.pitch)

    @property
    def pupil_radius(self) -> float:
        """Radius of a microimage [px]: that of the ray at the rim of the aperture."""
        return self.microlens_focal_length * self.na / self.magnification / self.pixel

    @property
    def object_pixel(self) -> float:
        """Side of a pixel of the flat, seen through the objective [um]."""
        return self.pixel / self.magnification

    def optics(self) -> dict[str, Any]:
        """Keywords of `lfrender.volume.Microscope`."""
        return {
            "na": self.na,
            "medium_index": self.medium_index,
            "magnification": self.magnification,
            "microlens_focal_length": self.microlens_focal_length,
            "pixel_size": self.pixel,
        }

    @property
    def lattice(self) -> Lattice:
        """The true lattice: a microlens lies on the optical axis, in the middle of the flat."""
        turn = np.radians(self.rotation)
        basis = self.pitch * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        middle = (np.array(self.size) - 1) / 2
        return Lattice(middle, basis, self.size, min(self.pupil_radius, self.pitch / 2))

    def nearest_lenses(self, x: Any, y: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lattice index (n, 2) of the lens nearest to each point of a grid, and offset from it.

        The grid has columns `x` and rows `y` [px]; its points follow row by row.
        """
        across, down = np.meshgrid(x, y)
        points = np.column_stack([across.ravel(), down.ravel()]).astype(float)
        index = np.rint(self.lattice.to_index(points))
        return index, points - self.lattice.points(index)

    def calibration(self, light: Any) -> Calibration:
        """The true camera, with the `light` (h, w) of a white image as the mean over all
        microimages."""
        width, height = self.size
        _, offset = self.nearest_lenses(np.arange(width), np.arange(height))
        away = np.hypot(*offset.T)
        step = 0.75 * self.pitch / _RINGS
        ring = np.rint(away / step).astype(int)
        total = np.bincount(ring, np.ravel(light), _RINGS)
        count = np.bincount(ring, minlength=_RINGS)
        known = count > 0
        places = np.arange(len(count))
        profile = np.interp(places, places[known], total[known] / count[known])
        profile = profile / profile.max()
        return Calibration(self.lattice, Vignetting(profile, step), source="truth")
