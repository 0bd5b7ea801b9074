"""Global fit of scene captures: one lattice through all lenses of a flat, most of which may be misled by the scene.

What the scene shows pushes lenses off, and video compression drags whole parts of a flat along with what moves in
them. So the lenses that agree best decide. Neighbours are misled alike: how sure the lattice is follows from how parts
of the flat differ, not from how lenses do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import cell_normals
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import select_whole_lenses
from ..lattice.robust_fit import LatticeFit, field_rms
from ..runtime.errors import CalibrationError
from .irls import SUREST, LensShifts, error_inflation, find_regular_ratio, solve_irls
from .radial_distortion import RadialEstimate, estimate_radial, zero_distortion
from .template import build_lens_equations

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
# So many steps back are combined; those alike to this share are one. No leap is longer than so many single steps.
_REMEMBERED, _SAME, _FURTHEST = 4, 0.05, 10.0
# So often it is asked which lenses agree best.
_CHOICES = 2
_RUNAWAY = 0.05
# Lenses of a tile in halves of the flat, and the tiles that are taken for independent of each other.
_LENSES_PER_TILE = 16
_FEWEST_TILES = 36
# Tiles of fewer lenses could all be of one colour; halves of fewer have no lattice of their own.
_FEWEST_IN_TILE, _FEWEST_IN_HALF = 3, 3
# More lenses than this make no lattice of a scene any surer.
_MOST_LENSES = 20000
# Lenses that say less than this share of what good ones say about their place have no say.
_GOOD, _SAYS = 0.9, 0.001
# Lenses whose place is so many times less sure than that of the surest have next to none, if others are enough.
_DOUBTFUL = 4.0
_ENOUGH_LENSES = 2000


def fit_scene(picture: NDArray[np.float32], lattice: Lattice, pixels: float = 4e6) -> LatticeFit:
    """Fit origin and basis of a lattice, and a radial distortion where the lenses clearly ask for one.

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
    most = min(max(int(pixels * stride**2 / abs(np.linalg.det(start))), _SKETCH_LENSES), _MOST_LENSES)
    if min(most, len(lattice)) > 2 * _SKETCH_LENSES:
        lattice = _settled(picture, lattice, _chosen(lattice, _SKETCH_LENSES), stride, _SKETCH_PASSES).lattice
    indices = _chosen(lattice, most)
    seen = _look(picture, lattice, indices, stride)
    trusted = _trusted(seen.variance)
    indices, seen = indices[trusted], seen.of(trusted)
    fit = _bent(picture, _settled(picture, lattice, indices, stride, _PASSES, seen=seen), indices, stride)
    regular = find_regular_ratio(fit.before.basis, fit.steps)
    if regular is not None:
        fit = _settled(picture, fit.before, indices, stride, _PASSES, regular, fit.seen)
        fit = fit if fit.lattice.distortion is None else _bent(picture, fit, indices, stride, regular)
    lattice, steps, change, share = fit.lattice, fit.steps, fit.change, fit.share
    error = _standard_error(steps, change, share) * error_inflation(steps, share)
    tile, colour = _tiles(steps, max(_FEWEST_TILES, len(share) // _LENSES_PER_TILE))
    sides = [colour[tile] == side for side in (0, 1)]
    if min(side.sum() for side in sides) < _FEWEST_IN_HALF:
        raise CalibrationError("the microimages show too little; give a brighter flat or a white image")
    halves = [solve_irls(steps, side)[0] for side in sides]
    miss = ((steps.step - steps.design @ change) ** 2).sum(1)
    scatter = float(np.sqrt(np.average(miss, weights=share)))
    differ = field_rms(steps.design, halves[0] - halves[1])
    # Halves are independent, each half as sure as the whole; a fit that has not settled is off by as much as it asks.
    error = float(np.hypot(max(error, differ / 2), fit.unsettled))
    return LatticeFit(lattice.origin, lattice.basis, scatter, error, int((share > 0).sum()), differ, lattice.distortion)


@dataclass(frozen=True)
class _Seen:
    """Steps of the lenses that show something, and the variance (n,) [px^2] of the place of each of all."""

    steps: LensShifts
    variance: NDArray[np.float64]

    def of(self, chosen: NDArray[np.bool_]) -> _Seen:
        """What the `chosen` (n,) of all lenses show."""
        some, steps = chosen[np.isfinite(self.variance)], self.steps
        of_some = replace(steps, design=steps.design[some], step=steps.step[some], variance=steps.variance[some])
        return _Seen(of_some, self.variance[chosen])


@dataclass(frozen=True)
class _Settled:
    """A lattice, the one before it, what is seen from there, and the common change and weights of its steps.

    `unsettled` [px] is how far the lattice would still have gone, RMS over the field.
    """

    lattice: Lattice
    before: Lattice
    seen: _Seen
    change: NDArray[np.float64]
    share: NDArray[np.float64]
    unsettled: float

    @property
    def steps(self) -> LensShifts:
        return self.seen.steps


def _settled(
    picture: NDArray[np.float32],
    lattice: Lattice,
    indices: NDArray[np.int64],
    stride: int,
    passes: int,
    regular: complex | None = None,
    seen: _Seen | None = None,
) -> _Settled:
    """Move the lattice until the lenses at `indices` (n, 2) ask for no more; what is `seen` of them need not be again.

    Where scenes blur the average microimage a single step falls far short: steps are combined as by Anderson, J. ACM
    12 (1965), which finds where they lead.
    """
    start, path = lattice.basis, _Path([], [])
    # Which lenses agree best is asked at first, and again where the fit has settled on those: asked at every step, it
    # would go to and fro between parts of the flat that do not agree, and never settle.
    weights: NDArray[np.float64] | None = None
    asked = _CHOICES - 1
    for turn in range(passes):
        looked = seen if seen is not None and turn == 0 else _look(picture, lattice, indices, stride)
        steps, shown = replace(looked.steps, regular=regular), np.isfinite(looked.variance)
        before = None if weights is None else weights[shown]
        change, share = solve_irls(steps, before=before if before is not None and before.any() else None)
        error = _standard_error(steps, change, share)
        leap = path.leap(lattice, change, steps.design)
        settled = max(field_rms(steps.design, change), field_rms(steps.design, leap)) < _SETTLED * error
        if settled and asked and before is not None:
            asked -= 1
            other, others = solve_irls(steps)
            if field_rms(steps.design, other - change) > _SETTLED * error:
                change, share, path, settled = other, others, _Path([], []), False
                leap = path.leap(lattice, change, steps.design)
        weights = np.zeros(len(indices))
        weights[shown] = share
        before_lattice, lattice = lattice, _moved(lattice, change if settled or turn == passes - 1 else leap)
        if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        if settled:
            break
    seen = replace(looked, steps=steps)
    return _Settled(lattice, before_lattice, seen, change, share, 0.0 if settled else field_rms(steps.design, leap))


def _bent(
    picture: NDArray[np.float32],
    fit: _Settled,
    indices: NDArray[np.int64],
    stride: int,
    regular: complex | None = None,
) -> _Settled:
    """The fit with a radial distortion where that is clearly wanted, else as it is."""
    before, lattice, pull = fit, fit.lattice, _radial_pull(fit)
    if lattice.distortion is None and not pull.clear(lattice.pitch):
        return fit
    bend = lattice.distortion or zero_distortion(lattice)
    for _ in range(_PASSES):
        bend = replace(bend, k1=bend.k1 + pull.k1)
        fit = _settled(picture, replace(lattice, distortion=bend), indices, stride, _SKETCH_PASSES, regular)
        lattice, pull = fit.lattice, _radial_pull(fit)
        if abs(pull.k1) < _SETTLED * pull.error:
            break
    return fit if replace(pull, k1=bend.k1).clear(lattice.pitch) else before


def _radial_pull(fit: _Settled) -> RadialEstimate:
    """The distortion that the lenses of a fit ask for beyond the one it has."""
    tile = _tiles(fit.steps, _FEWEST_TILES)[0]
    return estimate_radial(fit.before, fit.steps.design, fit.steps.step, fit.share, tile)


@dataclass
class _Path:
    """Where a fit has been, as (6,) origin and basis, and what the lenses asked for there."""

    places: list[NDArray[np.float64]]
    asked: list[NDArray[np.float64]]

    def leap(self, lattice: Lattice, change: NDArray[np.float64], design: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change (3, 2) after which the lenses should ask for nothing, if what they ask for is linear in the place."""
        self.places.append(np.vstack([lattice.origin, lattice.basis]).ravel())
        self.asked.append(change.ravel())
        if len(self.asked) == 1:
            return change
        recent = slice(-_REMEMBERED - 1, None)
        moves, turns = np.diff(self.places[recent], axis=0).T, np.diff(self.asked[recent], axis=0).T
        # Compared by what they do to the centres.
        root = np.kron(np.linalg.cholesky(design.T @ design / len(design)).T, np.eye(2))
        part = np.linalg.lstsq(root @ turns, root @ self.asked[-1], rcond=_SAME)[0]
        further = self.asked[-1] - (moves + turns) @ part
        length, plain = (float(np.linalg.norm(root @ v)) for v in (further, self.asked[-1]))
        return (further * min(1.0, _FURTHEST * plain / max(length, 1e-300))).reshape(3, 2)


def _moved(lattice: Lattice, change: NDArray[np.float64]) -> Lattice:
    """The lattice after a change (3, 2) of origin and basis."""
    return replace(lattice, origin=lattice.origin + change[0], basis=lattice.basis + change[1:])


def _chosen(lattice: Lattice, most: int) -> NDArray[np.int64]:
    """Indices of about `most` whole lenses, evenly spread."""
    _, reach = cell_normals(lattice)
    indices, _ = select_whole_lenses(lattice, reach + 1)
    indices = indices[np.arange(len(indices)) * _GOLDEN % 1 < most / max(len(indices), 1)]
    if len(indices) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(indices)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    return indices


def _trusted(variance: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) lenses that have a say, as their `variance` (n,) tells: the rest only takes time."""
    surest = np.quantile(variance, SUREST)
    enough = np.sort(variance)[min(_ENOUGH_LENSES, len(variance)) - 1]
    return np.asarray(variance <= max(_DOUBTFUL * surest, enough))


def _look(picture: NDArray[np.float32], lattice: Lattice, indices: NDArray[np.int64], stride: int) -> _Seen:
    """What the lenses at `indices` (n, 2) show of their steps."""
    faces, reach = cell_normals(lattice)
    centres = lattice.points(indices)
    # Where the lattice has moved, so have lenses over the edge of the flat.
    whole = ((centres >= reach) & (centres <= np.array(picture.shape[::-1]) - 1 - reach)).all(1)
    if whole.sum() < _FEWEST_LENSES:
        raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
    found = build_lens_equations(picture, lattice, np.ascontiguousarray(centres[whole]), faces, stride)
    # Dark and blank lenses agree with whatever they are asked.
    told = np.trace(found.normal, axis1=1, axis2=2)
    clear = told > _SAYS * np.quantile(told, _GOOD)
    count = int(clear.sum())
    if count < _FEWEST_LENSES:
        raise CalibrationError("the microimages show too little; give a brighter flat or a white image")
    (xx, xy), (_, yy) = found.normal[clear].transpose(1, 2, 0)
    bx, by = found.right[clear].T
    # Lenses that show an edge in one direction only say next to nothing about the place along it.
    ridge = 1e-6 * float(told.mean())
    xx, yy = xx + ridge, yy + ridge
    determinant = xx * yy - xy * xy
    step = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / determinant[:, None]
    design = np.column_stack([np.ones(count), indices[whole][clear]])
    variance = np.full(len(indices), np.inf)
    variance[np.flatnonzero(whole)[clear]] = known = found.noise[clear] * (xx + yy) / determinant / 2
    return _Seen(LensShifts(design, step, known, lattice.basis), variance)


def _standard_error(steps: LensShifts, change: NDArray[np.float64], share: NDArray[np.float64]) -> float:
    """Standard error of a centre, RMS over the field [px], from how tiles of the flat pull at the lattice."""
    tile, colour = _tiles(steps, _FEWEST_TILES)
    pull = (share[:, None] * (steps.step - steps.design @ change))[:, :, None] * steps.design[:, None, :]
    total = np.zeros((len(colour), 2, 3))
    np.add.at(total, tile, pull)
    bread = np.linalg.pinv((steps.design * share[:, None]).T @ steps.design)
    covariance = bread @ np.einsum("tap,taq->pq", total, total) @ bread
    moments = steps.design.T @ steps.design / len(share)
    tiles = len(colour)
    return float(np.sqrt(max(np.trace(covariance @ moments), 0.0) * tiles / max(tiles - 3, 1)))


def _tiles(steps: LensShifts, number: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Tile (n,) of each lens, at most about `number` squares of the flat, and the colour (t,) of each on a board."""
    places = steps.design[:, 1:] @ steps.basis
    number = min(number, max(len(places) // _FEWEST_IN_TILE, 1))
    extent = np.ptp(places, axis=0) + 1e-6
    side = float(np.sqrt(extent.prod() / number))
    grid = np.maximum(1, np.rint(extent / side)).astype(int)
    place = np.minimum((places - places.min(0)) / extent * grid, grid - 1).astype(int)
    used, tile = np.unique(place[:, 1] * grid[0] + place[:, 0], return_inverse=True)
    row, column = np.divmod(used, grid[0])
    return tile.ravel(), (row + column) % 2
