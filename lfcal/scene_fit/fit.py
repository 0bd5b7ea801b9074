"""Lattice of scene captures: one fit through all lenses of a flat, most of which the scene may
shift.

Each lens is compared with the mean microimage (`microimage.mean_cell`). What the scene shows shifts
lenses, and video compression drags whole parts of a flat along with what moves in them, so the
lattice follows the lenses that agree best (`irls`). Neighbours are shifted alike: the standard error comes from
differences between tiles of the flat, not between lenses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..detection.search import Candidate
from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from ..lattice.cell import Cell
from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice, irregularity, nearest_regular_ratio
from ..lattice.lens_subset import sample_mask
from ..lattice.robust_fit import LatticeFit, field_rms
from ..lattice.standard_errors import equal_weight_errors
from ..microimage.lens_equations import build_lens_equations
from ..microimage.mean_cell import average_cells
from ..runtime.arrays import ENOUGH_LENSES, Array, Booleans, Floats, Integers, Singles, evenly
from ..runtime.errors import CalibrationError
from .irls import LensShifts, error_inflation, is_regular, solve_irls

__all__ = [
    "fit_lattice_to_scenes",
    "fit_scene",
    "measure_shifts",
    "select_lenses",
    "standard_error",
]

_FEWEST_LENSES = 12
# [pitch] RMS distance of single lenses beyond which tiles may be the better measure.
_SCATTER = 0.023
# Lenses for the first steps, and passes of these at most.
_SKETCH_LENSES = 700
_SKETCH_PASSES = 8
# [px] pitch of a picture from half as much more on which it is reduced.
_LARGEST = 36.0
# Pixels of all lenses that are used, about.
_PIXELS = 4e6
# Passes of a fit at most, those before the response of the shifts is measured, and those of a
# distortion.
_PASSES = 20
_PLAIN_PASSES = 4
_BEND_PASSES = 4
# [pitch] longest step.
_LONGEST = 0.05
# Least response of the shifts that steps follow.
_LEAST_RESPONSE = 0.1
# [standard errors] shorter steps end a fit.
_SETTLED = 0.05
# [standard errors] smaller changes of a distortion end its fit.
_BENT = 0.2
# Irregularity of a basis below which the array is taken for regular if the lenses allow it.
_NEARLY_REGULAR = 0.01
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
    if (
        fit.residual_rms > _SCATTER * found.pitch
        and not fit.half_difference < start.half_difference
    ):
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
    factor = max(1, round(lattice.pitch / _LARGEST))
    if factor > 1:
        # Means of squares of pixels: every other pixel of larger microimages would be as fast, but
        # the lattice of a scene then depends on which.
        small, size = _reduce(picture, factor)
        reduced = fit_scene(small, lattice.scaled(1 / factor, size), most)
        return _enlarge(reduced, factor, lattice.image_size)
    area = abs(np.linalg.det(lattice.basis))
    # More lenses do not make the lattice of a scene more accurate.
    most = min(max(int(_PIXELS / area), _SKETCH_LENSES), most)
    regular = None
    if irregularity(lattice.basis) < _NEARLY_REGULAR:
        regular = nearest_regular_ratio(lattice.basis)
    response = None
    if min(most, len(lattice)) > 2 * _SKETCH_LENSES:
        sketch = _Fitter(picture, select_lenses(lattice, _SKETCH_LENSES), regular)
        rough = sketch.converge(lattice, passes=_SKETCH_PASSES)
        lattice = rough.lattice
        response = rough.response
    indices = select_lenses(lattice, most)
    certain = _select_certain(measure_shifts(picture, lattice, indices).variance)
    fitter = _Fitter(picture, indices[certain], regular)
    fit = fitter.converge(lattice, response)
    if regular is not None and not is_regular(fit.shifts):
        fitter = replace(fitter, regular=None)
        fit = fitter.converge(fit.lattice)
    return _summarise(fitter.add_distortion(fit))


def _reduce(picture: Singles, factor: int) -> tuple[Singles, tuple[int, int]]:
    """A picture averaged over `factor` x `factor` pixels, and its width and height."""
    height, width = (length // factor for length in picture.shape)
    whole = picture[: factor * height, : factor * width]
    small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small), (width, height)


def _enlarge(fit: LatticeFit, factor: int, image_size: tuple[int, int]) -> LatticeFit:
    """A fit to a reduced picture, in pixels of the whole one."""
    return replace(
        fit,
        lattice=fit.lattice.scaled(factor, image_size),
        residual_rms=fit.residual_rms * factor,
        half_difference=fit.half_difference * factor,
        errors=fit.errors and fit.errors.scaled(factor),
    )


def _summarise(fit: _Converged) -> LatticeFit:
    lattice = fit.lattice
    shifts = fit.shifts
    weight = fit.weight
    index = lattice.indices()
    # The scene may have light in a part of the flat alone.
    field = np.column_stack([np.ones(len(index)), index])
    error = standard_error(shifts, fit.change, weight, field, fit.gain)
    error *= error_inflation(shifts, weight)
    tile, parity = _tiles(shifts, max(_TILES, len(weight) // 16))
    sides = [parity[tile] == side for side in (0, 1)]
    if min(side.sum() for side in sides) < 3:
        raise CalibrationError(_TOO_LITTLE)
    one, two = (solve_irls(shifts.select(side))[0] for side in sides)
    miss = ((shifts.shift - shifts.design @ fit.change) ** 2).sum(1)
    scatter = float(np.sqrt(np.average(miss, weights=weight)))
    differ = field_rms(field, one - two)
    away = field_rms(field, (fit.gain @ (one - two).ravel()).reshape(3, 2))
    # The variance of each half is twice that of the whole; a fit that has not converged is off by
    # what is left to go.
    error = float(np.hypot(max(error, away / 2), fit.remaining))
    used = int((weight > 0).sum())
    return LatticeFit(lattice, scatter, used, differ, equal_weight_errors(lattice, error))


@dataclass(frozen=True)
class _Measured:
    """Shifts of the lenses that show something, and the variance (n,) [px^2] of all, infinite for
    the others.
    """

    shifts: LensShifts
    variance: Floats


@dataclass(frozen=True)
class _Frame:
    """Changes of a lattice of unit size: orthonormal, where the product of two changes is the mean
    over the lenses of that of their shifts.
    """

    changes: Floats  # (6, p) of origin and basis, one in each column
    inverse: Floats  # (p, 6)

    @classmethod
    def of(cls, indices: Integers, regular: complex | None) -> _Frame:
        """All changes, or those of a regular array with this `a2 / a1`, for lenses (n, 2)."""
        design = np.column_stack([np.ones(len(indices)), indices])
        root = np.kron(np.linalg.cholesky(design.T @ design / len(design)).T, np.eye(2))
        free = np.eye(6)
        if regular is not None:
            turn = np.array([[regular.real, -regular.imag], [regular.imag, regular.real]])
            free = np.vstack([np.eye(4), np.hstack([np.zeros((2, 2)), turn])])
        unit, scale = np.linalg.qr(root @ free)
        return cls(free @ np.linalg.inv(scale), unit.T @ root)

    def coordinates(self, change: Floats) -> Floats:
        """(p,) of a change (3, 2)."""
        return self.inverse @ change.ravel()


@dataclass(frozen=True)
class _Converged:
    """A lattice at which the shifts of the lenses balance.

    `before` is the one that shifts were `measured` from last, `change` (3, 2) what they say there,
    with the `weight` (n,) of the lenses. `remaining` [px] is the length of the last step, RMS over
    the field.
    """

    lattice: Lattice
    before: Lattice
    measured: _Measured
    change: Floats
    weight: Floats
    remaining: float
    frame: _Frame
    response: Floats  # (p, p) how the change follows the lattice: minus one for sharp rims

    @property
    def shifts(self) -> LensShifts:
        return self.measured.shifts

    @property
    def gain(self) -> Floats:
        """(6, 6) error of the lattice by that of the change."""
        return self.frame.changes @ np.linalg.solve(_bounded(self.response), self.frame.inverse)


@dataclass(frozen=True)
class _Fitter:
    """Fits a lattice to lenses `indices` (n, 2) of a picture; `regular` as of `LensShifts`."""

    picture: Singles
    indices: Integers
    regular: complex | None = None

    def converge(
        self, lattice: Lattice, response: Floats | None = None, passes: int = _PASSES
    ) -> _Converged:
        """Move the lattice until the shifts of the lenses balance.

        Where scenes blur the mean microimage, the shifts fall far short of the way that is left:
        steps follow Broyden's method (Math. Comp. 19, 1965), and after some passes the `response`
        of the shifts to the lattice is measured. Weights of the lenses follow that of the pass
        before.
        """
        start = lattice.basis
        frame = _Frame.of(self.indices, self.regular)
        whole = np.vstack([lattice.origin, lattice.basis])
        nearest = frame.changes @ frame.coordinates(whole)
        lattice = lattice.moved(nearest - whole.ravel())
        known = response is not None
        count = frame.changes.shape[1]
        response = -np.eye(count) if response is None else response
        weights: Floats | None = None
        value: Floats = np.zeros(count)
        step: Array = np.zeros(count)
        for turn in range(passes):
            measured = self._measure(lattice)
            shifts = measured.shifts
            shown = np.isfinite(measured.variance)
            before = None
            if weights is not None:
                before = weights[shown]
                turned = frame.coordinates(shifts.fit(before)) - value - response @ step
                response = response + np.outer(turned, step) / max(float(step @ step), 1e-30)
            change, weight = solve_irls(shifts, before)
            weights = np.zeros(len(self.indices))
            weights[shown] = weight
            if turn == _PLAIN_PASSES and not known:
                response = self._measure_response(lattice, frame, weights)
            value = frame.coordinates(change)
            step = -np.linalg.solve(_bounded(response), value)
            remaining = float(np.linalg.norm(step))
            step *= min(1.0, _LONGEST * lattice.pitch / max(remaining, 1e-30))
            from_here = lattice
            lattice = lattice.moved(frame.changes @ step)
            if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < 0.05:
                raise CalibrationError(_NO_LATTICE)
            settled = _SETTLED * standard_error(shifts, change, weight, shifts.design)
            if remaining < settled:
                break
        return _Converged(lattice, from_here, measured, change, weight, remaining, frame, response)

    def _measure(self, lattice: Lattice) -> _Measured:
        measured = measure_shifts(self.picture, lattice, self.indices)
        return replace(measured, shifts=replace(measured.shifts, regular=self.regular))

    def _measure_response(self, lattice: Lattice, frame: _Frame, weights: Floats) -> Floats:
        """(p, p) how the change follows the lattice, by differences."""
        length = _LONGEST / 10 * lattice.pitch
        values = []
        for column in (np.zeros(6), *frame.changes.T):
            measured = self._measure(lattice.moved(length * column))
            shown = np.isfinite(measured.variance)
            values.append(frame.coordinates(measured.shifts.fit(weights[shown])))
        return (np.array(values[1:]) - values[0]).T / length

    def add_distortion(self, fit: _Converged) -> _Converged:
        """The fit with a radial distortion, about the middle or any place, if that is significant,
        else as it is.
        """
        for tilted in (False, True):
            whole = _estimate_radial(fit, tilted)
            if fit.lattice.distortion is None and whole.is_significant(fit.lattice.pitch):
                for _ in range(_BEND_PASSES):
                    bend = whole.distortion(fit.lattice.image_size)
                    fit = self.converge(replace(fit.lattice, distortion=bend), fit.response)
                    more = _estimate_radial(fit, tilted)
                    if more.significance < _BENT**2:
                        break
                    whole = whole + more
        return fit


def _bounded(response: Floats) -> Floats:
    """A response (p, p) without directions in which the shifts hardly follow the lattice."""
    left, size, right = np.linalg.svd(response)
    return np.asarray((left * np.maximum(size, _LEAST_RESPONSE)) @ right)


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


def measure_shifts(picture: Singles, lattice: Lattice, indices: Integers) -> _Measured:
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
    mean = average_cells(picture, lattice, inside, cell, bins)
    normal, right, noise = build_lens_equations(picture, lattice, inside, cell, mean)
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


def standard_error(
    shifts: LensShifts, change: Floats, weight: Floats, field: Floats, gain: Floats | None = None
) -> float:
    """Standard error of a centre, RMS over the `field` (m, 3) as of `LensShifts.design` [px], from
    residuals of tiles.

    Of the change (3, 2), or of the lattice that follows it with this `gain` (6, 6).

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
    pulls = np.einsum("pq,taq->tpa", bread, total).reshape(tiles, 6)
    if gain is not None:
        pulls = pulls @ gain.T
    moments = np.kron(field.T @ field / len(field), np.eye(2))
    square = float(np.einsum("tp,pq,tq", pulls, moments, pulls))
    return float(np.sqrt(square * tiles / max(tiles - 3, 1)))


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

        Scenes without one reach 9 and 0.001 pitches, with a tilt 22 and 0.005 pitches (MiniGarden2).
        """
        tilted = self.tilt.any()
        return (
            self.significance > (30 if tilted else 36)
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
