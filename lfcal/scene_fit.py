"""Global fit of scene captures: one lattice through all regions of a flat, most of which may be misled by the scene.

What the scene shows pushes neighbouring lenses the same way, and video compression drags whole regions along with what
moves in them. So lenses are first put together by region, each with the scatter of its own lenses as its error; the
regions that agree best then decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import CalibrationError
from .fit import LatticeFit, cell_faces, whole_lenses
from .lattice import Lattice
from .regions import Regions, agreed, regular_ratio, step_by_region
from .template import lens_steps

__all__ = ["fit_scene"]

_GOLDEN = 0.6180339887498949
_FEWEST_LENSES = 12
# Microimages of this pitch [px] are looked at pixel by pixel, larger ones more coarsely.
_FINE_PITCH = 24.0
# The first steps need only so many lenses.
_SKETCH_LENSES = 700
_SKETCH_PASSES = 4
_PASSES = 10
# Steps below this share of the standard error change nothing.
_SETTLED = 0.2
_RUNAWAY = 0.05
# Lenses of a region, few so that one misled lens does not mislead many, and regions needed before they have so many.
_LENSES_PER_REGION = 6
_FEWEST_REGIONS = 36
# Lenses that say less than this share of what good ones say about their place have no say. Once the lattice is nearly
# right only those count that say half as much, where they are enough to outvote what a scene does to them.
_GOOD, _SAYS, _CLEAR = 0.9, 0.001, 0.5
_ENOUGH_LENSES = 2000


def fit_scene(picture: NDArray[np.float32], lattice: Lattice, pixels: float = 4e6) -> LatticeFit:
    """Fit origin and basis of a straight lattice.

    Parameters
    ----------
    picture : (h, w) float32
        A feature that looks alike in most microimages, such as levelled breaks.
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat.
    pixels : float
        Use only as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    start = lattice.basis
    stride = max(1, round(lattice.pitch / _FINE_PITCH))
    most = max(int(pixels * stride**2 / abs(np.linalg.det(start))), _SKETCH_LENSES)
    for size, passes in ((min(_SKETCH_LENSES, most), _SKETCH_PASSES), (most, _PASSES)):
        if size < most and min(most, len(lattice)) <= 2 * _SKETCH_LENSES:
            continue
        indices = _chosen(lattice, size)
        for turn in range(passes):
            view = _look(picture, lattice, indices, stride)
            change, share = agreed(view.regions)
            before, lattice = lattice, _moved(lattice, change)
            if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
                raise CalibrationError(
                    "the microimages do not keep to one lattice; give a sharper flat or a white image"
                )
            design = np.column_stack([np.ones(len(indices)), indices])
            moments = design.T @ design / len(design)
            covariance = np.linalg.pinv((view.regions.design * share[:, None]).T @ view.regions.design)
            error = float(np.sqrt(2 * np.trace(covariance @ moments)))
            first = turn == 0 and size == most
            indices = _clearest(indices, view.said) if first else indices
            settled = np.sqrt(np.einsum("pa,pq,qa->", change, moments, change)) < _SETTLED * error
            if settled and len(indices) == len(design):
                break
    regular = regular_ratio(lattice.basis, view.regions)
    if regular is not None:
        # What the regions say is from the lattice before the last step.
        lattice = _moved(before, agreed(replace(view.regions, regular=regular))[0])
        view = _look(picture, lattice, indices, stride)
        view = replace(view, regions=replace(view.regions, regular=regular))
        lattice = _moved(lattice, agreed(view.regions)[0])
    regions = view.regions
    halves = [agreed(regions, regions.colour == side)[0] for side in (0, 1)]
    gap = halves[0] - halves[1]
    differ = float(np.sqrt(np.einsum("pa,pq,qa->", gap, moments, gap)))
    return LatticeFit(lattice.origin, lattice.basis, view.scatter, error, view.used, differ)


def _moved(lattice: Lattice, change: NDArray[np.float64]) -> Lattice:
    """The lattice after a change (3, 2) of origin and basis."""
    return replace(lattice, origin=lattice.origin + change[0], basis=lattice.basis + change[1:])


def _chosen(lattice: Lattice, most: int) -> NDArray[np.int64]:
    """Indices of about `most` whole lenses, evenly spread."""
    _, reach = cell_faces(lattice)
    indices, _ = whole_lenses(lattice, reach + 1)
    indices = indices[np.arange(len(indices)) * _GOLDEN % 1 < most / max(len(indices), 1)]
    if len(indices) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(indices)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    return indices


def _clearest(indices: NDArray[np.int64], said: NDArray[np.float64]) -> NDArray[np.int64]:
    """The lenses that say most about their place.

    Where the scene hides the rims, compression has dragged them along with it more often than where they stand out.
    """
    enough = np.sort(said)[max(len(said) - _ENOUGH_LENSES, 0)]
    return indices[said >= min(_CLEAR * np.quantile(said, _GOOD), enough)]


@dataclass(frozen=True)
class _View:
    """What the lenses say of a lattice.

    Parameters
    ----------
    regions : Regions
    said : (n,) float64
        How much each lens says about its place, trace of its normal matrix.
    scatter : float [px]
        RMS distance of single lenses from those of their region.
    used : int
        Lenses with a say.
    """

    regions: Regions
    said: NDArray[np.float64]
    scatter: float
    used: int


def _look(picture: NDArray[np.float32], lattice: Lattice, indices: NDArray[np.int64], stride: int) -> _View:
    """Robust mean step of the lenses of each region."""
    centres = np.ascontiguousarray(lattice.points(indices))
    faces, reach = cell_faces(lattice)
    found = lens_steps(picture, lattice, centres, (faces, reach), stride)
    # Dark and blank lenses agree with whatever they are asked.
    said = np.trace(found.normal, axis1=1, axis2=2)
    says = said > _SAYS * np.quantile(said, _GOOD)
    count = int(says.sum())
    if count < _FEWEST_LENSES:
        raise CalibrationError("the microimages show too little; give a brighter flat or a white image")
    label, colour = _labels(centres[says])
    means, variance, miss, weight = step_by_region(found.normal[says], found.right[says], label)
    number = len(variance)
    design = np.column_stack([np.ones(count), indices[says]])
    total = np.maximum(np.bincount(label, weight, number), 1e-9)
    middle = np.column_stack([np.bincount(label, weight * column, number) / total for column in design.T])
    known = (total > 0.3 * np.median(total)) & (total > 0.5)
    scatter = float(np.sqrt(np.average((miss**2).sum(1), weights=weight * said[says])))
    regions = Regions(middle[known], means[known], variance[known], colour[known], lattice.basis)
    return _View(regions, said, scatter, int((weight > 0).sum()))


def _labels(centres: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Region (n,) of each lens, square tiles of the flat, and the colour (t,) of each on a checkerboard of them."""
    regions = max(_FEWEST_REGIONS, len(centres) // _LENSES_PER_REGION)
    extent = np.ptp(centres, axis=0) + 1e-6
    side = float(np.sqrt(extent.prod() / regions))
    grid = np.maximum(1, np.rint(extent / side)).astype(int)
    place = np.minimum((centres - centres.min(0)) / extent * grid, grid - 1).astype(int)
    used, label = np.unique(place[:, 1] * grid[0] + place[:, 0], return_inverse=True)
    row, column = np.divmod(used, grid[0])
    return label.ravel(), (row + column) % 2
