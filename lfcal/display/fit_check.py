"""How far the microimages of a flat lie from the lattice of a camera: a shift and a linear map.

The lattice of the camera is fitted anew to the edges between the microimages (`scene_fit`), on flats reduced to
microimages of some ten pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import RegionGain
from ..images.preprocessing import edge_strength, normalise_locally
from ..lattice.lattice import Lattice
from ..runtime.checks import LIMITS, find_camera_doubt
from ..runtime.errors import CalibrationError
from ..runtime.frozen import Frozen
from .lattice_misfit import compare_lattices, prepare_flat, reduce_flat, straighten
from .settings import CAMERA_CHECK, FIT_CHECK, CameraCheckSettings

__all__ = ["FitCheck", "check_fit", "fit_offsets"]

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
        if self.warning is not None:
            return self.warning
        return (
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


def check_fit(calibration: Calibration, image: ArrayLike, settings: CameraCheckSettings = CAMERA_CHECK) -> FitCheck:
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
    _, factor, picture = prepare_flat(calibration, image, settings)
    found, misfit = compare_lattices(picture, straighten(calibration.lattice).downscaled(factor), settings)
    if found is None or misfit is None:
        return fit_offsets(calibration, None, factor)
    return fit_offsets(calibration, picture, factor, None if misfit.is_small(settings) else found)


def fit_offsets(
    calibration: Calibration, picture: NDArray[np.float32] | None, factor: int, start: Lattice | None = None
) -> FitCheck:
    """`check_fit` on a reduced picture, None if it shows no lattice; from `start`, if that of the camera is far off."""
    lattice = calibration.lattice
    width, height = lattice.image_size
    positions = np.stack(np.meshgrid([0, (width - 1) / 2, width - 1], [0, (height - 1) / 2, height - 1]), -1)
    offset = np.full((3, 3, 2), np.nan)
    small = lattice.downscaled(factor)
    if picture is not None:
        offset = _measure(picture, small, start or small, positions / factor) * factor
        gain = calibration.gain_map
        if gain is not None and len(gain.cut) and start is None:
            # Mechanical vignetting moves rims: offsets that the gain map shows as well are no misfit.
            light = np.nan_to_num(RegionGain(gain, lattice).at(0, 0, width, height))
            offset -= np.nan_to_num(_measure(reduce_flat(light, factor), small, small, positions / factor)) * factor
    return FitCheck(positions, offset, lattice.pitch)


def _measure(
    picture: NDArray[np.float32], given: Lattice, start: Lattice, positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(3, 3, 2) offsets [px] of the lattice on a picture from the given one; NaN where its halves do not agree."""
    from ..scene_fit.fit import fit_scene

    rims = normalise_locally(edge_strength(picture), FIT_CHECK.edge_window * given.pitch)
    try:
        fit = fit_scene(rims, start)
    except (CalibrationError, np.linalg.LinAlgError):
        return np.full((3, 3, 2), np.nan)
    if not fit.half_difference < FIT_CHECK.largest_scatter * given.pitch:
        return np.full((3, 3, 2), np.nan)
    found = Lattice(fit.origin, fit.basis, given.image_size, given.radius, fit.distortion)
    index = given.indices()[:: max(1, len(given) // FIT_CHECK.samples)]
    centres = given.points(index)
    # From the middle one on, so that all are compared with lenses to the same side.
    own, first = found.to_index(centres), found.to_index(given.points(given.middle[None]))
    away = found.points(np.rint(first) + np.rint(own - first)) - centres
    # A distortion that single flats show is not told from what the scene shows.
    middle = (np.array(given.image_size) - 1) / 2
    design = np.column_stack([np.ones(len(centres)), centres - middle])
    change = np.linalg.lstsq(design, away, rcond=None)[0]
    return change[0] + (positions - middle) @ change[1:]
