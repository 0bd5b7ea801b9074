"""Check whether a flat can have been made with a camera.

A camera whose gain map matches the average cells of all parts of the flat is confirmed at once
(`confirmation`). Else it is compared with the lattice that the flat shows (`flat_lattice`).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice, describe_orientation
from ..runtime.arrays import Array
from ..runtime.errors import CameraFileError
from .fit_check import MOST_STRETCH, fit_offsets
from .flat_lattice import ReducedFlat, compare_lattices, prepare_flat, reduce_flat

__all__ = ["CameraCheck", "check_camera", "choose_orientation"]

_REMEDY = "give the camera of this flat, or calibrate on it"
# Least difference of the light of lens types at the rims that determines their order.
_RIM_LIGHT = 0.03
# Lenses that are fitted to check a camera: 8,000 give the same verdicts on eight captures. Their
# offsets differ by less than 0.004 pitch, or 0.02 where the camera is wrong.
_CHECKED_LENSES = 1400


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
    >>> CameraCheck().fits, CameraCheck(problem="the microimages lie 5.9 px beside").problem
    (True, 'the microimages lie 5.9 px beside')
    """

    fits: bool = True
    problem: str | None = None
    adjusted: Calibration | None = None
    checked: bool = True

    def warn(self, calibration: Calibration, name: object) -> Calibration:
        """The camera with its problem as a warning; CameraFileError with `name` if it is wrong."""
        if not self.fits:
            raise CameraFileError(f"{name}: {self.problem}")
        warning = self.problem
        if not self.checked:
            warning = (
                "no microimages can be seen on this flat, so that the camera could not be checked; "
                "give a flat that is neither dark nor saturated"
            )
        if warning is None:
            return calibration
        return replace(calibration, warnings=(*calibration.warnings, warning))


# The equations are too small for more threads to pay off.
@threadpool_limits.wrap(limits=1, user_api="blas")
def check_camera(flat: ArrayLike, calibration: Calibration) -> CameraCheck:
    """Check whether a flat can have been made with a camera, in about a tenth of a second.

    The check finds turned or mirrored flats, shifts of more than a tenth of the pitch, pitches that
    are wrong by more than 0.25 %, another array, and lens types in another order. A flat without a
    visible lattice, such as a dark one, cannot be checked (`CameraCheck.checked`).

    `flat` (h, w) or (h, w, 3) is a white image or any scene capture. FlatError if it has another
    size than those of the camera. The earlier order, with the camera first, is deprecated.

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
    from .confirmation import confirms_camera

    if isinstance(flat, Calibration):
        warnings.warn("call check_camera(flat, calibration)", DeprecationWarning, stacklevel=3)
        flat, calibration = calibration, flat  # type: ignore[assignment]
    reduced = prepare_flat(calibration, flat)
    lattice = calibration.lattice
    if confirms_camera(calibration, lattice.downscaled(reduced.factor), reduced.picture):
        return CameraCheck(problem=_find_type_conflict(calibration, reduced.flat))
    found, misfit = compare_lattices(reduced, lattice)
    if found is None and reduced.factor > 1:
        # Microimages that are much smaller than those of the camera vanish by downscaling.
        reduced = ReducedFlat(reduced.flat, 1, reduce_flat(reduced.flat, 1))
        found, misfit = compare_lattices(reduced, lattice)
    if found is None:
        return CameraCheck(checked=False)
    if misfit is None:
        return CameraCheck(False, _describe_other(lattice, found, reduced.factor))
    if misfit.is_small:
        conflict = _find_type_conflict(calibration, reduced.flat)
        offsets = fit_offsets(calibration, reduced, found, misfit, _CHECKED_LENSES)
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
