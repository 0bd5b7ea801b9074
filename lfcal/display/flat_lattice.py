"""Compare the lattice that a flat shows with that of a camera.

The lattice of the flat is measured from the basis of the camera, without its centres. If nothing
repeats at that basis, the lattice is searched without the camera. Flats are downscaled to
microimages of 10 to 20 pixels.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..lattice.cell import nearest_offsets
from ..lattice.lattice import Lattice
from ..runtime.arrays import ENOUGH_LENSES, Array, Floats, Singles, evenly
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, FlatError, check_type

if TYPE_CHECKING:
    from ..detection.search import Candidate

__all__ = [
    "MOST_SHIFT",
    "Misfit",
    "ReducedFlat",
    "compare_lattices",
    "prepare_flat",
    "reduce_flat",
]

# Largest shift of a right camera over the whole flat [pitch]: 0.05 on 60 simulated flats. Beyond
# it, errors are visible in pictures.
MOST_SHIFT = 0.06
# Least probability of a lattice that a camera is compared with.
_LIKELY = 0.5
# Least probability of a lattice, found at the basis of the camera, that may confirm the camera.
_LIKELY_AT_BASIS = 0.05
# Largest difference of two bases of one lattice, relative to the first.
_SAME_CELL = 0.1
# Largest relative difference of the basis of a right camera: 0.0011 on 60 simulated flats.
_SAME_BASIS = 0.0025
# Largest shift of a corner of a right camera [pitch]: 0.08 on the same flats.
_CORNER = 0.2
# Pitches [px] and pixels of downscaled flats: larger ones take time and show no more.
_PITCH = 18
_LEAST_PITCH = 10
_PIXELS = 4e6


class ReducedFlat(NamedTuple):
    """A flat, and a downscaled picture of it."""

    flat: Array  # without its mosaic
    factor: int  # side of the blocks of pixels that are averaged
    picture: Singles  # root of the luminance of the downscaled flat


def prepare_flat(calibration: Calibration, image: ArrayLike) -> ReducedFlat:
    """Check the arguments, remove the mosaic of the flat and downscale it."""
    from ..images.mosaic import equalise_mosaic, find_mosaic, remove_mosaic

    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    flat = np.asarray(image)
    width, height = calibration.image_size
    if flat.ndim not in (2, 3) or flat.shape[:2] != (height, width):
        raise FlatError(
            f"image has shape {flat.shape}; the camera is for flats of {width} x {height} px, give "
            "one of its size"
        )
    if flat.ndim == 2 and (calibration.mosaic or find_mosaic(flat)):
        flat = remove_mosaic(equalise_mosaic(flat))
    pitch = calibration.lattice.pitch
    large = int(np.ceil(np.sqrt(width * height / _PIXELS)))
    factor = max(1, int(pitch / _PITCH), min(int(pitch / _LEAST_PITCH), large))
    return ReducedFlat(flat, factor, reduce_flat(flat, factor))


def reduce_flat(flat: Array, factor: int) -> Singles:
    """Root of the luminance (h, w) of a flat, averaged over `factor` x `factor` pixels."""
    from ..images.preprocessing import sqrt_luminance

    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        if flat.dtype not in (np.uint8, np.uint16, np.float32):
            flat = flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


class Misfit(NamedTuple):
    """Offset of a found lattice from a given one: `shift + (p - middle) @ linear` [px] at `p`."""

    shift: Floats  # (2,) [px] in the middle of the flat, to the nearest centre
    linear: Floats  # (2, 2)
    given: Lattice

    @classmethod
    def between(cls, given: Lattice, found: Lattice) -> Misfit | None:
        """The offset, or None if the lattices have different cells."""
        whole = np.rint(found.basis @ np.linalg.inv(given.basis))
        if round(abs(np.linalg.det(whole))) != 1:
            return None
        linear = np.linalg.inv(given.basis) @ np.linalg.solve(whole, found.basis) - np.eye(2)
        if np.linalg.norm(linear, 2) > _SAME_CELL:
            return None
        index = found.to_index(given.points(given.middle[None]))
        return cls(-nearest_offsets(index, found.basis)[0], linear, given)

    @property
    def is_straight(self) -> bool:
        """Whether scale and angle are the same."""
        return float(np.linalg.norm(self.linear, 2)) < _SAME_BASIS

    @property
    def is_small(self) -> bool:
        """Whether the flat shows no fault of the camera."""
        half = np.array(self.given.image_size) / 2
        pitch = self.given.pitch
        corners = self.shift + (half * [[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ self.linear
        near = np.linalg.norm(corners, axis=1).max() < _CORNER * pitch
        return bool(self.is_straight and near and np.linalg.norm(self.shift) < MOST_SHIFT * pitch)


def compare_lattices(reduced: ReducedFlat, given: Lattice) -> tuple[Lattice | None, Misfit | None]:
    """The lattice of the flat, None if none is found, and its offset, None if its cells differ."""
    if given.distortion is not None:
        index = given.indices()[evenly(len(given), ENOUGH_LENSES)]
        design = np.column_stack([np.ones(len(index)), index])
        line: Array = np.linalg.lstsq(design, given.points(index), rcond=None)[0]
        given = Lattice(line[0], line[1:], given.image_size, given.radius)
    from ..detection.search import find_candidates

    small = given.downscaled(reduced.factor)
    own = _find_at_basis(reduced.picture, small)
    if own is not None and own.evidence.probability > _LIKELY:
        misfit = Misfit.between(small, own.lattice)
        if misfit is not None:
            return own.lattice, misfit
    other = None
    with suppress(CalibrationError, np.linalg.LinAlgError):
        for found in find_candidates(reduced.picture)[:3]:
            if found.evidence.probability <= _LIKELY:
                break
            misfit = Misfit.between(small, found.lattice)
            if misfit is not None:
                return found.lattice, misfit
            other = other or found.lattice
    if other is None and own is not None and own.evidence.probability > _LIKELY_AT_BASIS:
        # A faint lattice may confirm the camera; it is too uncertain to refute it.
        misfit = Misfit.between(small, own.lattice)
        if misfit is not None and misfit.is_small:
            return own.lattice, misfit
    return other, None


def _find_at_basis(picture: Singles, given: Lattice) -> Candidate | None:
    """The most probable lattice of a picture whose basis is near that of the given lattice."""
    from ..detection.search import measure_basis

    with suppress(CalibrationError, np.linalg.LinAlgError):
        return next(iter(measure_basis(picture, given)), None)
    return None
