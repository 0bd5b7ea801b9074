"""Global fit of scene captures: one lattice through all regions of a flat, most of which may be misled by the scene.

What the scene shows pushes neighbouring lenses the same way, and video compression drags whole regions along with what
moves in them. So lenses are first put together by region, each with the scatter of its own lenses as its error; the
regions that agree best then decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import CalibrationError
from .fit import LatticeFit, cell_faces, inner_radius, whole_lenses
from .lattice import Lattice
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
# Lenses of a region, and regions needed before they may have so many.
_LENSES_PER_REGION = 16
_FEWEST_REGIONS = 36
# Lenses that say less than this share of what good ones say about their place have no say.
_SAYS = 0.001
# A region's own scatter counts like that of all lenses together until it has so many lenses.
_PRIOR_LENSES = 6
_OUTLIER = 4.685
# The best third of the regions says how well regions agree; those further off than this have no say. Where most of
# a flat is dragged the same way the half would follow it.
_AGREEING = 0.35
_REGION_OUTLIER = 3.0
_FEWEST_IN_PART = 8
# Bases this near to a regular one, relative to their length, may be one; the test with that many independent places
# asks for one chance in a hundred.
_NEARLY_REGULAR = 0.003
_PLACES = 12
_SIGNIFICANT = 6.0
_REGULAR_PASSES = 2
_TURNS = 30


@dataclass(frozen=True)
class _Regions:
    """What the regions say, and what is known of the lattice.

    Parameters
    ----------
    design : (t, 3) float64
        Mean lattice indices with a leading 1.
    step, variance : (t, 2), (t,) float64 [px, px^2]
        Mean steps and how sure they are.
    colour : (t,) int64
        On a checkerboard of regions.
    basis : (2, 2) float64 [px]
        The steps are from this one.
    regular : complex or None
        `a2 / a1` as complex numbers where the array is known to be regular.
    """

    design: NDArray[np.float64]
    step: NDArray[np.float64]
    variance: NDArray[np.float64]
    colour: NDArray[np.int64]
    basis: NDArray[np.float64]
    regular: complex | None = None


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
    sketches = _SKETCH_PASSES if min(most, len(lattice)) > 2 * _SKETCH_LENSES else 0
    for turn in range(sketches + _PASSES):
        indices, centres = _chosen(lattice, _SKETCH_LENSES if turn < sketches else most)
        regions, weight, residual = _regions(picture, lattice, indices, centres, stride)
        change, share = _agreed(regions)
        lattice = replace(lattice, origin=lattice.origin + change[0], basis=lattice.basis + change[1:])
        if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        design = np.column_stack([np.ones(len(indices)), indices])
        moments = design.T @ design / len(design)
        covariance = np.linalg.pinv((regions.design * share[:, None]).T @ regions.design)
        error = float(np.sqrt(2 * np.trace(covariance @ moments)))
        moved = float(np.sqrt(np.einsum("pa,pq,qa->", change, moments, change)))
        if turn >= sketches and moved < _SETTLED * error:
            break
    regular = _regular(lattice, regions)
    if regular is not None:
        for _ in range(_REGULAR_PASSES):
            regions, weight, residual = _regions(picture, lattice, indices, centres, stride)
            change, share = _agreed(replace(regions, regular=regular))
            lattice = replace(lattice, origin=lattice.origin + change[0], basis=lattice.basis + change[1:])
            centres = lattice.points(indices)
            regions = replace(regions, regular=regular)
    halves = [_agreed(regions, regions.colour == side)[0] for side in (0, 1)]
    gap = halves[0] - halves[1]
    differ = float(np.sqrt(np.einsum("pa,pq,qa->", gap, moments, gap)))
    return LatticeFit(lattice.origin, lattice.basis, residual, error, int((weight > 0).sum()), differ)


def _chosen(lattice: Lattice, most: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices and centres of about `most` whole lenses, evenly spread."""
    _, reach = cell_faces(lattice)
    indices, centres = whole_lenses(lattice, reach + 1)
    chosen = np.arange(len(centres)) * _GOLDEN % 1 < most / max(len(centres), 1)
    indices, centres = indices[chosen], np.ascontiguousarray(centres[chosen])
    if len(centres) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(centres)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    return indices, centres


def _regions(
    picture: NDArray[np.float32],
    lattice: Lattice,
    indices: NDArray[np.int64],
    centres: NDArray[np.float64],
    stride: int,
) -> tuple[_Regions, NDArray[np.float64], float]:
    """Robust mean step of the lenses of each region; weights (n,) of the lenses, and the scatter of their steps."""
    faces, reach = cell_faces(lattice)
    found = lens_steps(picture, lattice, centres, (faces, inner_radius(faces), reach), stride)
    # Dark and blank lenses agree with whatever they are asked.
    said = np.trace(found.normal, axis1=1, axis2=2)
    says = said > _SAYS * np.quantile(said, 0.9)
    normals, rights, indices, centres = found.normal[says], found.right[says], indices[says], centres[says]
    count = len(indices)
    if count < _FEWEST_LENSES:
        raise CalibrationError("the microimages show too little; give a brighter flat or a white image")
    label, colour = _labels(centres)
    number = int(label.max()) + 1
    ridge = 1e-6 * np.trace(normals.sum(0)) / count * np.eye(2)
    normal = normals + ridge
    steps = np.linalg.solve(normal, rights[..., None])[..., 0]
    own, prior = np.bincount(label, minlength=number), _PRIOR_LENSES
    weight = np.ones(count)
    for _ in range(5):
        matter, force = np.zeros((number, 2, 2)), np.zeros((number, 2))
        np.add.at(matter, label, weight[:, None, None] * normal)
        np.add.at(force, label, weight[:, None] * rights)
        mean = np.linalg.solve(matter + ridge, force[..., None])[..., 0]
        miss: NDArray[Any] = steps - mean[label]
        far = np.einsum("na,nab,nb->n", miss, normal, miss)
        middle = np.array([np.median(far[label == k]) for k in range(number)]) / 1.386
        spread = (middle * own + float(np.median(far)) / 1.386 * prior) / (own + prior) + 1e-30
        weight = np.clip(1 - far / (spread[label] * _OUTLIER**2), 0, None) ** 2
    variance = spread * np.trace(np.linalg.inv(matter + ridge), axis1=1, axis2=2) / 2
    design = np.column_stack([np.ones(count), indices])
    total = np.maximum(np.bincount(label, weight, number), 1e-9)
    means = np.column_stack([np.bincount(label, weight * column, number) / total for column in design.T])
    known = (total > 0.3 * np.median(total)) & (total > 0.5)
    trust = weight * np.trace(normal, axis1=1, axis2=2)
    residual = float(np.sqrt(np.average((miss**2).sum(1), weights=trust)))
    return _Regions(means[known], mean[known], variance[known], colour[known], lattice.basis), weight, residual


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


