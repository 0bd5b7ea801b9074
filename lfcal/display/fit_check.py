"""Check whether a camera fits a flat, and measure how far the microimages lie from its lattice.

A camera whose gain map matches the average cells of all parts of the flat is confirmed at once
(`confirmation`). Else the lattice of the flat is measured from the basis of the camera, without its
centres. If nothing repeats at that basis, the lattice is searched without the camera. If it is the
lattice of the camera, it is fitted to the edges between the microimages (`scene_fit`). Flats are
downscaled to microimages of 10 to 20 pixels.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..lattice.cell import nearest_offsets
from ..lattice.lattice import Lattice, describe_orientation
from ..runtime.arrays import Array, Floats, Frozen, Singles
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, CameraFileError, FlatError, check_type
from .compare import REGIONS, nine_places

if TYPE_CHECKING:
    from ..detection.search import Candidate

__all__ = ["CameraCheck", "FitCheck", "check_camera", "check_fit", "choose_orientation"]

_REMEDY = "give the camera of this flat, or calibrate on it"
# Largest shift of a right camera over the whole flat [pitch]: 0.05 on 60 simulated flats. Larger
# errors are visible in pictures.
_SHIFT = 0.06
# Largest shift of a corner by scale or rotation [pitch]: 0.028 with right cameras on 11 captures,
# 0.039 with a wrong one.
_STRETCH = 0.033
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
# Difference of the light of lens types at the rims that tells their order.
_RIM_LIGHT = 0.03
# Pitches [px] and pixels of downscaled flats: larger ones take time and show no more.
_PITCH = 18
_LEAST_PITCH = 10
_PIXELS = 4e6
# Lenses to which a straight lattice is fitted.
_LENSES = 4000
# Lenses that are fitted to check a camera: 8,000 give the same verdicts on eight captures. Their
# offsets differ by less than 0.004 pitch, or 0.02 where the camera is wrong.
_CHECKED_LENSES = 1400
# The same where the offsets are wanted.
_MEASURED_LENSES = 8000
# Largest difference of the lattices of two halves of the microimages [pitch].
_HALVES = 0.05


@dataclass(frozen=True, eq=False)
class FitCheck(Frozen):
    """Offsets of the centres measured on a flat from those of a given lattice.

    Parameters
    ----------
    positions : (3, 3, 2) float64 [px]
        Corners, edge middles and middle of the flat, in rows from the top.
    offset : (3, 3, 2) float64 [px]
        Vectors from the given centres to the measured ones at these positions: a shift and a linear
        map. NaN if the flat does not show them.
    pitch : float [px]
        Pitch of the given lattice.

    Examples
    --------
    >>> FitCheck(np.zeros((3, 3, 2)), np.zeros((3, 3, 2)), 20.0).max_offset
    0.0
    """

    positions: Floats
    offset: Floats
    pitch: float

    @property
    def max_offset(self) -> float:
        """Longest offset [px], NaN if it is unknown."""
        return float(np.linalg.norm(self.offset, axis=-1).max())

    @property
    def limit(self) -> float:
        """Offset [px] of a corner that content of the scene can cause with a right camera."""
        return _STRETCH * self.pitch

    @property
    def verdict(self) -> str:
        """A sentence that says whether the camera fits the flat."""
        if np.isnan(self.max_offset):
            return "this flat does not show where its microimages are; a white image would"
        return self.warning or (
            f"within {self.max_offset:.2f} px of this flat; no reason to worry: what the scene "
            f"shows in microimages moves such figures by up to {self.limit:.1f} px"
        )

    @property
    def warning(self) -> str | None:
        """The error of the lattice if it is visible in pictures, else None."""
        shift = self.offset[1, 1]
        stretch = float(np.linalg.norm(self.offset - shift, axis=-1).max())
        if not (stretch > self.limit or np.linalg.norm(shift) > _SHIFT * self.pitch):
            return None
        where = REGIONS[int(np.linalg.norm(self.offset, axis=-1).argmax())]
        return (
            f"the lattice is off by up to {self.max_offset:.1f} px in the {where}, which pictures "
            "show: calibrate on this flat"
        )


@dataclass(frozen=True)
class CameraCheck:
    """Result of checking a camera on a flat.

    Parameters
    ----------
    fits : bool
        False if the flat has another lattice, so that results of this camera would be meaningless.
    problem : str or None
        The fault of the camera and a remedy, None if there is no fault.
    adjusted : Calibration or None
        The camera shifted onto the microimages if a shift is the only fault, as of a cropped flat.
    checked : bool
        False if no microimages are visible on the flat.

    Examples
    --------
    >>> from lfcal import CameraCheck
    >>> CameraCheck().fits, CameraCheck(problem="the microimages lie 5.9 px beside").problem[:16]
    (True, 'the microimages ')
    """

    fits: bool = True
    problem: str | None = None
    adjusted: Calibration | None = None
    checked: bool = True

    def warn(self, calibration: Calibration, name: object) -> Calibration:
        """The camera, with its problem as a warning; CameraFileError if it is of another array."""
        if not self.fits:
            raise CameraFileError(f"{name}: {self.problem}")
        warning = self.problem
        if not self.checked:
            warning = (
                "no microimages can be seen on this flat, so that the camera could not be checked; "
                "give a brighter one"
            )
        if warning is None:
            return calibration
        return replace(calibration, warnings=(*calibration.warnings, warning))


def check_fit(calibration: Calibration, image: ArrayLike) -> FitCheck:
    """Measure the offsets of the microimages on a flat from the centres of `calibration`.

    `image` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it has another
    size.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_fit
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> camera = Calibration(Lattice([11, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> round(check_fit(camera, white).max_offset)
    1
    """
    reduced = _prepare(calibration, image)
    found, misfit = _compare(reduced, calibration.lattice)
    return _fit_offsets(calibration, reduced, found, misfit, _MEASURED_LENSES)


def check_camera(calibration: Calibration, image: ArrayLike) -> CameraCheck:
    """Check whether a flat can have been made with a camera, in about a tenth of a second.

    The check finds turned or mirrored flats, shifts of more than a tenth of the pitch, pitches that
    are wrong by more than 0.25 %, another array, and lens types in another order. A flat without a
    visible lattice, such as a dark one, cannot be checked (`CameraCheck.checked`).

    `image` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it has another
    size.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_camera
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> camera = Calibration(Lattice([4, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> check_camera(camera, white).problem[:19]
    'the microimages lie'
    """
    from threadpoolctl import threadpool_limits

    # The equations are too small for more threads to pay off.
    with threadpool_limits(1, "blas"):
        return _check(calibration, _prepare(calibration, image))


def _check(calibration: Calibration, reduced: _Reduced) -> CameraCheck:
    from .confirmation import confirms_camera

    lattice = calibration.lattice
    if confirms_camera(calibration, lattice.downscaled(reduced.factor), reduced.picture):
        return CameraCheck(problem=_find_type_conflict(calibration, reduced.flat))
    found, misfit = _compare(reduced, lattice)
    if found is None and reduced.factor > 1:
        # Microimages that are much smaller than those of the camera vanish by downscaling.
        reduced = _Reduced(reduced.flat, 1, _reduce(reduced.flat, 1))
        found, misfit = _compare(reduced, lattice)
    if found is None:
        return CameraCheck(checked=False)
    if misfit is None:
        return CameraCheck(False, _describe_other(lattice, found, reduced.factor))
    if misfit.is_small:
        conflict = _find_type_conflict(calibration, reduced.flat)
        offsets = _fit_offsets(calibration, reduced, found, misfit, _CHECKED_LENSES)
        return CameraCheck(problem=conflict or offsets.warning)
    if not misfit.is_straight:
        step = np.eye(2) + misfit.linear
        scale = 100 * (float(np.sqrt(abs(np.linalg.det(step)))) - 1)
        turn = float(np.degrees(np.arctan2(step[0, 1] - step[1, 0], np.trace(step))))
        return CameraCheck(
            problem=f"the pitch on the flat is {scale:+.2f} % and its rotation {turn:+.2f} degrees "
            f"from the camera; {_REMEDY}"
        )
    shift = reduced.factor * misfit.shift
    return CameraCheck(
        problem=f"the microimages lie {np.linalg.norm(shift):.1f} px beside those of the camera, "
        f"as in a crop, a turned flat, or with another camera; {_REMEDY}",
        adjusted=replace(calibration, lattice=replace(lattice, origin=lattice.origin + shift)),
    )


def choose_orientation(down: Calibration, up: Calibration, image: ArrayLike) -> Calibration:
    """The reading of a table of centres, with y pointing down or up, that an image confirms."""
    right = [
        check.checked and check.problem is None
        for check in (check_camera(one, image) for one in (down, up))
    ]
    index = up.lattice.to_index(down.lattice.centres())
    if right[0] != right[1] or np.abs(index - np.rint(index)).max() < _STRETCH:
        return up if right[1] and not right[0] else down
    warning = (
        "the image does not show whether y of the table points up or down; it was taken to point "
        "down"
    )
    return replace(down, warnings=(*down.warnings, warning))


def _describe_other(given: Lattice, found: Lattice, factor: int) -> str:
    """A message about a flat that shows another lattice, downscaled by `factor`."""
    shape, rows, _ = describe_orientation(found)
    own_shape, own_rows, _ = describe_orientation(given)
    return (
        f"the flat was not made with this camera: its microimages are {shape}, rows {rows}, pitch "
        f"{factor * found.pitch:.2f} px, those of the camera {own_shape}, rows {own_rows}, pitch "
        f"{given.pitch:.2f} px, unless the flat was turned or mirrored; {_REMEDY}"
    )


def _find_type_conflict(calibration: Calibration, flat: Array) -> str | None:
    """A message if the lens types of a camera contradict the light or the sharpness of a flat."""
    from ..images.preprocessing import sqrt_luminance
    from ..lens_types.type_check import find_rim_conflict, find_type_conflict

    types = calibration.lens_types
    gain = calibration.gain_map
    lattice = calibration.lattice
    if types is None or not types.ordered:
        return None
    conflict = None
    rims_known = False
    if gain is not None and gain.type_light.size:
        conflict = find_rim_conflict(types, gain, lattice.radius)
        rims_known = float(np.ptp(gain.type_rims(lattice.radius), axis=0).max()) > _RIM_LIGHT
    conflict = conflict or find_type_conflict(sqrt_luminance(flat), lattice, types, rims_known)
    return conflict and f"{conflict}; was the flat mirrored, turned or cropped? {_REMEDY}"


class _Reduced(NamedTuple):
    """A flat, and a downscaled picture of it."""

    flat: Array  # without its mosaic
    factor: int  # side of the blocks of pixels that are averaged
    picture: Singles  # root of the luminance of the downscaled flat


def _prepare(calibration: Calibration, image: ArrayLike) -> _Reduced:
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
    return _Reduced(flat, factor, _reduce(flat, factor))


def _reduce(flat: Array, factor: int) -> Singles:
    """Root of the luminance (h, w) of a flat, averaged in blocks of `factor` x `factor` pixels."""
    from ..images.preprocessing import sqrt_luminance

    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        flat = flat if flat.dtype in (np.uint8, np.uint16, np.float32) else flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


class _Misfit(NamedTuple):
    """Offset of a found lattice from a given one: `shift + (p - middle) @ linear` [px] at `p`."""

    shift: Floats  # (2,) [px] in the middle of the flat, to the nearest centre
    linear: Floats  # (2, 2)
    given: Lattice

    @classmethod
    def between(cls, given: Lattice, found: Lattice) -> _Misfit | None:
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
        return bool(self.is_straight and near and np.linalg.norm(self.shift) < _SHIFT * pitch)


def _compare(reduced: _Reduced, given: Lattice) -> tuple[Lattice | None, _Misfit | None]:
    """The lattice of the flat, None if none is found, and its offset, None if its cells differ."""
    if given.distortion is not None:
        index = given.indices()[:: max(1, len(given) // _LENSES)]
        design = np.column_stack([np.ones(len(index)), index])
        line: Array = np.linalg.lstsq(design, given.points(index), rcond=None)[0]
        given = Lattice(line[0], line[1:], given.image_size, given.radius)
    from ..detection.search import find_candidates

    small = given.downscaled(reduced.factor)
    own = _find_at_basis(reduced.picture, small)
    if own is not None and own.evidence.probability > _LIKELY:
        misfit = _Misfit.between(small, own.lattice)
        if misfit is not None:
            return own.lattice, misfit
    other = None
    with suppress(CalibrationError, np.linalg.LinAlgError):
        for found in find_candidates(reduced.picture)[:3]:
            if found.evidence.probability <= _LIKELY:
                break
            misfit = _Misfit.between(small, found.lattice)
            if misfit is not None:
                return found.lattice, misfit
            other = other or found.lattice
    if other is None and own is not None and own.evidence.probability > _LIKELY_AT_BASIS:
        # A faint lattice may confirm the camera; it is too uncertain to refute it.
        misfit = _Misfit.between(small, own.lattice)
        if misfit is not None and misfit.is_small:
            return own.lattice, misfit
    return other, None


def _find_at_basis(picture: Singles, given: Lattice) -> Candidate | None:
    """The most probable lattice of a picture whose basis is near that of the given lattice."""
    from ..detection.search import measure_basis

    with suppress(CalibrationError, np.linalg.LinAlgError):
        return next(iter(measure_basis(picture, given)), None)
    return None


def _fit_offsets(
    calibration: Calibration,
    reduced: _Reduced,
    found: Lattice | None,
    misfit: _Misfit | None,
    most: int,
) -> FitCheck:
    """Offsets of nine places, from a fit of `most` lenses that starts at the nearer of camera and
    found lattice.
    """
    from ..gain.rows import RegionGain

    lattice = calibration.lattice
    factor = reduced.factor
    gain = calibration.gain_map
    positions = nine_places(lattice.image_size)
    offset = np.full((3, 3, 2), np.nan)
    if found is not None and misfit is not None:
        small = lattice.downscaled(factor)
        start = small if misfit.is_small else found
        offset = _measure(reduced.picture, small, start, positions / factor, most) * factor
        if gain is not None and len(gain.cut) and misfit.is_small:
            # Mechanical vignetting moves rims, which the gain map shows too.
            light = np.nan_to_num(RegionGain(gain, lattice).at(0, 0, *lattice.image_size))
            rims = _measure(_reduce(light, factor), small, small, positions / factor, most)
            offset -= np.nan_to_num(rims) * factor
    return FitCheck(positions, offset, lattice.pitch)


def _measure(
    picture: Singles, given: Lattice, start: Lattice, positions: Floats, most: int
) -> Floats:
    """(3, 3, 2) offsets [px] of the lattice of a picture from a given one; NaN if unreliable."""
    from ..images.preprocessing import edge_strength, normalise_locally
    from ..scene_fit.fit import fit_scene

    rims = normalise_locally(edge_strength(picture), 0.5 * given.pitch)
    try:
        fit = fit_scene(rims, start, most)
    except (CalibrationError, np.linalg.LinAlgError):
        return np.full((3, 3, 2), np.nan)
    if not fit.half_difference < _HALVES * given.pitch:
        return np.full((3, 3, 2), np.nan)
    found = Lattice(fit.origin, fit.basis, given.image_size, given.radius, fit.distortion)
    index = given.indices()[:: max(1, len(given) // _LENSES)]
    centres = given.points(index)
    # Lenses are counted from the middle one, so that all offsets point to the same side.
    own = found.to_index(centres)
    first = found.to_index(given.points(given.middle[None]))
    away = found.points(np.rint(first) + np.rint(own - first)) - centres
    # A linear map is fitted: a single flat does not separate distortion from scene content.
    middle = (np.array(given.image_size) - 1) / 2
    design = np.column_stack([np.ones(len(centres)), centres - middle])
    change = np.linalg.lstsq(design, away, rcond=None)[0]
    return change[0] + (positions - middle) @ change[1:]
