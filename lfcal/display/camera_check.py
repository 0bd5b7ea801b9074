"""Whether a camera belongs to a flat: its lattice against the one that the pixels show, and its lens types."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice
from ..lattice.orientation import describe_orientation
from ..runtime.errors import CameraFileError

if TYPE_CHECKING:
    from .fit_check import LatticeMisfit

__all__ = ["CameraCheck", "check_camera"]

_REMEDY = "give the camera of this flat, or calibrate on it"
_UNSEEN = "no microimages can be seen on this flat, so that the camera could not be checked; give a brighter one"


@dataclass(frozen=True)
class CameraCheck:
    """What a flat says about a camera.

    Parameters
    ----------
    fits : bool
        False where the flat shows another lattice altogether, so that nothing computed with the camera has a meaning.
    problem : str or None
        What is wrong and what to do, None where nothing is.
    adjusted : Calibration or None
        The camera moved onto the microimages, where a shift is all that is wrong with its lattice: crops of a sensor.
    checked : bool
        False where no microimages can be seen on the flat, so that it says nothing about the camera.

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
        """The camera, with what is doubtful about it as a warning; CameraFileError with its name if it is refuted."""
        if not self.fits:
            raise CameraFileError(f"{name}: {self.problem}")
        warning = self.problem if self.checked else _UNSEEN
        return calibration if warning is None else replace(calibration, warnings=(*calibration.warnings, warning))


def check_camera(calibration: Calibration, image: ArrayLike) -> CameraCheck:
    """Check whether a flat can have been made with a camera, in about a tenth of a second.

    Noticed are flats or cameras that are turned or mirrored, shifts of more than a tenth of the pitch, pitches that are
    wrong by more than a quarter of a percent, another array, and lens types in another order. A flat that shows no
    lattice, such as a dark one, says nothing (`CameraCheck.checked`).

    Parameters
    ----------
    calibration : Calibration
    image : (h, w) or (h, w, 3) array_like
        A white image or any scene capture.

    Raises
    ------
    FlatError
        If the image is not of the size the camera is for.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_camera
    >>> y, x = np.mgrid[:300, :400]
    >>> white = 20 + 200 * np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    >>> check_camera(Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).problem
    >>> check_camera(Calibration(Lattice([4, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).problem[:19]
    'the microimages lie'
    """
    # Compiled code is loaded only once there is a flat.
    from ..images.preprocessing import sqrt_luminance
    from .fit_check import ReducedFlat, compare_lattices, fit_offsets, prepare_flat

    reduced = prepare_flat(calibration, image)
    flat, lattice = reduced.flat, calibration.lattice
    found, misfit = compare_lattices(reduced, lattice)
    if found is None and reduced.factor > 1:
        # Microimages that are much smaller than those of the camera may be lost at that size.
        reduced = ReducedFlat(flat, 1, sqrt_luminance(flat))
        found, misfit = compare_lattices(reduced, lattice)
    if found is None:
        return CameraCheck(checked=False)
    if misfit is None:
        return CameraCheck(False, _describe_other(lattice, found, reduced.factor))
    if misfit.is_small:
        return CameraCheck(problem=_check_types(calibration, flat) or fit_offsets(calibration, reduced).warning)
    if not misfit.is_straight:
        return CameraCheck(problem=_describe_linear(misfit))
    shift = reduced.factor * misfit.shift
    return CameraCheck(
        problem=f"the microimages lie {np.linalg.norm(shift):.1f} px beside those of the camera, as in a crop, a "
        f"turned flat, or with another camera; {_REMEDY}",
        adjusted=replace(calibration, lattice=replace(lattice, origin=lattice.origin + shift)),
    )


def _check_types(calibration: Calibration, flat: NDArray[Any]) -> str | None:
    types = calibration.lens_types
    if types is None or not types.ordered:
        return None
    from ..images.preprocessing import sqrt_luminance
    from ..lens_types.type_check import find_rim_conflict, find_type_conflict

    gain, lattice = calibration.gain_map, calibration.lattice
    conflict, rims_known = None, False
    if gain is not None and gain.type_light.size:
        conflict = find_rim_conflict(types, gain, lattice.radius)
        # A difference of light between types at the rims that tells their order.
        rims_known = float(np.ptp(gain.type_rims(lattice.radius), axis=0).max()) > 0.03
    conflict = conflict or find_type_conflict(sqrt_luminance(flat), lattice, types, rims_known)
    return conflict and f"{conflict}; was the flat mirrored, turned or cropped? {_REMEDY}"


def _describe_linear(misfit: LatticeMisfit) -> str:
    step = np.eye(2) + misfit.linear
    scale = 100 * (float(np.sqrt(abs(np.linalg.det(step)))) - 1)
    turn = float(np.degrees(np.arctan2(step[0, 1] - step[1, 0], step[0, 0] + step[1, 1])))
    return f"the pitch on the flat is {scale:+.2f} % and its rotation {turn:+.2f} degrees from the camera; {_REMEDY}"


def _describe_other(given: Lattice, found: Lattice, factor: int) -> str:
    (shape, rows, _), (own_shape, own_rows, _) = describe_orientation(found), describe_orientation(given)
    return (
        f"the flat was not made with this camera: its microimages are {shape}, rows {rows}, pitch "
        f"{factor * found.pitch:.2f} px, those of the camera {own_shape}, rows {own_rows}, pitch {given.pitch:.2f} px, "
        f"unless the flat was turned or mirrored; {_REMEDY}"
    )
