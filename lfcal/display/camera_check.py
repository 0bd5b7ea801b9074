"""Check whether a flat can have been made with a camera: the words for what is measured of both
(`flat_lattice.measure_camera`).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, describe_orientation
from ..runtime.arrays import Array
from ..runtime.errors import CAMERA_ADVICE, CameraError, check_type
from .compare import REGIONS, nine_places, scale_and_rotation
from .flat_lattice import SeenLattice, measure_camera
from .misfit import MOST_SHIFT, MOST_STRETCH

__all__ = ["CameraCheck", "check_camera", "choose_orientation", "find_problem"]

# Offset [pitch] from which on pixels are taken for those of another microimage.
_ANOTHER_LENS = 0.5
_REMEDY = "give the camera of this flat, or calibrate on it"
_UNCHECKED = (
    "no microimages can be seen on this flat, so that the camera could not be checked; give a flat "
    "that is neither dark nor saturated"
)
# Least difference of the light of lens types at the rims that determines their order.
_RIM_LIGHT = 0.03


@dataclass(frozen=True)
class CameraCheck:
    """Result of checking a camera on a flat.

    Parameters
    ----------
    problem : str or None
        The fault of the camera and a remedy, None if there is no fault.
    adjusted : Calibration or None
        The camera shifted onto the microimages if a shift is the only fault, as of a cropped flat.
    usable : bool
        False if the flat has another lattice or orientation, so that results of this camera would
        be meaningless.
    checked : bool
        False if no microimages are visible on the flat.

    Examples
    --------
    >>> from lfcal import CameraCheck
    >>> CameraCheck().fits, CameraCheck(problem="the microimages lie 5.9 px beside").fits
    (True, False)
    """

    problem: str | None = None
    adjusted: Calibration | None = None
    usable: bool = True
    checked: bool = True

    @property
    def fits(self) -> bool:
        """Whether no fault of the camera was found."""
        return self.problem is None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The problem, or that the flat could not be checked."""
        if self.problem is not None:
            return (self.problem,)
        return () if self.checked else (_UNCHECKED,)

    def apply(self, calibration: Calibration, name: object) -> Calibration:
        """The camera to use for the flat: shifted where a shift is its only fault, with a warning.

        CameraError with `name` if it is of another lattice or orientation.
        """
        if not self.usable:
            raise CameraError(f"{name}: {self.problem}")
        warnings = self.warnings
        if self.adjusted is not None:
            warnings = (f"{self.problem}; its lattice was moved onto the microimages",)
            calibration = replace(calibration, lattice=self.adjusted.lattice)
        return replace(calibration, warnings=(*calibration.warnings, *warnings))


def check_camera(flat: ArrayLike, calibration: Calibration, lens_types: bool = True) -> CameraCheck:
    """Check whether a flat can have been made with a camera, in a tenth to about one second.

    A flat that the camera was calibrated on for sure needs no check.

    The check finds turned or mirrored flats, shifts of more than a tenth of the pitch, pitches that
    are wrong by more than 0.25 %, another array, and lens types in another order. A flat without a
    visible lattice, such as a dark one, cannot be checked (`CameraCheck.checked`).

    `flat` (h, w) or (h, w, 3) is a white image or any scene capture; FlatError if it has another
    size. Without `lens_types`, their order is not checked, which takes as long as all the rest. The
    earlier order, with the camera first, is deprecated.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_camera
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> camera = Calibration(Lattice([4, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> check_camera(white, camera).problem[:19]
    'the microimages lie'
    """
    if isinstance(flat, Calibration):
        warnings.warn("call check_camera(flat, calibration)", DeprecationWarning, stacklevel=2)
        flat, calibration = calibration, flat  # type: ignore[assignment]
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    if calibration.is_own(np.asarray(flat)):
        return CameraCheck()
    seen = measure_camera(calibration, flat)
    if seen.lattice is None:
        return CameraCheck(checked=False)
    lattice = calibration.lattice
    problem = find_problem(lattice, seen)
    misfit = seen.misfit
    if misfit is None:
        return CameraCheck(problem, usable=False)
    stretched = misfit.distance <= MOST_SHIFT and misfit.is_stretched
    if stretched or not misfit.is_straight:
        return CameraCheck(problem, usable=misfit.distance + misfit.stretch < _ANOTHER_LENS)
    conflict = None
    if problem is None:
        if lens_types:
            conflict = _find_type_conflict(calibration, seen.flat)
        return CameraCheck(conflict)
    moved = replace(lattice, origin=lattice.origin + misfit.shift)
    adjusted = replace(calibration, lattice=moved)
    if lens_types:
        conflict = _find_type_conflict(adjusted, seen.flat)
    if conflict is not None:
        return CameraCheck(f"{problem}; and {conflict}", usable=False)
    return CameraCheck(problem, adjusted)


def find_problem(lattice: Lattice, seen: SeenLattice) -> str | None:
    """The fault of the lattice of a camera, and a remedy, by what the flat shows of it."""
    misfit = seen.misfit
    if seen.lattice is None:
        return None
    if misfit is None:
        return _describe_other(lattice, seen.lattice)
    if not misfit.is_straight:
        scale, turn = scale_and_rotation(np.eye(2) + misfit.linear)
        return (
            f"the pitch on the flat is {100 * (scale - 1):+.2f} % and its rotation {turn:+.2f} degrees "
            f"from the camera; {_REMEDY}"
        )
    if misfit.distance > MOST_SHIFT:
        return (
            f"the microimages lie {np.linalg.norm(misfit.shift):.1f} px beside those of the camera, "
            f"as in a crop, a turned flat, or with another camera; {_REMEDY}"
        )
    if misfit.is_stretched:
        offsets = np.linalg.norm(misfit.at(nine_places(lattice.image_size)), axis=-1)
        where = REGIONS[int(offsets.argmax())]
        return (
            f"the lattice is off by up to {offsets.max():.1f} px in the {where}, which pictures "
            "show: calibrate on this flat"
        )
    return None


def choose_orientation(down: Calibration, up: Calibration, image: ArrayLike) -> Calibration:
    """The reading of a table of centres, with y pointing down or up, that an image confirms."""
    right = [
        check.checked and check.problem is None
        for check in (check_camera(image, one) for one in (down, up))
    ]
    index = up.lattice.to_index(down.lattice.centres())
    if right[0] != right[1] or np.abs(index - np.rint(index)).max() < MOST_STRETCH:
        if right[1] and not right[0]:
            return up
        return down
    warning = (
        "the image does not show whether y of the table points up or down; it was taken to point "
        "down"
    )
    return replace(down, warnings=(*down.warnings, warning))


def _describe_other(given: Lattice, found: Lattice) -> str:
    """A message about a flat that shows another lattice."""
    shape, rows, _ = describe_orientation(found)
    own_shape, own_rows, _ = describe_orientation(given)
    return (
        f"the flat was not made with this camera: its microimages are {shape}, rows {rows}, pitch "
        f"{found.pitch:.2f} px, those of the camera {own_shape}, rows {own_rows}, pitch "
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
    # Rims of a scene show its content, too.
    if gain is not None and gain.type_light.size and calibration.source == "white":
        conflict = find_rim_conflict(types, gain, lattice.radius)
        rims_known = float(np.ptp(gain.type_rims(lattice.radius), axis=0).max()) > _RIM_LIGHT
    conflict = conflict or find_type_conflict(sqrt_luminance(flat), lattice, types, rims_known)
    return conflict and f"{conflict}; was the flat mirrored, turned or cropped? {_REMEDY}"
