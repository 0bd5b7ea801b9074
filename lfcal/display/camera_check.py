"""Whether a camera belongs to a flat: its lattice against the one that the pixels show, and its lens types.

The lattice that repeats on the flat is fitted anew, from the basis of the camera and nothing of its centres; where none
repeats at that basis, it is searched without the camera. Both lattices are compared by a shift and a linear map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..lattice.orientation import describe_orientation
from ..runtime.errors import CameraFileError
from .settings import CAMERA_CHECK, CameraCheckSettings

if TYPE_CHECKING:
    from ..gain.gain_map import GainMap
    from .lattice_misfit import LatticeMisfit

__all__ = ["CameraCheck", "check_camera"]

_REMEDY = "give the camera of this flat, or calibrate on it"
_UNSEEN = "no microimages can be seen on this flat, so that the camera could not be checked; give a brighter one"
_TURNS = {
    "turned by 90 degrees": [[0, 1], [-1, 0]],
    "turned by 180 degrees": [[-1, 0], [0, -1]],
    "mirrored left to right": [[-1, 0], [0, 1]],
    "mirrored top to bottom": [[1, 0], [0, -1]],
    "transposed": [[0, 1], [1, 0]],
}


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


def check_camera(
    calibration: Calibration, image: ArrayLike, settings: CameraCheckSettings = CAMERA_CHECK
) -> CameraCheck:
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
    >>> check_camera(Calibration(Lattice([4, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).problem[:26]
    'the microimages lie 5.9 px'
    """
    # Compiled code is loaded only once there is a flat.
    from ..images.preprocessing import sqrt_luminance
    from .fit_check import fit_offsets
    from .lattice_misfit import compare_lattices, is_other_centre, prepare_flat, straighten

    flat, factor, picture = prepare_flat(calibration, image, settings)
    given = straighten(calibration.lattice)
    small = given.downscaled(factor)
    found, misfit = compare_lattices(picture, small, settings)
    if found is None and factor > 1:
        # Microimages that are much smaller than those of the camera may be lost at that size.
        factor, picture, small = 1, sqrt_luminance(flat), given
        found, misfit = compare_lattices(picture, small, settings)
    if found is None:
        return CameraCheck(checked=False)
    if misfit is None:
        return CameraCheck(False, _describe_other(small, found, factor))
    if misfit.is_small(settings) or is_other_centre(picture, found, misfit, settings):
        problem = _check_types(calibration, flat, settings)
        return CameraCheck(problem=problem or fit_offsets(calibration, picture, factor).warning)
    shift = factor * misfit.shift
    if misfit.linear_size < settings.linear:
        moved = replace(calibration.lattice, origin=calibration.lattice.origin + shift)
        return CameraCheck(problem=_describe_shift(small, found, shift), adjusted=replace(calibration, lattice=moved))
    return CameraCheck(problem=_describe_linear(misfit))


def _check_types(calibration: Calibration, flat: NDArray[Any], settings: CameraCheckSettings) -> str | None:
    types = calibration.lens_types
    if types is None or not types.ordered:
        return None
    from ..images.preprocessing import sqrt_luminance
    from ..lens_types.type_check import find_rim_conflict, find_type_conflict

    picture, gain, lattice = sqrt_luminance(flat), calibration.gain_map, calibration.lattice
    conflict, rims_known = None, False
    if gain is not None and gain.type_light.size:
        conflict = find_rim_conflict(types, gain, lattice.radius)
        rims_known = float(np.ptp(gain.type_rims(lattice.radius), axis=0).max()) > settings.known_rims
        if conflict is None and rims_known and _rims_differ(picture, lattice, gain, settings):
            conflict = "the rims of microimages of each lens type are not those of the camera"
    conflict = conflict or find_type_conflict(picture, lattice, types, rims_known)
    return conflict and f"{conflict}; was the flat mirrored, turned or cropped? {_REMEDY}"


def _rims_differ(picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, settings: CameraCheckSettings) -> bool:
    """Whether a scene clearly shows other light at the rims of each lens type than the gain map."""
    from ..illumination.type_profiles import fit_type_profiles

    types = LensTypes(gain.type_cell)
    plain = replace(gain, type_light=np.zeros((0, 0)), type_cell=np.zeros((0, 0), np.int8))
    found = fit_type_profiles(picture, lattice, plain, types, True)
    if not found.type_light.size:
        return False
    own, other = gain.type_rims(lattice.radius), found.type_rims(lattice.radius)
    at = np.ptp(own, axis=0).argmax()
    one, two = own[:, at] - own[:, at].mean(), other[:, at] - other[:, at].mean()
    size = float(np.linalg.norm(one) * np.linalg.norm(two))
    clear = float(np.linalg.norm(two)) > settings.clear_rims * float(np.linalg.norm(one))
    return clear and float(one @ two) < settings.same_rims * size


def _describe_shift(given: Lattice, found: Lattice, shift: NDArray[np.float64]) -> str:
    distance = float(np.linalg.norm(shift))
    turn = _find_turn(given, found)
    cause = f"as if the flat were {turn}" if turn else "as in a crop, or with another camera"
    return f"the microimages lie {distance:.1f} px beside those of the camera, {cause}; {_REMEDY}"


def _describe_linear(misfit: LatticeMisfit) -> str:
    step = np.eye(2) + misfit.linear
    scale = 100 * (float(np.sqrt(abs(np.linalg.det(step)))) - 1)
    turn = float(np.degrees(np.arctan2(step[0, 1] - step[1, 0], step[0, 0] + step[1, 1])))
    return f"the pitch on the flat is {scale:+.2f} % and its rotation {turn:+.2f} degrees from the camera; {_REMEDY}"


def _describe_other(given: Lattice, found: Lattice, factor: int) -> str:
    (shape, rows, _), (own_shape, own_rows, _) = describe_orientation(found), describe_orientation(given)
    turn = _find_turn(given, found)
    cause = f", as if the flat were {turn}" if turn else ""
    return (
        f"the flat was not made with this camera: its microimages are {shape}, rows {rows}, pitch "
        f"{factor * found.pitch:.2f} px, those of the camera {own_shape}, rows {own_rows}, pitch "
        f"{factor * given.pitch:.2f} px{cause}; {_REMEDY}"
    )


def _find_turn(given: Lattice, found: Lattice) -> str | None:
    """How the flat seems to be turned or mirrored, None where that explains nothing."""
    from .lattice_misfit import LatticeMisfit

    middle = (np.array(given.image_size) - 1) / 2
    for name, matrix in _TURNS.items():
        turned = Lattice(
            middle + (given.origin - middle) @ matrix, given.basis @ matrix, given.image_size, given.radius
        )
        misfit = LatticeMisfit.between(turned, found, CAMERA_CHECK)
        if misfit is not None and misfit.is_small(CAMERA_CHECK):
            return name
    return None
