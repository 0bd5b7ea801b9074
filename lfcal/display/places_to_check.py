"""What a person should look at to trust a calibration: the lens that fits worst, and circles found without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..hough.circle_vote import find_circles
from ..images.preprocessing import sqrt_luminance

__all__ = ["PlaceToCheck", "find_places_to_check"]


@dataclass(frozen=True, eq=False)
class PlaceToCheck:
    """A place on a flat, and what to look at there."""

    position: NDArray[np.float64]  # (2,) [px]
    sentence: str
    circles: NDArray[np.float64]  # (n, 3) x, y and radius [px] of circles found without the lattice; none if (0, 3)


def find_places_to_check(calibration: Calibration, flat: NDArray[Any]) -> list[PlaceToCheck]:
    """Places on a flat (h, w) or (h, w, 3) of the size of the calibration, the most telling one first.

    The circle by Hough vote, and the lens measured alone, that lies farthest from the lattice.
    """
    lattice, residuals, places = calibration.lattice, calibration.residuals, []
    circles = find_circles(sqrt_luminance(flat), lattice.pitch)
    if len(circles.centres):
        beside = np.hypot(*(lattice.points(np.rint(lattice.to_index(circles.centres))) - circles.centres).T)
        worst, off = circles.centres[beside.argmax()], int((beside > lattice.pitch / 4).sum())
        sentence = (
            f"{off} of {len(beside)} circles found without the lattice (white) lie more than a quarter of the pitch "
            f"beside it, the farthest at x {worst[0]:.0f}, y {worst[1]:.0f}: see whether they are microimages or scene"
        )
        places.append(PlaceToCheck(worst, sentence, np.column_stack([circles.centres, circles.radii])))
    if residuals is not None and len(residuals.offset):
        beside = np.hypot(*residuals.offset.T)
        i, j = index = residuals.indices[beside.argmax()]
        place = lattice.points(index[None])[0]
        sentence = (
            f"lens {i}, {j} at x {place[0]:.0f}, y {place[1]:.0f} lies farthest from the lattice: {beside.max():.2f} "
            f"px; half of them lie within {np.median(beside):.2g} px"
        )
        places.append(PlaceToCheck(place, sentence, np.zeros((0, 3))))
    return places
