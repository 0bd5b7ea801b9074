"""The lattice that a flat shows against that of a camera: a shift in the middle and a linear map."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..detection.cell_centre import find_round_centres
from ..detection.first_lattice import find_first_lattices, fit_first_lattice
from ..detection.folding import fold_tiles
from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from ..lattice.lattice import Lattice
from ..runtime.checks import LIMITS
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, FlatError, check_type
from .settings import CameraCheckSettings

__all__ = [
    "LatticeMisfit",
    "choose_factor",
    "compare_lattices",
    "is_other_centre",
    "prepare_flat",
    "reduce_flat",
    "straighten",
]


@dataclass(frozen=True)
class LatticeMisfit:
    """A found lattice against the given one: at `p`, centres are `shift + (p - middle) @ linear` [px] further."""

    shift: NDArray[np.float64]  # (2,) [px] in the middle of the flat, to the nearest
    linear: NDArray[np.float64]  # (2, 2)
    half_size: NDArray[np.float64]  # (2,) [px] of the flat
    pitch: float  # [px]

    @classmethod
    def between(cls, given: Lattice, found: Lattice, settings: CameraCheckSettings) -> LatticeMisfit | None:
        """None where the cells are not the same."""
        steps = found.basis @ np.linalg.inv(given.basis)
        whole = np.rint(steps)
        if abs(abs(np.linalg.det(whole)) - 1) > 0.5:
            return None
        linear = np.linalg.inv(given.basis) @ np.linalg.solve(whole, found.basis) - np.eye(2)
        if np.linalg.norm(linear, 2) > settings.same_cell:
            return None
        middle = (np.array(given.image_size) - 1) / 2
        centre = given.points(np.rint(given.to_index(middle[None])))
        index = found.to_index(centre)[0]
        near = np.rint(index) + np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
        shifts = (near - index) @ found.basis
        shift = shifts[np.linalg.norm(shifts, axis=1).argmin()]
        return cls(shift, linear, np.array(given.image_size) / 2, given.pitch)

    @property
    def linear_size(self) -> float:
        """Largest stretch of the linear map."""
        return float(np.linalg.norm(self.linear, 2))

    def is_small(self, settings: CameraCheckSettings) -> bool:
        """Whether the camera fits, for all that its flat can tell."""
        corners = self.shift + (self.half_size * [[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ self.linear
        return bool(
            np.linalg.norm(self.shift) < LIMITS.shift * self.pitch
            and self.linear_size < settings.linear
            and np.linalg.norm(corners, axis=1).max() < settings.corner * self.pitch
        )


def straighten(lattice: Lattice) -> Lattice:
    """The straight lattice nearest to one with distortion."""
    if lattice.distortion is None:
        return lattice
    index = lattice.indices()
    index = index[:: max(1, len(index) // 4000)]
    design = np.column_stack([np.ones(len(index)), index])
    change: NDArray[Any] = np.linalg.lstsq(design, lattice.points(index), rcond=None)[0]
    return Lattice(change[0], change[1:], lattice.image_size, lattice.radius)


def prepare_flat(
    calibration: Calibration, image: ArrayLike, settings: CameraCheckSettings
) -> tuple[NDArray[Any], int, NDArray[np.float32]]:
    """A flat without its mosaic, the side of the blocks that it is reduced by, and the root of its luminance then."""
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
    factor = choose_factor(straighten(calibration.lattice), settings)
    return flat, factor, reduce_flat(flat, factor)


def choose_factor(lattice: Lattice, settings: CameraCheckSettings) -> int:
    """Side of the blocks of pixels that are averaged first."""
    width, height = lattice.image_size
    large = np.ceil(np.sqrt(width * height / settings.pixels))
    return max(1, int(lattice.pitch / settings.fine_pitch), min(int(lattice.pitch / settings.coarse_pitch), int(large)))


def reduce_flat(flat: NDArray[Any], factor: int) -> NDArray[np.float32]:
    """Root of the luminance (h, w) of a flat, of blocks of `factor` x `factor` pixels."""
    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        flat = flat if flat.dtype in (np.uint8, np.uint16, np.float32) else flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


def compare_lattices(
    picture: NDArray[np.float32], given: Lattice, settings: CameraCheckSettings
) -> tuple[Lattice | None, LatticeMisfit | None]:
    """A lattice on the picture, None where none is found, and its misfit, None where it is another one."""
    first: Lattice | None = None
    with suppress(CalibrationError, np.linalg.LinAlgError):
        for found in _find_lattices(picture, given, settings):
            misfit = LatticeMisfit.between(given, found, settings)
            if misfit is not None:
                return found, misfit
            first = first or found
    return first, None


def _find_lattices(picture: NDArray[np.float32], given: Lattice, settings: CameraCheckSettings) -> Iterator[Lattice]:
    """Lattices on a picture: at the basis of the given one, and where that is not there, of the spectrum."""
    with suppress(CalibrationError, np.linalg.LinAlgError):
        start = fit_first_lattice(picture, given.basis)
        if start.repeatability > settings.repeatability:
            yield start.lattice
    for start in islice(find_first_lattices(picture), settings.candidates):
        if start.doubt is None and start.repeatability > settings.repeatability:
            yield start.lattice


def is_other_centre(
    picture: NDArray[np.float32], found: Lattice, misfit: LatticeMisfit, settings: CameraCheckSettings
) -> bool:
    """Whether the average microimage is nearly as round about the centres given as about those found.

    In scenes without dark gaps, gaps may be taken for lenses.
    """
    if misfit.linear_size > settings.linear:
        return False
    rims = normalise_locally(edge_strength(picture), 0.5 * found.pitch)
    side = max(8, max(picture.shape) // settings.tiles)
    cells = [fold.mean() for fold in fold_tiles([picture, rims], found.basis, side, settings.bins)]
    guesses = find_round_centres(cells, found.basis)
    middle = (np.array(found.image_size) - 1) / 2
    centre = found.points(np.rint(found.to_index(middle[None])))[0] - misfit.shift
    index = centre @ np.linalg.inv(found.basis)
    for guess in guesses:
        away = guess.position - index
        if np.linalg.norm((away - np.rint(away)) @ found.basis) < LIMITS.shift * found.pitch:
            return guess.roundness > settings.nearly_as_round * guesses[0].roundness
    return False
