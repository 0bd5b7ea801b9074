"""Lattice of scene captures: one fit through all lenses of a flat, most of which the scene may
shift.

Each lens is compared with the mean microimage (`microimage.mean_cell`). What the scene shows shifts
lenses, and video compression drags whole parts of a flat along with what moves in them, so the
lattice follows the lenses that agree best (`irls`). Neighbours are shifted alike: the standard error comes from
differences between tiles of the flat, not between lenses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..detection.search import Candidate
from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from ..lattice.cell import Cell
from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import sample_mask
from ..lattice.robust_fit import LatticeFit, field_rms
from ..lattice.standard_errors import equal_weight_errors
from ..microimage.lens_equations import build_lens_equations
from ..microimage.mean_cell import average_cells
from ..runtime.arrays import ENOUGH_LENSES, Booleans, Floats, Integers, Singles, evenly
from ..runtime.errors import CalibrationError
from .irls import LensShifts, error_inflation, find_regular_ratio, solve_irls

__all__ = [
    "fit_lattice_to_scenes",
    "fit_scene",
    "measure_shifts",
    "select_lenses",
    "standard_error",
]

_FEWEST_LENSES = 12
# Lenses for the first steps, and passes of these.
_SKETCH_LENSES = 700
_SKETCH_PASSES = 4
# Pixels of all lenses that are used, about.
_PIXELS = 4e6
_PASSES = 10
# [standard errors] shorter steps end a fit.
_SETTLED = 0.2
# Parts of the flat whose errors are independent of each other.
_TILES = 36
# [1/px] Bins of the mean microimage; and most of them each way: more are not worth their memory.
_BINS = 3
_MOST_BINS = 210
_NO_LATTICE = "the microimages do not keep to one lattice; give a sharper flat or a white image"
_TOO_LITTLE = "the microimages show too little; give a brighter flat or a white image"


def fit_lattice_to_scenes(lights: list[Singles], picture: Singles, start: Candidate) -> LatticeFit:
    """Fit one or several scenes of luminance `lights` (h, w); `picture` is the root of their mean.

    Only the edges at the rims are those of the lattice: brightness also shows the scene, gaps of
    cut microimages, and where a camera has flattened its pictures with another white image.
    """
    found = start.lattice
    # More than a rim, less than the scene in a lens.
    window = 0.5 * found.pitch
    rims = normalise_locally(
        edge_strength(picture if len(lights) == 1 else sqrt_luminance(lights[0])), window
    )
    for light in lights[1:]:
        rims += normalise_locally(edge_strength(sqrt_luminance(light)), window)
    if len(lights) > 1:
        rims /= np.float32(len(lights))
    fit = fit_scene(rims, found)
    if fit.residual_rms > 0.02 * found.pitch and not fit.half_difference < start.half_difference:
        # Single lenses scatter too much: averages of whole tiles are the better measure.
        return LatticeFit(found, fit.residual_rms, fit.lenses_used, start.half_difference)
    return replace(fit, displacement=_displacement(found, fit.lattice))


def _displacement(found: Lattice, lattice: Lattice) -> float:
    """`LatticeFit.displacement` of a lattice from the one that its fit began at."""
    places = found.centres()[evenly(len(found), ENOUGH_LENSES)]
    away = lattice.points(np.rint(lattice.to_index(places))) - places
    design = np.column_stack([np.ones(len(places)), places - places.mean(0)])
    return field_rms(design, np.linalg.lstsq(design, away, rcond=None)[0])


def fit_scene(picture: Singles, lattice: Lattice, most: int = 8000) -> LatticeFit:
    """Fit origin and basis of a lattice, and a radial distortion if the lenses clearly show one.

    `picture` (h, w) is a feature that looks alike in most microimages, such as locally normalised
    edges; `lattice` the start, right to a fraction of the pitch over the whole flat. At most so
    many lenses are used, evenly spread. CalibrationError if fewer than a dozen whole microimages
    are on the flat, or they keep to no lattice.
    """
    # Of larger microimages fewer pixels are used, as many as of these.
    stride = max(1, round(lattice.pitch / 24))
    area = abs(np.linalg.det(lattice.basis))
    # More lenses do not make the lattice of a scene more accurate.
    most = min(max(int(_PIXELS * stride**2 / area), _SKETCH_LENSES), most)
    if min(most, len(lattice)) > 2 * _SKETCH_LENSES:
        sketch = _Fitter(picture, select_lenses(lattice, _SKETCH_LENSES), stride)
        lattice = sketch.converge(lattice, _SKETCH_PASSES).lattice
    indices = select_lenses(lattice, most)
    measured = measure_shifts(picture, lattice, indices, stride)
    certain = _select_certain(measured.variance)
    fitter = _Fitter(picture, indices[certain], stride)
    measured = measured.select(certain)
    fit = fitter.add_distortion(fitter.converge(lattice, _PASSES, measured=measured))
    regular = find_regular_ratio(fit.before.basis, fit.shifts)
    if regular is not None:
        fitter = replace(fitter, regular=regular)
        fit = fitter.converge(fit.before, _PASSES, measured=fit.measured)
    return _summarise(fit)


def _summarise(fit: _Converged) -> LatticeFit:
    lattice = fit.lattice
    shifts = fit.shifts
    weight = fit.weight
    index = lattice.indices()
    # The scene may have light in a part of the flat alone.
    field = np.column_stack([np.ones(len(index)), index])
    error = standard_error(shifts, fit.change, weight, field) * error_inflation(shifts, weight)
    tile, parity = _tiles(shifts, max(_TILES, len(weight) // 16))
    sides = [parity[tile] == side for side in (0, 1)]
    if min(side.sum() for side in sides) < 3:
        raise CalibrationError(_TOO_LITTLE)
    one, two = (solve_irls(shifts.select(side))[0] for side in sides)
    miss = ((shifts.shift - shifts.design @ fit.change) ** 2).sum(1)
    scatter = float(np.sqrt(np.average(miss, weights=weight)))
    differ = field_rms(field, one - two)
    # The variance of each half is twice that of the whole; a fit that has not converged is off by
    # what is left to go.
    error = float(np.hypot(max(error, differ / 2), fit.remaining))
    used = int((weight > 0).sum())
    return LatticeFit(lattice, scatter, used, differ, equal_weight_errors(lattice, error))


@dataclass(frozen=True)
class _Measured:
    """Shifts of the lenses that show something, and the variance (n,) [px^2] of all, infinite for
    the others.
    """

    shifts: LensShifts
    variance: Floats

    def select(self, chosen: Booleans) -> _Measured:
        """The `chosen` (n,) of all lenses."""
        return _Measured(
            self.shifts.select(chosen[np.isfinite(self.variance)]), self.variance[chosen]
        )


@dataclass(frozen=True)
class _Converged:
    """A lattice, the one before it, what is measured from there, and the common change and weights
    of the lenses.

    `remaining` [px] is how far the lattice would still have moved, RMS over the field.
    """

    lattice: Lattice
    before: Lattice
    measured: _Measured
    change: Floats
    weight: Floats
    remaining: float

    @property
    def shifts(self) -> LensShifts:
        return self.measured.shifts


@dataclass(frozen=True)
class _Fitter:
    """Fits a lattice to lenses `indices` (n, 2) of a picture, every `stride`-th pixel; `regular` as
    of `LensShifts`.
    """

    picture: Singles
    indices: Integers
    stride: int
    regular: complex | None = None

    def converge(
        self, lattice: Lattice, passes: int, measured: _Measured | None = None
    ) -> _Converged:
        """Move the lattice until the shifts of the lenses balance; `measured` are those of the
        first pass, if known.

        Where scenes blur the mean microimage a single step falls far short: steps are accelerated
        (`Acceleration`).
        """
        start = lattice.basis
        path = Acceleration([], [])
        # The lenses that agree best are selected at first: selected at every step, they would
        # alternate between parts of the flat that do not agree.
        weights: Floats | None = None
        for turn in range(passes):
            if measured is None or turn > 0:
                measured = measure_shifts(self.picture, lattice, self.indices, self.stride)
            measured = replace(measured, shifts=replace(measured.shifts, regular=self.regular))
            shifts = measured.shifts
            shown = np.isfinite(measured.variance)
            before = None if weights is None else weights[shown]
            change, weight = solve_irls(
                shifts, before if before is not None and before.any() else None
            )
            short = _SETTLED * standard_error(shifts, change, weight, shifts.design)
            leap = path.leap(lattice, change, shifts.design)
            settled = max(field_rms(shifts.design, change), field_rms(shifts.design, leap)) < short
            weights = np.zeros(len(self.indices))
            weights[shown] = weight
            from_here = lattice
            last = settled or turn == passes - 1
            lattice = lattice.moved((change if last else leap).ravel())
            if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < 0.05:
                raise CalibrationError(_NO_LATTICE)
            if settled:
                break
        assert measured is not None
        remaining = 0.0 if settled else field_rms(shifts.design, leap)
        return _Converged(lattice, from_here, measured, change, weight, remaining)

    def add_distortion(self, fit: _Converged) -> _Converged:
        """The fit with a radial distortion, about the middle or any place, if that is significant,
        else as it is.
        """
        for tilted in (False, True):
            whole = _estimate_radial(fit, tilted)
            if fit.lattice.distortion is None and whole.is_significant(fit.lattice.pitch):
                for _ in range(_SKETCH_PASSES):
                    bend = whole.distortion(fit.lattice.image_size)
                    fit = self.converge(replace(fit.lattice, distortion=bend), _SKETCH_PASSES)
                    more = _estimate_radial(fit, tilted)
                    if more.significance < _SETTLED**2:
                        break
                    whole = whole + more
        return fit


@dataclass
class Acceleration:
    """Anderson's acceleration (J. ACM 12, 1965): lattices (6,) that a fit has passed, and the
    changes it made there.
    """

    lattices: list[Floats]
    changes: list[Floats]

    def leap(self, lattice: Lattice, change: Floats, design: Floats) -> Floats:
        """Change (3, 2) after which no other is needed if changes are linear in the lattice."""
        self.lattices.append(np.vstack([lattice.origin, lattice.basis]).ravel())
        self.changes.append(change.ravel())
        if len(self.changes) == 1:
            return change
        recent = slice(-5, None)
        moves = np.diff(self.lattices[recent], axis=0).T
        turns = np.diff(self.changes[recent], axis=0).T
        # In the metric of the movement of the centres.
        root = np.kron(np.linalg.cholesky(design.T @ design / len(design)).T, np.eye(2))
        part = np.linalg.lstsq(root @ turns, root @ self.changes[-1], rcond=0.05)[0]
        further = self.changes[-1] - (moves + turns) @ part
        length, plain = (float(np.linalg.norm(root @ v)) for v in (further, self.changes[-1]))
        return (further * min(1.0, 10 * plain / max(length, 1e-300))).reshape(3, 2)


def select_lenses(lattice: Lattice, most: int) -> Integers:
    """Indices of about `most` whole lenses, evenly spread."""
    indices, _ = lattice.select_whole(Cell.of(lattice).circumradius + 1)
    indices = indices[sample_mask(len(indices), most / max(len(indices), 1))]
    if len(indices) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(indices)} whole microimages of {lattice.pitch:.1f} px pitch fit on the "
            f"flat, at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    return indices


def _select_certain(variance: Floats) -> Booleans:
    """(n,) lenses whose variance (n,) is not so large that they have next to no weight: the rest
    only takes time.
    """
    enough = np.sort(variance)[min(2000, len(variance)) - 1]
    return np.asarray(variance <= max(4 * np.quantile(variance, 0.02), enough))


def measure_shifts(picture: Singles, lattice: Lattice, indices: Integers, stride: int) -> _Measured:
    """Shifts of the lenses at `indices` (n, 2) from the lattice, each by itself."""
    cell = Cell.of(lattice)
    centres = lattice.points(indices)
    # A lattice that has moved may have moved lenses over the edge of the flat.
    beyond = np.array(picture.shape[::-1]) - 1 - cell.circumradius
    whole = ((centres >= cell.circumradius) & (centres <= beyond)).all(1)
    if whole.sum() < _FEWEST_LENSES:
        raise CalibrationError(_NO_LATTICE)
    inside = np.ascontiguousarray(centres[whole])
    bins = int(min(_BINS * lattice.pitch, _MOST_BINS))
    mean = average_cells(picture, lattice, inside, cell, bins, stride)
    normal, right, noise = build_lens_equations(picture, lattice, inside, cell, mean, stride)
    # Dark and blank lenses fit any lattice.
    information = np.trace(normal, axis1=1, axis2=2)
    clear = information > 0.001 * np.quantile(information, 0.9)
    if clear.sum() < _FEWEST_LENSES:
        raise CalibrationError(_TOO_LITTLE)
    (xx, xy), (_, yy) = normal[clear].transpose(1, 2, 0)
    bx, by = right[clear].T
    # Lenses that show an edge in one direction only have next to no information on the position
    # along it.
    ridge = 1e-6 * float(information.mean())
    xx = xx + ridge
    yy = yy + ridge
    determinant = xx * yy - xy * xy
    shift = np.column_stack([yy * bx - xy * by, xx * by - xy * bx]) / determinant[:, None]
    design = np.column_stack([np.ones(len(shift)), indices[whole][clear]])
    variance = np.full(len(indices), np.inf)
    variance[np.flatnonzero(whole)[clear]] = known = noise[clear] * (xx + yy) / determinant / 2
    return _Measured(LensShifts(design, shift, known, lattice.basis), variance)


def standard_error(shifts: LensShifts, change: Floats, weight: Floats, field: Floats) -> float:
    """Standard error of a centre, RMS over the `field` (m, 3) as of `LensShifts.design` [px], from
    residuals of tiles.

    A cluster-robust ("sandwich") covariance: Huber, Robust Statistics (1981), section 7.6.
    """
    tile, parity = _tiles(shifts, _TILES)
    pull = (weight[:, None] * (shifts.shift - shifts.design @ change))[:, :, None] * shifts.design[
        :, None, :
    ]
    tiles = len(parity)
    total = np.zeros((tiles, 2, 3))
    np.add.at(total, tile, pull)
    bread = np.linalg.pinv((shifts.design * weight[:, None]).T @ shifts.design)
    covariance = bread @ np.einsum("tap,taq->pq", total, total) @ bread
    moments = field.T @ field / len(field)
    return float(np.sqrt(max(np.trace(covariance @ moments), 0.0) * tiles / max(tiles - 3, 1)))


def _tiles(shifts: LensShifts, number: int) -> tuple[Integers, Integers]:
    """Tile (n,) of each lens, at most about `number` squares, and the colour (t,) 0 or 1 of each as
    on a chessboard.
    """
    places = shifts.design[:, 1:] @ shifts.basis
    number = min(number, max(len(places) // 3, 1))
    extent = np.ptp(places, axis=0) + 1e-6
    side = float(np.sqrt(extent.prod() / number))
    grid = np.maximum(1, np.rint(extent / side)).astype(int)
    place = np.minimum((places - places.min(0)) / extent * grid, grid - 1).astype(int)
    used, tile = np.unique(place[:, 1] * grid[0] + place[:, 0], return_inverse=True)
    row, column = np.divmod(used, grid[0])
    return tile.ravel(), (row + column) % 2


@dataclass(frozen=True)
class RadialEstimate:
    """A radial distortion about the middle of the flat, or, where the array is tilted, about
    another place.

    `k1 * x |x|^2 + 2 x (x . tilt) + tilt |x|^2` for positions `x` from the middle, over half the
    diagonal: expanded about the middle, `k1 (x - c) |x - c|^2` is that with `tilt = -k1 c`, and
    parts that the basis follows.
    """

    k1: float
    tilt: Floats  # (2,) zero about the middle
    significance: float  # squared size over its covariance, per parameter
    shift: float  # [px, RMS] movement of centres, without what a straight lattice can follow

    def is_significant(self, pitch: float) -> bool:
        """Whether a distortion of this strength exceeds what a scene without one can show, at this
        pitch [px].

        Scenes without one reach 9 and 0.001 pitches, with a tilt 12 and 0.003 pitches.
        """
        tilted = self.tilt.any()
        return (
            self.significance > (20 if tilted else 64)
            and self.shift > (0.005 if tilted else 0.003) * pitch
        )

    def __add__(self, other: RadialEstimate) -> RadialEstimate:
        """Both distortions, one after the other, with the significance of the second."""
        return RadialEstimate(
            self.k1 + other.k1, self.tilt + other.tilt, other.significance, other.shift
        )

    def distortion(self, image_size: tuple[int, int]) -> Distortion:
        """As it is kept in a lattice."""
        bend = Distortion.zero(image_size)
        k1 = self.k1 if abs(self.k1) > 1e-9 else 1e-9
        return Distortion(bend.centre - self.tilt / k1 * bend.reach, k1, 0.0, bend.reach)


def _estimate_radial(fit: _Converged, tilted: bool) -> RadialEstimate:
    """The distortion that the lenses of a fit show beyond the one it has, with a tilt if `tilted`.

    Errors within one tile are alike, so the standard error comes from differences between tiles.
    """
    lattice = fit.before
    weight = fit.weight
    design = fit.shifts.design
    tile = _tiles(fit.shifts, _TILES)[0]
    zero = Distortion.zero(lattice.image_size)
    place = (design @ np.vstack([lattice.origin, lattice.basis]) - zero.centre) / zero.reach
    square = (place**2).sum(1, keepdims=True)
    tilts = (
        [2 * place * place[:, [axis]] + square * np.eye(2)[axis] for axis in range(2)]
        if tilted
        else []
    )
    both = np.hstack(
        [*(zero.reach * column for column in (place * square, *tilts)), fit.shifts.shift]
    )
    root = np.sqrt(weight)[:, None]
    both = both - design @ np.linalg.lstsq(design * root, both * root, rcond=None)[0]
    count = 1 + len(tilts)
    columns = both[:, :-2].reshape(-1, count, 2)
    left = both[:, -2:]
    information = np.einsum("n,nkd,nld->kl", weight, columns, columns)
    found = np.linalg.lstsq(
        information, np.einsum("n,nkd,nd->k", weight, columns, left), rcond=None
    )[0]
    moved = np.einsum("k,nkd->nd", found, columns)
    pull = np.zeros((int(tile.max()) + 1, count))
    np.add.at(pull, tile, np.einsum("n,nkd,nd->nk", weight, columns, left - moved))
    bread = np.linalg.pinv(information)
    covariance = bread @ (pull.T @ pull) @ bread * len(pull) / max(len(pull) - 3 - count, 1)
    significance = float(found @ np.linalg.pinv(covariance) @ found) / count
    tilt = found[1:] if tilted else np.zeros(2)
    return RadialEstimate(
        float(found[0]), tilt, significance, float(np.sqrt((moved**2).sum(1).mean()))
    )