def _agreed(
    regions: _Regions, chosen: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Change (3, 2) of origin and basis on which most regions agree best, and the weights of the regions [1/px^2].

    A dragged part of the flat may agree as well within itself, so the search starts from several parts of it.
    """
    keep = slice(None) if chosen is None else chosen
    some = replace(
        regions,
        design=regions.design[keep],
        step=regions.step[keep],
        variance=regions.variance[keep],
        colour=regions.colour[keep],
    )
    found = [_settled(some, start) for start in _starts(some)]
    least = min(common for _, _, common in found)

    def misfit(change: NDArray[np.float64]) -> float:
        square = ((some.step - some.design @ change) ** 2).sum(1)
        return float(np.minimum(square / (some.variance + least), _REGION_OUTLIER**2).sum())

    change, weight, _ = min(found, key=lambda one: misfit(one[0]))
    return change, weight


def _starts(regions: _Regions) -> list[NDArray[np.float64]]:
    """Least squares (3, 2) through all regions, and through those on either side of four lines."""
    weight = 1 / (regions.variance + 0.1 * np.median(regions.variance) + 1e-12)
    place = regions.design[:, 1:] - np.median(regions.design[:, 1:], axis=0)
    starts = [_weighted(regions, weight)]
    for angle in np.arange(8) * np.pi / 4:
        side = place @ [np.cos(angle), np.sin(angle)] > 0
        if side.sum() >= _FEWEST_IN_PART:
            starts.append(_weighted(regions, weight * side))
    return starts


def _settled(regions: _Regions, change: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Change (3, 2) after robust least squares from a start, weights of the regions and their common variance.

    Beside the error of each region all have one in common, that of their scenes; it follows from how far the best
    share of the regions lies off.
    """
    design, step, variance = regions.design, regions.step, regions.variance
    expected = -2 * np.log(1 - _AGREEING)
    for _ in range(_TURNS):
        before = change
        square = ((step - design @ change) ** 2).sum(1)
        # That variance at which just the agreeing share lies within what is expected of it.
        common = max(float(np.quantile(square / expected - variance, _AGREEING)), 1e-12)
        away = square / ((variance + common) * _REGION_OUTLIER**2)
        weight = np.clip(1 - away, 0, None) ** 2 / (variance + common)
        change = _weighted(regions, weight)
        if np.abs(change - before).max() < 1e-5:
            break
    return change, weight, common


def _weighted(regions: _Regions, weight: NDArray[np.float64]) -> NDArray[Any]:
    """Weighted least squares: change (3, 2) of origin and basis."""
    root = np.sqrt(weight)[:, None]
    if regions.regular is None:
        solved: NDArray[Any] = np.linalg.lstsq(regions.design * root, regions.step * root, rcond=None)[0]
        return solved
    # A regular lattice is one complex number a1 beside its origin: c = origin + (i + j * regular) * a1.
    place = regions.step + regions.design[:, 1:] @ regions.basis
    design = np.column_stack([np.ones(len(place)), regions.design[:, 1:] @ [1, regions.regular]])
    origin, first = np.linalg.lstsq(design * root, (place @ [1, 1j]) * root[:, 0], rcond=None)[0]
    found = np.array([origin, first, first * regions.regular])
    return np.column_stack([found.real, found.imag]) - np.vstack([np.zeros(2), regions.basis])


def _regular(lattice: Lattice, regions: _Regions) -> complex | None:
    """`a2 / a1` of the regular array that the regions cannot tell from the fitted one, None where there is none.

    Arrays are made regular to a part in ten thousand; scenes mislead by more. A scene has about a dozen places that
    are misled on their own, whatever the number of regions, so an F-test is made for as many.
    """
    a1, a2 = lattice.basis @ [1, 1j]
    ratio = complex(a2 / a1)
    regular = min((np.exp(1j * np.pi / 3), 1j), key=lambda value: abs(ratio - value))
    if abs(ratio - regular) > _NEARLY_REGULAR:
        return None
    misfits = []
    for known in (None, complex(regular)):
        trial = replace(regions, regular=known)
        change, _, common = min((_settled(trial, start) for start in _starts(trial)), key=lambda one: one[2])
        misfits.append((change, common))
    square = [((regions.step - regions.design @ change) ** 2).sum(1) for change, _ in misfits]
    spread = regions.variance + min(common for _, common in misfits)
    free, bound = (float(np.minimum(value / spread, _REGION_OUTLIER**2).sum()) for value in square)
    freedom = 2 * _PLACES - 6
    return complex(regular) if (bound / max(free, 1e-30) - 1) * freedom / 2 < _SIGNIFICANT else None
