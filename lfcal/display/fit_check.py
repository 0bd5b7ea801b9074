"""Whether a camera fits a flat: how far the microimages lie from its lattice, and whether it is the
right camera.

The lattice that repeats on the flat is fitted anew, from the basis of the camera and nothing of its
centres; where none repeats at that basis, it is searched without the camera. Where it is that of
the camera, it is fitted to the edges between the microimages (`scene_fit`). Flats are reduced to
microimages of some ten pixels.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, describe_orientation
from ..runtime.arrays import Array, Floats, Frozen, Singles
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, CameraFileError, FlatError, check_type
from .compare import REGIONS

if TYPE_CHECKING:
    from ..detection.search import Candidate

__all__ = ["CameraCheck", "FitCheck", "check_camera", "check_fit", "choose_orientation"]

_REMEDY = "give the camera of this flat, or calibrate on it"
# [pitch] from which on pictures show a shift of the whole flat, at most 0.05 with right cameras on
# 60 simulated flats; and one of a corner by a change of scale or rotation: 0.028 with right cameras
# on 11 captures, 0.039 with a wrong one.
_SHIFT = 0.06
_STRETCH = 0.033
# Least probability of a lattice that a camera is compared with.
_LIKELY = 0.5
# Least probability of a lattice, found at the basis of the camera, that may confirm the camera.
_LIKELY_AT_BASIS = 0.05


@dataclass(frozen=True, eq=False)
class FitCheck(Frozen):
    """Centres measured on a flat, against those of a given lattice.

    Parameters
    ----------
    positions : (3, 3, 2) float64 [px]
        Corners, edge middles and middle of the flat, in rows from the top.
    offset : (3, 3, 2) float64 [px]
        From the given centres to the measured ones there: a shift and a linear map. NaN where the
        flat shows none.
    pitch : float [px]
        Of the given lattice.

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
        """Longest offset [px], NaN where it is unknown."""
        return float(np.linalg.norm(self.offset, axis=-1).max())

    @property
    def limit(self) -> float:
        """Offset [px] of a corner up to which not to worry; what a scene shows moves microimages as
        much.
        """
        return _STRETCH * self.pitch

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
        if not (stretch > self.limit or np.linalg.norm(shift) > _SHIFT * self.pitch):
            return None
        where = REGIONS[int(np.linalg.norm(self.offset, axis=-1).argmax())]
        return (
            f"the lattice is off by up to {self.max_offset:.1f} px in the {where}, which pictures show: calibrate on "
            "this flat"
        )


@dataclass(frozen=True)
class CameraCheck:
    """What a flat shows of a camera.

    Parameters
    ----------
    fits : bool
        False where the flat shows another lattice altogether, so that nothing computed with the
        camera has a meaning.
    problem : str or None
        What is wrong and what to do, None where nothing is.
    adjusted : Calibration or None
        The camera moved onto the microimages, where a shift is all that is wrong with its lattice:
        crops of a sensor.
    checked : bool
        False where no microimages can be seen on the flat.

    Examples
    --------
    >>> from lfcal import CameraCheck
    >>> CameraCheck().fits, CameraCheck(problem="the microimages lie 5.9 px beside those of the camera").problem[:16]
    (True, 'the microimages ')
    """

    fits: bool = True
    problem: str | None = None
    adjusted: Calibration | None = None
    checked: bool = True

    def warn(self, calibration: Calibration, name: object) -> Calibration:
        """The camera, with what is doubtful about it as a warning; CameraFileError with its name if
        it is refuted.
        """
        if not self.fits:
            raise CameraFileError(f"{name}: {self.problem}")
        unseen = "no microimages can be seen on this flat, so that the camera could not be checked; give a brighter one"
        warning = self.problem if self.checked else unseen
        return (
            calibration
            if warning is None
            else replace(calibration, warnings=(*calibration.warnings, warning))
        )


def check_fit(calibration: Calibration, image: ArrayLike) -> FitCheck:
    """Measure on a flat how far the microimages are from the centres of `calibration`.

    `image` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it is of another
    size.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_fit
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> round(check_fit(Calibration(Lattice([11, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).max_offset)
    1
    """
    reduced = _prepare(calibration, image)
    found, misfit = _compare(reduced, calibration.lattice)
    return _fit_offsets(calibration, reduced, found, misfit)


