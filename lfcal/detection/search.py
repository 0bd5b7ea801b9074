"""Candidates of the lattice on a flat: periods times centres, each with its evidence, the most
probable first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice
from typing import Any

import cv2
import numpy as np

from ..camera.evidence import Evidence
from ..camera.proofs import is_one_lens
from ..hough.circle_vote import OVERLAPPING, find_circles, find_marks
from ..lattice.cell import cell_side
from ..lattice.lattice import Lattice, irregularity, reduce_basis
from ..lattice.stated import LatticeHint
from ..runtime.arrays import Floats, Singles
from ..runtime.errors import CalibrationError
from .borders import LineProfile, find_line_periods, fit_touching_cells
from .cell_centre import find_round_centres
from .cell_maps import CellMaps, CellParts, estimate_explained, measure_classes, tile_side
from .features import FlatFeatures
from .folding import BINS, fold_lit_tiles
from .measure_evidence import Marks, add_overlap, add_parallax, measure_evidence
from .spectrum import find_periods, is_same_lattice
from .tile_lattice import fit_harmonics, has_run_away, refine_basis

__all__ = ["TOUCHING", "Candidate", "find_candidates", "measure_basis", "measure_lattice"]

#: [px] shortest distance between microimages: smaller ones hold too few pixels.
_SHORTEST = 6.0
#: Cells that are longer than so many times their width are none of lenses.
_OBLONG = 4.0
#: Periods that are measured at most, and centres of each that are compared with their neighbours.
_MOST_PERIODS = 16
_MOST_CENTRES = 3
_ALL_CENTRES = 8
#: [px] pictures of more pixels are searched at half their size first, where microimages stay larger
#: than `_HALVED`.
_LARGE = 3e6
_HALVED = 11.0
#: [px] pitch at half the size from which on it shows all, so that such periods are not measured at
#: full size, and probability of a lattice that is taken then.
_CLEAR = 16.0
_LIKELY = 0.5
#: Probability from which on lines and circles propose no better lattice: not on the shared flats.
_SURE = 0.96
#: Contrast of lines between lenses from which on these may touch each other: lines place them then.
TOUCHING = 0.5


@dataclass(frozen=True)
class Candidate:
    """A lattice that may be that of the microimages."""

    lattice: Lattice  # [px] its radius is half the distance to the nearest neighbour
    evidence: Evidence
    features: FlatFeatures  # of the picture, or of that at half its size
    maps: CellMaps  # of the same
    coarser: Floats | None = None  # (2, 2) [px] every second or third row of cells, if these differ

    @property
    def half_difference(self) -> float:
        """RMS distance [px] of the lattices of two halves of the flat."""
        return self.evidence.halves * self.lattice.pitch


def find_candidates(
    picture: Singles,
    hint: LatticeHint | None = None,
    thorough: bool = False,
    stated_white: float = 0.0,
    again: bool = False,
    periods: int = _MOST_PERIODS,
) -> list[Candidate]:
    """Lattices that may be on a picture (h, w), the square root of the luminance, the most probable
    first.

    A certain one ends the search; a `thorough` one measures all periods and centres, at the full
    size. `stated_white` is 1 if the flat is stated to be a white image, else 0. `again`
    if the flat was searched in other tones before: what repeats at half the size is then not looked
    for at the full size. At most so many `periods` are measured at each size, the strongest first.

    Raises
    ------
    CalibrationError
        If nothing repeats in two directions, or nothing as the hint states.
    """
    _check_contrast(picture)
    found: list[Candidate] = []
    most = np.inf
    if picture.size >= _LARGE and not thorough:
        height, width = (length // 2 for length in picture.shape)
        half: Any = cv2.resize(
            picture[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA
        )
        small = _search(
            FlatFeatures(half, stated_white),
            hint and hint.scaled(2),
            least=_HALVED,
            periods=periods,
        )
        if small:
            most = 2 * _CLEAR
        size = picture.shape[1], picture.shape[0]
        found = [
            replace(one, lattice=one.lattice.scaled(2, size))
            for one in small
            if one.lattice.pitch >= _HALVED
        ]
    done = any(one.evidence.is_certain or _is_clear(one) for one in found)
    if not done and not (again and found):
        features = FlatFeatures(picture, stated_white)
        found += _search(features, hint, thorough, most=most, periods=periods)
    if found:
        return sorted(found, key=lambda one: -one.evidence.rank)
    if hint is not None:
        turned = "" if hint.rotation is None else f", turned by about {hint.rotation:g} degrees"
        raise CalibrationError(
            f"no microimages repeat about every {hint.pitch:g} px{turned}; "
            "give other figures, or a white image"
        )
    raise CalibrationError(
        "no pattern repeats in two directions all over the image; "
        "give a raw flat from the sensor, not a rendered or scaled picture"
    )


def _check_contrast(picture: Singles) -> None:
    mean, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(picture))
    if mean == 0 or deviation < 1e-4 * mean:
        raise CalibrationError(
            "the image is one even grey; give a flat with light on it and without saturation"
        )


def _is_clear(found: Candidate) -> bool:
    """Whether more pixels would tell no more about a candidate that was found at half the size."""
    return found.evidence.probability > _LIKELY and found.lattice.pitch > 2 * _CLEAR


def measure_basis(picture: Singles, lattice: Lattice) -> list[Candidate]:
    """Candidates on a picture (h, w) near the basis of a lattice, wherever its centres are, the
    most probable first.
    """
    features = FlatFeatures(picture)
    rough = _measure_period(features, _refine_period(features, lattice.basis))
    found = [one for start in rough[:_MOST_CENTRES] for one in _refine_candidate(start)]
    return sorted(found, key=lambda one: -one.evidence.rank)


def measure_lattice(picture: Singles, lattice: Lattice, stated_white: float = 0.0) -> Candidate:
    """A straight lattice as a candidate on a picture (h, w): the evidence at its own centres.

    CalibrationError if the picture is one even grey.
    """
    _check_contrast(picture)
    features = FlatFeatures(picture, stated_white)
    maps = CellMaps.measure(features, lattice.basis)
    centre = lattice.origin @ np.linalg.inv(lattice.basis) % 1
    rough = _CentreFigures.of(features, lattice.basis).measure(maps, centre)
    return _complete(rough, lattice, fit_harmonics(maps.tiles[1:], lattice.origin).half_difference)


def _search(
    features: FlatFeatures,
    hint: LatticeHint | None,
    thorough: bool = False,
    least: float = 0.0,
    most: float = np.inf,
    periods: int = _MOST_PERIODS,
) -> list[Candidate]:
    """Candidates of so many periods up to `most` [px], or of those up to a certain one, the most
    probable first; none if the strongest period is shorter than `least` [px].

    The centre of each period that looks most like those of lenses is compared with its neighbours
    at once, others only if no period has a certain one.
    """
    found: list[Candidate] = []
    waiting: list[Candidate] = []
    tried: list[Floats] = []
    refine = partial(_refine_period, features, most=most)
    found_periods = find_periods(features)
    bases = chain(
        map(refine, islice(found_periods, 1)),
        map(refine, _find_finer_periods(features, tried)),
        map(refine, found_periods),
        map(refine, _find_coarser_periods(found)),
        _find_other_periods(features, tried, found, most),
        map(refine, hint.bases() if hint else ()),
    )
    for basis in bases:
        shortest = np.hypot(*basis.T).min()
        if shortest < least and not tried:
            return []
        if shortest < _SHORTEST or any(is_same_lattice(basis, other, 0.01) for other in tried):
            continue
        if hint is not None and not hint.allows(Lattice(np.zeros(2), basis, (1, 1), 1.0)):
            continue
        tried.append(basis)
        if np.hypot(*basis.T).max() > _OBLONG * shortest or shortest > most:
            continue
        rough = _measure_period(features, basis)
        found += [one for first in rough[:1] for one in _refine_candidate(first)]
        waiting += rough[1 : _ALL_CENTRES if thorough else _MOST_CENTRES]
        if any(one.evidence.is_certain for one in found) and not thorough:
            waiting = []
            break
        if len(tried) >= periods:
            break
    found += [one for rough in waiting for one in _refine_candidate(rough)]
    return sorted(found, key=lambda one: -one.evidence.rank)


def _find_finer_periods(features: FlatFeatures, tried: list[Floats]) -> Iterator[Floats]:
    """The two lattices that explain the flat best of those with two or three lenses in each cell of
    the first basis.

    An array of several lens types repeats exactly with a cell of several lenses only.
    """
    for a, b in tried[:1]:
        halves = [(a / 2, b), (a, b / 2), ((a + b) / 2, b)]
        thirds = [(a / 3, b), (a, b / 3), ((a + b) / 3, b), ((a + 2 * b) / 3, b)]
        finer = [reduce_basis(np.array(pair)) for pair in (*halves, *thirds)]
        finer = [basis for basis in finer if np.hypot(*basis.T).min() >= _SHORTEST]
        yield from sorted(finer, key=lambda basis: -estimate_explained(features, basis))[:2]


def _find_coarser_periods(found: list[Candidate]) -> Iterator[Floats]:
    """The period of every second or third row of the best candidate, if its rows differ by turns.

    Bright gaps between hexagonal lenses have a period of their own: the root of a third.
    """
    best = max(found, key=lambda one: one.evidence.rank, default=None)
    if best is not None and best.coarser is not None:
        yield best.coarser


def _find_other_periods(
    features: FlatFeatures, tried: list[Floats], found: list[Candidate], most: float
) -> Iterator[Floats]:
    """Periods of lines up to `most` [px], then regular arrays near the bases tried so far, unless
    the spectrum has shown a lattice that is sure.
    """
    if any(one.evidence.probability > _SURE for one in found):
        return
    yield from find_line_periods(features.steps, most)
    for known in list(tried):
        for basis in _regular_bases(known):
            yield _refine_period(features, basis, most)


def _regular_bases(basis: Floats) -> Iterator[Floats]:
    """Square and hexagonal bases (2, 2) [px] with one of the vectors of a basis, within a twentieth
    of it.
    """
    a, b = basis
    sign = np.sign(a[0] * b[1] - a[1] * b[0])
    for degrees in (90.0, 60.0, 120.0):
        angle = np.radians(degrees) * sign
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        for one in (np.array([a, a @ turn]), np.array([b @ turn.T, b])):
            if not has_run_away(one, basis):
                yield one


def _refine_period(features: FlatFeatures, basis: Floats, most: float = np.inf) -> Floats:
    """The basis (2, 2) [px] at which all tiles of a flat agree best, near the given one, which is
    kept if its period is longer than `most` [px].

    Scene detail that moves from lens to lens may draw it away: where it has moved much, the one
    that explains the flat better is kept.
    """
    if np.hypot(*basis.T).min() > most:
        return basis
    pitch = cell_side(basis)
    levelled = list(features.levelled(pitch))
    refined = refine_basis(
        fold_lit_tiles(features.picture, levelled, basis, tile_side(features, pitch))
    )
    if has_run_away(refined, basis):
        return reduce_basis(basis)
    if not is_same_lattice(refined, basis, 0.01):
        explained = [CellMaps.measure(features, one).explained() for one in (refined, basis)]
        refined = refined if explained[0] > explained[1] else basis
    return reduce_basis(refined)


@dataclass(frozen=True)
class _CentreFigures:
    """What is measured of a basis on a flat once, for the evidence of all centres."""

    features: FlatFeatures
    basis: Floats  # (2, 2) [px]
    marks: list[Marks]
    lines: list[LineProfile]

    @classmethod
    def of(cls, features: FlatFeatures, basis: Floats) -> _CentreFigures:
        """Circles and peaks of the pitch, and the steps across both directions."""
        picture = features.picture
        pitch = _straight(features, np.zeros(2), basis).pitch
        marks = [Marks.of(one, picture, pitch) for one in find_marks(picture, pitch)]
        lines = [LineProfile.measure(features.steps, one) for one in np.linalg.inv(basis).T]
        return cls(features, basis, marks, lines)

    def measure(self, maps: CellMaps, centre: Floats) -> Candidate:
        """The candidate with `centre` (2,) in fractional coordinates, without parallax."""
        lattice = _straight(self.features, centre @ self.basis, self.basis)
        evidence = measure_evidence(maps, centre, lattice, self.marks, self.lines)
        return Candidate(lattice, evidence, self.features, maps)


def _straight(features: FlatFeatures, origin: Floats, basis: Floats) -> Lattice:
    """A lattice on a flat, with the point next to its middle as origin."""
    height, width = features.picture.shape
    middle = (np.array([width, height]) - 1) / 2
    radius = float(np.hypot(*basis.T).min() / 2)
    return Lattice(_nearest_point(middle, origin, basis), basis, (width, height), radius)


def _measure_period(features: FlatFeatures, basis: Floats) -> list[Candidate]:
    """Candidates of one period, not yet fitted; those that look most like lenses first."""
    maps = CellMaps.measure(features, basis)
    figures = _CentreFigures.of(features, basis)
    found = [figures.measure(maps, centre) for centre in _propose_centres(maps, figures.lines)]
    return sorted(found, key=lambda one: -one.evidence.outlined)


def _refine_candidate(rough: Candidate) -> list[Candidate]:
    """The candidate with its lattice fitted to all tiles, and with parallax; none where no lattice
    fits.
    """
    lattice = rough.lattice
    maps = rough.maps
    fit = fit_harmonics(maps.tiles[1:], lattice.origin)
    if rough.evidence.borders > TOUCHING:
        lines = fit_touching_cells(rough.features.steps, lattice.basis)
        if lines.half_difference < fit.half_difference:
            fit = lines
    if has_run_away(fit.basis, lattice.basis):
        return []
    fitted = _straight(rough.features, fit.origin, reduce_basis(fit.basis))
    return [_complete(rough, fitted, fit.half_difference)]


def _complete(rough: Candidate, fitted: Lattice, half_difference: float) -> Candidate:
    """The candidate at its fitted lattice, with the figures that follow from there."""
    classes = measure_classes(rough.features, fitted.basis)
    halves = half_difference / fitted.pitch
    evidence = replace(
        rough.evidence,
        halves=halves,
        classes=classes.share,
        irregularity=irregularity(fitted.basis),
        stated_white=rough.features.stated_white,
    )
    coarser = None if is_one_lens(evidence) > 0.5 else reduce_basis(classes.basis)
    picture = rough.features.picture
    if np.isfinite(halves):
        evidence = add_parallax(evidence, picture, fitted)
    bright_gaps = evidence.light < 0 and evidence.probability > _LIKELY
    dubious_white = evidence.white_probability > _LIKELY and not evidence.is_certain
    if bright_gaps or dubious_white:
        wide = find_circles(picture, fitted.pitch, OVERLAPPING)
        evidence = add_overlap(evidence, Marks.of(wide, picture, fitted.pitch), fitted)
    return replace(rough, lattice=fitted, evidence=evidence, coarser=coarser)


def _propose_centres(maps: CellMaps, lines: list[LineProfile]) -> list[Floats]:
    """Centres (2,) in fractional coordinates: round places, cells between steps, half cells; none
    if the average cell is even.
    """
    guesses = find_round_centres([maps.brightness, maps.edges], maps.basis)
    if not guesses:
        return []
    first = guesses[0]
    guesses.append(_between_steps(maps))
    guesses.append((np.array([one.strongest for one in lines]) + 0.5) % 1)
    guesses += [(first + shift) % 1 for shift in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5))]
    pitch = cell_side(maps.basis)
    distinct: list[Floats] = []
    for guess in guesses:
        away = [((guess - other + 0.5) % 1 - 0.5) @ maps.basis for other in distinct]
        if all(np.hypot(*step) > 0.12 * pitch for step in away):
            distinct.append(guess)
    return distinct


def _between_steps(maps: CellMaps) -> Floats:
    """The centre (2,) of the cell that has the strongest steps at its borders against those in its
    middle.
    """
    parts = CellParts.about(np.array([0.5, 0.5]) / BINS, maps.basis)
    weight = parts.border / parts.border.sum() - parts.middle / parts.middle.sum()
    found = np.fft.ifft2(np.fft.fft2(maps.steps) * np.conj(np.fft.fft2(weight))).real
    row, column = np.unravel_index(int(found.argmax()), found.shape)
    return (np.array([column, row]) + 0.5) / BINS


def _nearest_point(place: Floats, origin: Floats, basis: Floats) -> Floats:
    """The lattice point next to `place`."""
    return origin + np.rint((place - origin) @ np.linalg.inv(basis)) @ basis
