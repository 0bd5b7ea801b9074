"""How far the microimages of a flat lie from the lattice of a camera, at nine places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..runtime.arrays import Floats, Frozen
from ..runtime.page import html_table
from .camera_check import find_problem
from .compare import REGIONS, nine_places
from .flat_lattice import measure_camera
from .misfit import MOST_STRETCH

__all__ = ["FitCheck", "check_fit"]


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
    warning : str or None
        The error of the lattice if it is visible in pictures, as `check_camera` states it.
    own : bool
        The camera was calibrated on this flat, and is sure.

    Examples
    --------
    >>> FitCheck(np.zeros((3, 3, 2)), np.zeros((3, 3, 2)), 20.0).max_offset
    0.0
    """

    positions: Floats
    offset: Floats
    pitch: float
    warning: str | None = None
    own: bool = False

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
        if self.own:
            return (
                "the camera was calibrated on this flat; a fit to a part of its microimages is "
                f"within {self.max_offset:.2f} px of it"
            )
        return self.warning or (
            f"within {self.max_offset:.2f} px of this flat; no reason to worry: what the scene "
            f"shows in microimages moves such figures by up to {self.limit:.1f} px"
        )

    def _repr_html_(self) -> str:
        offsets = self.offset.reshape(-1, 2).tolist()
        figures = {
            place: f"{x:+.2f}, {y:+.2f} px" for place, (x, y) in zip(REGIONS, offsets, strict=True)
        }
        return html_table("Offsets of the microimages (x, y)", figures, [self.verdict])


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
    seen = measure_camera(calibration, image)
    lattice = calibration.lattice
    positions = nine_places(lattice.image_size)
    offset = np.full((3, 3, 2), np.nan)
    if seen.misfit is not None and (seen.measured or not seen.misfit.is_small):
        offset = seen.misfit.at(positions)
    own = calibration.is_own(np.asarray(image))
    warning = None if own else find_problem(lattice, seen)
    return FitCheck(positions, offset, lattice.pitch, warning, own)