def check_camera(calibration: Calibration, image: ArrayLike) -> CameraCheck:
    """Check whether a flat can have been made with a camera, in about a tenth of a second.

    Noticed are flats or cameras that are turned or mirrored, shifts of more than a tenth of the
    pitch, pitches that are wrong by more than a quarter of a percent, another array, and lens types
    in another order. A flat that shows no lattice, such as a dark one, shows nothing of the camera
    (`CameraCheck.checked`).

    `image` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it is of another
    size.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_camera
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> check_camera(Calibration(Lattice([4, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).problem[:19]
    'the microimages lie'
    """
    from threadpoolctl import threadpool_limits

    # The equations are too small for more threads to pay off.
    with threadpool_limits(1, "blas"):
        return _check(calibration, _prepare(calibration, image))


def _check(calibration: Calibration, reduced: _Reduced) -> CameraCheck:
    lattice = calibration.lattice
    found, misfit = _compare(reduced, lattice)
    if found is None and reduced.factor > 1:
        # Microimages that are much smaller than those of the camera may be lost at that size.
        reduced = _Reduced(reduced.flat, 1, _reduce(reduced.flat, 1))
        found, misfit = _compare(reduced, lattice)
    if found is None:
        return CameraCheck(checked=False)
    if misfit is None:
        return CameraCheck(False, _describe_other(lattice, found, reduced.factor))
    if misfit.is_small:
        conflict = _find_type_conflict(calibration, reduced.flat)
        return CameraCheck(
            problem=conflict or _fit_offsets(calibration, reduced, found, misfit).warning
        )
    if not misfit.is_straight:
        step = np.eye(2) + misfit.linear
        scale = 100 * (float(np.sqrt(abs(np.linalg.det(step)))) - 1)
        turn = float(np.degrees(np.arctan2(step[0, 1] - step[1, 0], np.trace(step))))
        return CameraCheck(
            problem=f"the pitch on the flat is {scale:+.2f} % and its rotation {turn:+.2f} degrees from the camera; "
            + _REMEDY
        )
    shift = reduced.factor * misfit.shift
    return CameraCheck(
        problem=f"the microimages lie {np.linalg.norm(shift):.1f} px beside those of the camera, as in a crop, a "
        f"turned flat, or with another camera; {_REMEDY}",
        adjusted=replace(calibration, lattice=replace(lattice, origin=lattice.origin + shift)),
    )


def choose_orientation(down: Calibration, up: Calibration, image: ArrayLike) -> Calibration:
    """Of two readings of a table of centres, whose y points down or up, the one that an image
    confirms.
    """
    right = [
        check.checked and check.problem is None
        for check in (check_camera(one, image) for one in (down, up))
    ]
    index = up.lattice.to_index(down.lattice.centres())
    if right[0] != right[1] or np.abs(index - np.rint(index)).max() < _STRETCH:
        return up if right[1] and not right[0] else down
    warning = "the image does not show whether y of the table points up or down; it was taken to point down"
    return replace(down, warnings=(*down.warnings, warning))


def _describe_other(given: Lattice, found: Lattice, factor: int) -> str:
    (shape, rows, _), (own_shape, own_rows, _) = (
        describe_orientation(found),
        describe_orientation(given),
    )
    return (
        f"the flat was not made with this camera: its microimages are {shape}, rows {rows}, pitch "
        f"{factor * found.pitch:.2f} px, those of the camera {own_shape}, rows {own_rows}, pitch {given.pitch:.2f} px, "
        f"unless the flat was turned or mirrored; {_REMEDY}"
    )


def _find_type_conflict(calibration: Calibration, flat: Array) -> str | None:
    """Why the lens types of a camera are not those of a flat: by the light at their rims, and by
    their sharpness.
    """
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
        # A difference of light between types at the rims that tells their order.
        rims_known = float(np.ptp(gain.type_rims(lattice.radius), axis=0).max()) > 0.03
    conflict = conflict or find_type_conflict(sqrt_luminance(flat), lattice, types, rims_known)
    return conflict and f"{conflict}; was the flat mirrored, turned or cropped? {_REMEDY}"


class _Reduced(NamedTuple):
    flat: Array  # without its mosaic
    factor: int  # side of the blocks that it is reduced by
    picture: Singles  # root of its luminance then


def _prepare(calibration: Calibration, image: ArrayLike) -> _Reduced:
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
    # Finer microimages than of 18 px take time and tell no more; large flats are reduced to 4 MP,
    # or to 10 px.
    pitch = calibration.lattice.pitch
    large = int(np.ceil(np.sqrt(width * height / 4e6)))
    factor = max(1, int(pitch / 18), min(int(pitch / 10), large))
    return _Reduced(flat, factor, _reduce(flat, factor))


def _reduce(flat: Array, factor: int) -> Singles:
    """Root of the luminance (h, w) of a flat, of blocks of `factor` x `factor` pixels."""
    from ..images.preprocessing import sqrt_luminance

    if factor > 1:
        import cv2

        height, width = (length // factor for length in flat.shape[:2])
        flat = flat[: factor * height, : factor * width]
        flat = flat if flat.dtype in (np.uint8, np.uint16, np.float32) else flat.astype(np.float32)
        flat = np.asarray(cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA))
    return sqrt_luminance(flat)


