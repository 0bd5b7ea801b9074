"""How far the microimages of a flat lie from the lattice of a camera: a shift and a linear map.

The lattice that repeats on the flat is fitted anew, from the basis of the camera and nothing of its centres; where none
repeats at that basis, it is searched without the camera. Where it is that of the camera, it is fitted to the edges
between the microimages (`scene_fit`). Flats are reduced to microimages of some ten pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..detection.first_lattice import find_first_lattices, fit_first_lattice
from ..gain.gain_map import RegionGain
from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from ..lattice.lattice import Lattice
from ..runtime.arrays import Frozen
from ..runtime.checks import LIMITS, find_camera_doubt
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, FlatError, check_type

__all__ = ["FitCheck", "LatticeMisfit", "ReducedFlat", "check_fit", "compare_lattices", "fit_offsets", "prepare_flat"]

_REGION_NAMES = (
    ("top left corner", "middle of the top edge", "top right corner"),
    ("middle of the left edge", "middle", "middle of the right edge"),
    ("bottom left corner", "middle of the bottom edge", "bottom right corner"),
)


@dataclass(frozen=True, eq=False)
class FitCheck(Frozen):
    """Centres measured on a flat, against those of a given lattice.

    Parameters
    ----------
    positions : (3, 3, 2) float64 [px]
        Corners, edge middles and middle of the flat, in rows from the top.
    offset : (3, 3, 2) float64 [px]
        From the given centres to the measured ones there: a shift and a linear map. NaN where the flat shows none.
    pitch : float [px]
        Of the given lattice.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> check = lfcal.check_fit(sample.truth.calibration, sample.white)
    >>> bool(check.max_offset < 0.5), check.warning
    (True, None)
    """

    positions: NDArray[np.float64]
    offset: NDArray[np.float64]
    pitch: float

    @property
    def max_offset(self) -> float:
        """Longest offset [px], NaN where it is unknown."""
        return float(np.linalg.norm(self.offset, axis=-1).max())

    @property
    def limit(self) -> float:
        """Offset [px] of a corner up to which not to worry; what a scene shows moves microimages as much."""
        return LIMITS.stretch * self.pitch

    @property
    def verdict(self) -> str:
        """Whether to worry, and why, in a sentence."""
        if np.isnan(self.max_offset):
            return "this flat does not show where its microimages are; a white image would"
        return self.warning or (
            f"within {self.max_offset:.2f} px of this flat; no reason to worry: what the scene shows in microimages "
            f"moves such figures by up to {self.limit:.1f} px"
        )

    @property
    def warning(self) -> str | None:
        """What is wrong with the lattice where pictures would show it, else None."""
        shift = self.offset[1, 1]
        stretch = float(np.linalg.norm(self.offset - shift, axis=-1).max())
        row, column = np.unravel_index(int(np.linalg.norm(self.offset, axis=-1).argmax()), (3, 3))
        return find_camera_doubt(
            self.max_offset, float(np.linalg.norm(shift)) / self.pitch, stretch / self.pitch, _REGION_NAMES[row][column]
        )


@dataclass(frozen=True)
class LatticeMisfit:
    """A found lattice against the given one: at `p`, centres are `shift + (p - middle) @ linear` [px] further."""

    shift: NDArray[np.float64]  # (2,) [px] in the middle of the flat, to the nearest
    linear: NDArray[np.float64]  # (2, 2)
    half_size: NDArray[np.float64]  # (2,) [px] of the flat
    pitch: float  # [px]

    @classmethod
    def between(cls, given: Lattice, found: Lattice) -> LatticeMisfit | None:
        """None where the cells are not the same, to a tenth in scale or angle."""
        whole = np.rint(found.basis @ np.linalg.inv(given.basis))
        if round(abs(np.linalg.det(whole))) != 1:
            return None
        linear = np.linalg.inv(given.basis) @ np.linalg.solve(whole, found.basis) - np.eye(2)
        if np.linalg.norm(linear, 2) > 0.1:
            return None
        middle = (np.array(given.image_size) - 1) / 2
        centre = given.points(np.rint(given.to_index(middle[None])))
        index = found.to_index(centre)[0]
        shifts = (np.rint(index) + [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)] - index) @ found.basis
        shift = shifts[np.linalg.norm(shifts, axis=1).argmin()]
        return cls(shift, linear, np.array(given.image_size) / 2, given.pitch)

    @property
    def is_straight(self) -> bool:
        """Whether scale and angle are the same: right cameras differ by at most 0.0011 on 60 simulated flats."""
        return float(np.linalg.norm(self.linear, 2)) < 0.0025

    @property
    def is_small(self) -> bool:
        """Whether the camera fits, for all that its flat can tell."""
        corners = self.shift + (self.half_size * [[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ self.linear
        # In the corners right cameras are at most 0.08 pitches off.
        near = np.linalg.norm(corners, axis=1).max() < 0.2 * self.pitch
        return bool(self.is_straight and near and np.linalg.norm(self.shift) < LIMITS.shift * self.pitch)


@dataclass(frozen=True)
class ReducedFlat:
    """A flat without its mosaic, the side of the blocks it is reduced by, the root of its luminance then."""

    flat: NDArray[Any]
    factor: int
    picture: NDArray[np.float32]


def check_fit(calibration: Calibration, image: ArrayLike) -> FitCheck:
    """Measure on a flat how far the microimages are from the centres of `calibration`.

    Parameters
    ----------
    calibration : Calibration
    image : (h, w) or (h, w, 3) array_like
        A white image or any scene capture of this camera.

    Raises
    ------
    FlatError
        If the image is not of the size the calibration is for.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_fit
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> round(check_fit(Calibration(Lattice([11, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).max_offset)
    1
    """
    reduced = prepare_flat(calibration, image)
    found, misfit = compare_lattices(reduced, calibration.lattice)
    if found is None or misfit is None:
        return fit_offsets(calibration, None)
    return fit_offsets(calibration, reduced, None if misfit.is_small else found)


def prepare_flat(calibration: Calibration, image: ArrayLike) -> ReducedFlat:
    """A flat of the size of the camera, reduced."""
    from ..images.mosaic import equalise_mosaic, find_mosaic, remove_mosaic

    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    flat = np.asarray(image)
    width, height = calibration.image_size
    if flat.ndim not in (2, 3) or flat.shape[:2] != (height, width):
        raise FlatError(
            f"image has shape {flat.shape}; the camera is for flats of {width} x {height} px, give one of its size"
        )
    if flat.ndim == 2 and (calibration.mosaic or find_mosaic(flat)):
        flat = remove_mosaic(equalise_mosaic(flat))
    # Finer microimages than of 18 px take time and tell no more; large flats are reduced to 4 MP, or to 10 px.
    pitch, large = calibration.lattice.pitch, int(np.ceil(np.sqrt(width * height / 4e6)))
    factor = max(1, int(pitch / 18), min(int(pitch / 10), large))
    return ReducedFlat(flat, factor, _reduce(flat, factor))


def _reduce(flat: NDArray[Any], factor: int) -> NDArray[np.float32]:
    """Root of the luminance (h, w) of a flat, of blocks of `factor` x `factor` pixels."""
    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        flat = flat if flat.dtype in (np.uint8, np.uint16, np.float32) else flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


def compare_lattices(reduced: ReducedFlat, given: Lattice) -> tuple[Lattice | None, LatticeMisfit | None]:
    """A lattice on the reduced flat, None where none is found, and its misfit, None where it is another one."""
    if given.distortion is not None:
        index = given.indices()[:: max(1, len(given) // 4000)]
        line: NDArray[Any] = np.linalg.lstsq(
            np.column_stack([np.ones(len(index)), index]), given.points(index), rcond=None
        )[0]
        given = Lattice(line[0], line[1:], given.image_size, given.radius)
    small, first = given.downscaled(reduced.factor), None
    with suppress(CalibrationError, np.linalg.LinAlgError):
        for found in _find_lattices(reduced.picture, small):
            misfit = LatticeMisfit.between(small, found)
            if misfit is not None:
                return found, misfit
            first = first or found
    return first, None


def _find_lattices(picture: NDArray[np.float32], given: Lattice) -> Iterator[Lattice]:
    """Lattices on a picture: at the basis of the given one, and where that is not there, of the spectrum."""
    with suppress(CalibrationError, np.linalg.LinAlgError):
        start = fit_first_lattice(picture, given.basis)
        if start.repeatability > 0.5:
            yield start.lattice
    for start in islice(find_first_lattices(picture), 3):
        if start.doubt is None and start.repeatability > 0.5:
            yield start.lattice


def fit_offsets(calibration: Calibration, reduced: ReducedFlat | None, start: Lattice | None = None) -> FitCheck:
    """`check_fit` on a reduced flat, None if it shows no lattice; from `start`, if that of the camera is far off."""
    lattice = calibration.lattice
    width, height = lattice.image_size
    positions = np.stack(np.meshgrid([0, (width - 1) / 2, width - 1], [0, (height - 1) / 2, height - 1]), -1)
    offset = np.full((3, 3, 2), np.nan)
    if reduced is not None:
        factor = reduced.factor
        small = lattice.downscaled(factor)
        offset = _measure(reduced.picture, small, start or small, positions / factor) * factor
        gain = calibration.gain_map
        if gain is not None and len(gain.cut) and start is None:
            # Mechanical vignetting moves rims: offsets that the gain map shows as well are no misfit.
            light = np.nan_to_num(RegionGain(gain, lattice).at(0, 0, width, height))
            offset -= np.nan_to_num(_measure(_reduce(light, factor), small, small, positions / factor)) * factor
    return FitCheck(positions, offset, lattice.pitch)


def _measure(
    picture: NDArray[np.float32], given: Lattice, start: Lattice, positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(3, 3, 2) offsets [px] of the lattice on a picture from the given one; NaN where its halves do not agree."""
    from ..scene_fit.fit import fit_scene

    rims = normalise_locally(edge_strength(picture), 0.5 * given.pitch)
    try:
        fit = fit_scene(rims, start)
    except (CalibrationError, np.linalg.LinAlgError):
        return np.full((3, 3, 2), np.nan)
    if not fit.half_difference < 0.05 * given.pitch:
        return np.full((3, 3, 2), np.nan)
    found = Lattice(fit.origin, fit.basis, given.image_size, given.radius, fit.distortion)
    index = given.indices()[:: max(1, len(given) // 4000)]
    centres = given.points(index)
    # From the middle one on, so that all are compared with lenses to the same side.
    own, first = found.to_index(centres), found.to_index(given.points(given.middle[None]))
    away = found.points(np.rint(first) + np.rint(own - first)) - centres
    # A distortion that single flats show is not told from what the scene shows.
    middle = (np.array(given.image_size) - 1) / 2
    design = np.column_stack([np.ones(len(centres)), centres - middle])
    change = np.linalg.lstsq(design, away, rcond=None)[0]
    return change[0] + (positions - middle) @ change[1:]
