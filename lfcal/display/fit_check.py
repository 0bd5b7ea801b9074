"""Measure how far the microimages of a flat lie from the lattice of a camera.

The lattice that the flat shows (`flat_lattice`) is fitted to the edges between the microimages
(`scene_fit`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice
from ..runtime.arrays import ENOUGH_LENSES, Floats, Frozen, Singles, evenly
from ..runtime.errors import CalibrationError
from ..runtime.page import html_table
from .compare import REGIONS, nine_places
from .flat_lattice import (
    MOST_SHIFT,
    Misfit,
    ReducedFlat,
    compare_lattices,
    prepare_flat,
    reduce_flat,
)

__all__ = ["MOST_STRETCH", "FitCheck", "check_fit", "fit_offsets"]

# Largest shift of a corner by scale or rotation [pitch]: 0.028 with right cameras on 11 captures,
# 0.039 with a wrong one.
MOST_STRETCH = 0.033
# Lenses that are fitted where the offsets are wanted.
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
        return MOST_STRETCH * self.pitch

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
        if not (stretch > self.limit or np.linalg.norm(shift) > MOST_SHIFT * self.pitch):
            return None
        where = REGIONS[int(np.linalg.norm(self.offset, axis=-1).argmax())]
        return (
            f"the lattice is off by up to {self.max_offset:.1f} px in the {where}, which pictures "
            "show: calibrate on this flat"
        )

    def _repr_html_(self) -> str:
        offsets = self.offset.reshape(-1, 2).tolist()
        figures = {
            place: f"{x:+.2f}, {y:+.2f} px" for place, (x, y) in zip(REGIONS, offsets, strict=True)
        }
        return html_table("Offsets of the microimages (x, y)", figures, [self.verdict])


# The equations are too small for more threads to pay off: they double the processor time.
@threadpool_limits.wrap(limits=1, user_api="blas")
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
    reduced = prepare_flat(calibration, image)
    found, misfit = compare_lattices(reduced, calibration.lattice)
    return fit_offsets(calibration, reduced, found, misfit, _MEASURED_LENSES)


def fit_offsets(
    calibration: Calibration,
    reduced: ReducedFlat,
    found: Lattice | None,
    misfit: Misfit | None,
    most: int,
) -> FitCheck:
    """Measure the offsets of the flat from the camera at nine places.

    The fit of `most` lenses starts at the lattice of the camera or at the found one, whichever is
    nearer.
    """
    from ..gain.rows import RegionGain

    lattice = calibration.lattice
    factor = reduced.factor
    gain = calibration.gain_map
    positions = nine_places(lattice.image_size)
    offset = np.full((3, 3, 2), np.nan)
    if found is not None and misfit is not None:
        small = lattice.downscaled(factor)
        start = found
        if misfit.is_small:
            start = small
        offset = _measure(reduced.picture, small, start, positions / factor, most) * factor
        if gain is not None and len(gain.cut) and misfit.is_small:
            # Mechanical vignetting moves rims, which the gain map shows too.
            light = np.nan_to_num(RegionGain(gain, lattice).at(0, 0, *lattice.image_size))
            rims = _measure(reduce_flat(light, factor), small, small, positions / factor, most)
            offset -= np.nan_to_num(rims) * factor
    return FitCheck(positions, offset, lattice.pitch)


def _measure(
    picture: Singles, given: Lattice, start: Lattice, positions: Floats, most: int
) -> Floats:
    """(3, 3, 2) offsets [px] of the lattice of a picture from the given one; NaN if unsure."""
    from ..images.preprocessing import edge_strength, normalise_locally
    from ..scene_fit.fit import fit_scene

    rims = normalise_locally(edge_strength(picture), 0.5 * given.pitch)
    try:
        fit = fit_scene(rims, start, most)
    except (CalibrationError, np.linalg.LinAlgError):
        return np.full((3, 3, 2), np.nan)
    if not fit.half_difference < _HALVES * given.pitch:
        return np.full((3, 3, 2), np.nan)
    found = fit.lattice
    index = given.indices()[evenly(len(given), ENOUGH_LENSES)]
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