class _Misfit(NamedTuple):
    """A found lattice against the given one: at `p`, centres are `shift + (p - middle) @ linear`
    [px] further.
    """

    shift: Floats  # (2,) [px] in the middle of the flat, to the nearest
    linear: Floats  # (2, 2)
    given: Lattice

    @classmethod
    def between(cls, given: Lattice, found: Lattice) -> _Misfit | None:
        """None where the cells are not the same, to a tenth in scale or angle."""
        whole = np.rint(found.basis @ np.linalg.inv(given.basis))
        if round(abs(np.linalg.det(whole))) != 1:
            return None
        linear = np.linalg.inv(given.basis) @ np.linalg.solve(whole, found.basis) - np.eye(2)
        if np.linalg.norm(linear, 2) > 0.1:
            return None
        middle = (np.array(given.image_size) - 1) / 2
        index = found.to_index(given.points(np.rint(given.to_index(middle[None]))))[0]
        shifts = (
            np.rint(index) + [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)] - index
        ) @ found.basis
        return cls(shifts[np.linalg.norm(shifts, axis=1).argmin()], linear, given)

    @property
    def is_straight(self) -> bool:
        """Whether scale and angle are the same: right cameras differ by at most 0.0011 on 60
        simulated flats.
        """
        return float(np.linalg.norm(self.linear, 2)) < 0.0025

    @property
    def is_small(self) -> bool:
        """Whether the camera fits, for all that its flat can tell."""
        half = np.array(self.given.image_size) / 2
        pitch = self.given.pitch
        corners = self.shift + (half * [[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ self.linear
        # In the corners right cameras are at most 0.08 pitches off.
        near = np.linalg.norm(corners, axis=1).max() < 0.2 * pitch
        return bool(self.is_straight and near and np.linalg.norm(self.shift) < _SHIFT * pitch)


def _compare(reduced: _Reduced, given: Lattice) -> tuple[Lattice | None, _Misfit | None]:
    """A lattice on the reduced flat, None where none is found, and its misfit, None where it is
    another one.
    """
    if given.distortion is not None:
        index = given.indices()[:: max(1, len(given) // 4000)]
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
    """The most probable lattice on a picture near the basis of the given one."""
    from ..detection.search import measure_basis

    with suppress(CalibrationError, np.linalg.LinAlgError):
        found = measure_basis(picture, given)
        if found:
            return found[0]
    return None


def _fit_offsets(
    calibration: Calibration, reduced: _Reduced, found: Lattice | None, misfit: _Misfit | None
) -> FitCheck:
    """`check_fit` on a reduced flat, from the found lattice where that of the camera is far off."""
    from ..gain.rows import RegionGain

    lattice = calibration.lattice
    factor = reduced.factor
    gain = calibration.gain_map
    width, height = lattice.image_size
    positions = np.stack(
        np.meshgrid([0, (width - 1) / 2, width - 1], [0, (height - 1) / 2, height - 1]), -1
    )
    offset = np.full((3, 3, 2), np.nan)
    if found is not None and misfit is not None:
        small = lattice.downscaled(factor)
        offset = (
            _measure(
                reduced.picture, small, small if misfit.is_small else found, positions / factor
            )
            * factor
        )
        if gain is not None and len(gain.cut) and misfit.is_small:
            # Mechanical vignetting moves rims: offsets that the gain map shows as well are no
            # misfit.
            light = _reduce(
                np.nan_to_num(RegionGain(gain, lattice).at(0, 0, width, height)), factor
            )
            offset -= np.nan_to_num(_measure(light, small, small, positions / factor)) * factor
    return FitCheck(positions, offset, lattice.pitch)


def _measure(picture: Singles, given: Lattice, start: Lattice, positions: Floats) -> Floats:
    """(3, 3, 2) offsets [px] of the lattice on a picture from the given one; NaN where its halves
    do not agree.
    """
    from ..images.preprocessing import edge_strength, normalise_locally
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
    own = found.to_index(centres)
    first = found.to_index(given.points(given.middle[None]))
    away = found.points(np.rint(first) + np.rint(own - first)) - centres
    # A distortion that single flats show is not told from what the scene shows.
    middle = (np.array(given.image_size) - 1) / 2
    design = np.column_stack([np.ones(len(centres)), centres - middle])
    change = np.linalg.lstsq(design, away, rcond=None)[0]
    return change[0] + (positions - middle) @ change[1:]
