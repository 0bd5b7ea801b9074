"""What a person should look at to trust a calibration: the lens that fits worst, gaps, and circles found without it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..hough.circle_vote import find_circles
from ..images.interpolation import interpolate_linear
from ..images.preprocessing import sqrt_luminance
from ..lattice.lens_subset import sample_lenses

__all__ = ["PlaceToCheck", "find_places_to_check"]


@dataclass(frozen=True, eq=False)
class PlaceToCheck:
    """A place on a flat, and what to look at there."""

    position: NDArray[np.float64]  # (2,) [px]
    sentence: str
    circles: NDArray[np.float64]  # (n, 3) x, y and radius [px] of circles found without the lattice; none if (0, 3)


def find_places_to_check(calibration: Calibration, flat: NDArray[Any]) -> list[PlaceToCheck]:
    """Places on a flat (h, w) or (h, w, 3) of the size of the calibration, the most telling one first.

    Circles by Hough vote, where there are some; the lens that lies farthest from the lattice, where single ones were
    measured; and the brightest gap.
    """
    picture = sqrt_luminance(flat)
    found = [_circles(calibration, picture), _worst_lens(calibration), _brightest_gap(calibration, picture)]
    return [place for place in found if place is not None]


def _circles(calibration: Calibration, picture: NDArray[np.float32]) -> PlaceToCheck | None:
    lattice = calibration.lattice
    circles = find_circles(picture, lattice.pitch)
    if not len(circles.centres):
        return None
    beside = np.hypot(*(lattice.points(np.rint(lattice.to_index(circles.centres))) - circles.centres).T)
    worst, off = circles.centres[beside.argmax()], int((beside > lattice.pitch / 4).sum())
    sentence = (
        f"{off} of {len(beside)} circles found without the lattice (white) lie more than a quarter of the pitch beside "
        f"it, the farthest at x {worst[0]:.0f}, y {worst[1]:.0f}: see whether they are microimages or scene"
    )
    return PlaceToCheck(worst, sentence, np.column_stack([circles.centres, circles.radii]))


def _worst_lens(calibration: Calibration) -> PlaceToCheck | None:
    residuals = calibration.residuals
    if residuals is None or not len(residuals.offset):
        return None
    beside = np.hypot(*residuals.offset.T)
    i, j = index = residuals.indices[beside.argmax()]
    place = calibration.lattice.points(index[None])[0]
    sentence = (
        f"lens {i}, {j} at x {place[0]:.0f}, y {place[1]:.0f} lies farthest from the lattice: {beside.max():.2f} px; "
        f"half of them lie within {np.median(beside):.2g} px"
    )
    return PlaceToCheck(place, sentence, np.zeros((0, 3)))


def _brightest_gap(calibration: Calibration, picture: NDArray[np.float32]) -> PlaceToCheck | None:
    lattice = calibration.lattice
    steps = lattice.steps @ lattice.basis
    _, centres = sample_lenses(lattice, float(np.hypot(*steps.T).max()), 4000)
    if not len(centres):
        return None
    core = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]) * lattice.radius / 4
    inside = interpolate_linear(picture, centres[:, None] + core).mean(1) ** 2
    gaps = interpolate_linear(picture, centres[:, None] + steps / 2) ** 2
    share = gaps.max(1) / np.maximum(inside, 1e-3 * np.quantile(inside, 0.9) + 1e-12)
    worst = centres[share.argmax()]
    sentence = (
        f"half way to its neighbours a lens has {np.median(share):.0%} of the light of its middle; most at "
        f"x {worst[0]:.0f}, y {worst[1]:.0f}: gaps should be darker than microimages"
    )
    return PlaceToCheck(worst, sentence, np.zeros((0, 3)))
