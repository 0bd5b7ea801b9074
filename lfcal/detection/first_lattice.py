"""First lattice of a flat, good to a fraction of a pixel, on which the final fit starts.

Periods come from the narrow peaks of the power spectrum, are refined until all tiles are coherent, and reduced to the
cell of a single microimage. The centre is where the average microimage is round; the lattice is fitted to the
harmonics of all tiles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import cv2
import numpy as np

from ..hough.circle_vote import find_circles, propose_basis
from ..images.preprocessing import edge_strength, normalise_locally
from ..lattice.lattice import Lattice, reduce_basis
from ..lattice.stated import LatticeHint
from ..runtime.arrays import Floats, Singles
from ..runtime.errors import CalibrationError
from .cell_centre import choose_lens_centre, find_primitive_cell, find_round_centres, is_checkerboard
from .cell_tests import check_cell
from .folding import BINS, CELL_TILES, fold_lit_tiles, fold_tiles, measure_repeatability
from .gaps import Gaps, gap_tone, measure_gaps, window_likelihood
from .spectrum import find_bases, is_same_lattice
from .tile_lattice import finer_bases, fit_harmonics, has_run_away, refine_basis, similar_bases

__all__ = [
    "NO_MICROIMAGES", "REPEATABILITY", "FirstLattice", "find_first_lattice", "find_first_lattices",
    "find_stated_lattices",
]  # fmt: skip

REPEATABILITY = 0.8  # least correlation of the average microimages of two halves of the flat
_HALF_DIFFERENCE = 0.03  # [pitch] between lattices of two halves: scenes 0.01, detail of a plane 0.05
_GAP_TONE = 0.65  # light of dark gaps over that of cells: arrays up to 0.6, bars from 0.7

NO_MICROIMAGES = (
    "no microimages found: something repeats on the image, but not alike in all of it; "
    "give a raw flat from the sensor, not a rendered or scaled picture"
)


@dataclass(frozen=True)
class FirstLattice:
    """A lattice, good to a fraction of a pixel or so, with the picture it was found in."""

    lattice: Lattice  # [px] its radius is half the distance to the nearest neighbour
    # (h, w) root of the luminance, locally normalised; of half the size where the lattice was found at that
    brightness: Singles
    roundness: float  # share of the variance of the average microimage explained by the distance to its centre, 0..1
    half_difference: float  # [px] RMS distance over the flat of the lattices of two halves of the tiles
    repeatability: float  # correlation of the average microimages of two halves of the tiles
    doubt: CalibrationError | None = None  # why this may be no lattice of microimages, unless parallax proves it
    clear_gaps: bool = False  # dark gaps at every border of cells of different content
    confirmed: bool = False  # circles found by Hough vote lie on it, where halves of the flat hardly repeat

    @property
    def is_certain(self) -> bool:
        """Whether two halves of the flat agree about the lattice and about its average microimage."""
        most = _HALF_DIFFERENCE * self.lattice.pitch
        return self.repeatability >= REPEATABILITY and self.half_difference <= most

    def explains(self, basis: Floats) -> float:
        """`window_likelihood` of a basis (2, 2) [px of the flat] on the picture."""
        scale = self.brightness.shape[0] / self.lattice.image_size[1]
        return window_likelihood(self.brightness, scale * basis, int(8 * scale * self.lattice.pitch))


def find_first_lattice(picture: Singles, basis: Floats | None = None) -> FirstLattice:
    """Lattice of a picture (h, w), as made by `images.preprocessing.sqrt_luminance`.

    Its basis is the best supported one of the spectrum, or `basis` (2, 2) [px] where that is known to some percent.
    Raises `CalibrationError` if nothing repeats in two directions, or no microimages do.
    """
    return _build_lattice(next(find_bases(picture)) if basis is None else basis, picture, edge_strength(picture))


def find_first_lattices(picture: Singles) -> Iterator[FirstLattice]:
    """`find_first_lattice` and, where that is doubtful or turns out to be wrong, certain others, the roundest first.

    At half the size of a picture (h, w) of many pixels, where that leaves no doubt: `FirstLattice.brightness` is then
    of half the size. Raises `CalibrationError` if there is none at all.
    """
    start: FirstLattice | None = None
    starts: Iterator[FirstLattice] = iter(())
    # Smaller microimages show too little at half size.
    fewest = 11.0
    if picture.size >= 3e6:
        height, width = (length // 2 for length in picture.shape)
        half: Any = cv2.resize(picture[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        with suppress(CalibrationError):
            bases = find_bases(half)
            first = next(bases)
            if 2 * _inradius(first) >= fewest:
                starts = _build_lattices(chain([first], bases), half)
                start = next(starts)
    if start is None or start.lattice.pitch < fewest or start.doubt is not None:
        yield from _build_lattices(find_bases(picture), picture)
        return
    for found in chain([start], starts):
        lattice = found.lattice.scaled(2, picture.shape[::-1])
        yield replace(found, lattice=lattice, half_difference=2 * found.half_difference)


def find_stated_lattices(picture: Singles, hint: LatticeHint) -> list[FirstLattice]:
    """Lattices of a picture (h, w) as stated, the roundest first.

    Raises `CalibrationError` if nothing repeats on the picture as stated, or in more than one way.
    """
    bases: list[Floats] = []
    with suppress(CalibrationError):
        bases += find_bases(picture)
    edges = edge_strength(picture)
    found: list[FirstLattice] = []
    for number, basis in enumerate(bases + hint.bases()):
        if found and number >= len(bases):
            break
        with suppress(CalibrationError, np.linalg.LinAlgError):
            one = _build_lattice(basis, picture, edges)
            if hint.allows(one.lattice) and one.repeatability >= REPEATABILITY / 2:
                found.append(replace(one, doubt=None))
    if not found:
        turned = "" if hint.rotation is None else f", turned by about {hint.rotation:g} degrees"
        raise CalibrationError(
            f"no microimages repeat about every {hint.pitch:g} px{turned}; give other figures, or a white image"
        )
    explained = [one.explains(one.lattice.basis) for one in found]
    best = found[int(np.argmax(explained))]
    for one, share in zip(found, explained, strict=True):
        other = one.lattice.basis
        if share > 0.9 * max(explained) and not is_same_lattice(other, best.lattice.basis, 0.005):
            raise CalibrationError(
                f"several lattices of about {hint.pitch:g} px explain the flat nearly as well "
                f"({best.lattice.pitch:.2f} and {one.lattice.pitch:.2f} px); give a white image"
            )
    return sorted(found, key=lambda one: -one.roundness)


def _build_lattices(bases: Iterator[Floats], picture: Singles) -> Iterator[FirstLattice]:
    """Lattices from bases of the spectrum: the first if it is certain, certain others, else the best of the rest."""
    edges = edge_strength(picture)
    error: CalibrationError | None = None
    given: list[FirstLattice] = []
    certain: list[FirstLattice] = []
    uncertain: list[FirstLattice] = []
    tried = []
    for basis in bases:
        tried.append(basis)
        try:
            found = _build_lattice(basis, picture, edges)
        except CalibrationError as failure:
            error = failure if len(tried) == 1 else error
            continue
        if not found.is_certain:
            uncertain.append(found)
        elif len(tried) == 1:
            given.append(found)
            yield found
        else:
            certain.append(replace(found, doubt=error or found.doubt or CalibrationError(NO_MICROIMAGES)))
    # The average of several lens types is less round than that of one.
    for found in sorted(certain, key=lambda one: -one.roundness):
        if not any(is_same_lattice(found.lattice.basis, one.lattice.basis) for one in given):
            given.append(found)
            yield found
    if given:
        return
    # Two halves that repeat need no circles, though few lit lenses may not agree about the lattice.
    if error is None and uncertain and uncertain[0].repeatability >= REPEATABILITY:
        yield uncertain[0]
        return
    confirmed = _confirm_by_circles(uncertain, tried, picture, edges)
    yield from (replace(one, doubt=one.doubt or error or CalibrationError(NO_MICROIMAGES)) for one in confirmed)
    if confirmed:
        return
    if error is not None or not uncertain:
        raise error or CalibrationError(NO_MICROIMAGES)
    yield uncertain[0]


def _confirm_by_circles(
    uncertain: list[FirstLattice], tried: list[Floats], picture: Singles, edges: Singles
) -> list[FirstLattice]:
    """Those of the uncertain lattices, and of others that circles propose, on which circles lie, the best one first.

    In crops of few lenses of several types two halves of the flat hardly repeat, whatever the lattice.
    """
    known = [one.lattice.basis for one in uncertain]
    pitches: list[float] = []
    for basis in [*known, *tried]:
        # Scene detail draws the shortest period of an uncertain basis to less than the pitch.
        for pitch in (2 * _inradius(basis), 2.2 * _inradius(basis)):
            if pitch >= 0.99 * 6 and all(abs(np.log(pitch / other)) > 0.07 for other in pitches):
                pitches.append(pitch)
    for pitch in pitches:
        proposed = propose_basis(picture, pitch)
        if proposed is None or any(is_same_lattice(proposed, basis) for basis in known):
            continue
        known.append(proposed)
        with suppress(CalibrationError, np.linalg.LinAlgError):
            uncertain = [*uncertain, _build_lattice(proposed, picture, edges)]
    ranked = [
        (find_circles(picture, one.lattice.pitch).agreement(one.lattice), one) for one in uncertain
        if one.repeatability >= REPEATABILITY / 2 and np.isfinite(one.half_difference)
    ]  # fmt: skip
    ranked = [pair for pair in ranked if pair[0] >= 0.2]
    return [replace(one, confirmed=True) for _, one in sorted(ranked, key=lambda pair: -pair[0])]


def _build_lattice(basis: Floats, picture: Singles, edges: Singles) -> FirstLattice:
    """`find_first_lattice` from a basis of the spectrum; CalibrationError where that is none of microimages."""
    height, width = picture.shape
    start = basis
    basis, side, features = _refine_cell(basis, picture, edges)
    basis, gaps = _choose_by_gaps(features[0], [basis, *similar_bases(basis, start)], side)
    # Smaller microimages hold too few pixels; a hundredth is for errors of measurement.
    if 2 * _inradius(basis) < 0.99 * 6:
        raise CalibrationError(
            f"the image repeats every {2 * _inradius(basis):.1f} px; microimages must be at least 6 px apart, "
            "give the flat at the full resolution of the sensor"
        )
    if gaps.lack_some():
        raise CalibrationError(NO_MICROIMAGES)
    folds = fold_lit_tiles(picture, features, basis, side)
    cells = [fold.mean() for fold in folds]
    if is_checkerboard(cells[0], cells[1]):
        raise CalibrationError("a checkerboard repeats on the image, not microimages; give a raw flat from the sensor")
    light = fold_tiles([picture], basis, side, BINS, CELL_TILES)[0].mean() ** 2
    centre = choose_lens_centre(find_round_centres(cells, basis), light, basis)
    repeatability = measure_repeatability(folds)
    doubt, place = None, gaps.centre @ gaps.basis
    proved = gaps.prove_lattice() and gap_tone(light, gaps) < _GAP_TONE
    if not proved:
        place = centre.position @ basis
        doubt = check_cell(cells, light, basis, centre.position, repeatability)
    middle = (np.array([width, height]) - 1) / 2
    fit = fit_harmonics(folds[1:], _nearest_point(middle, place, basis))
    if has_run_away(fit.basis, basis):
        raise CalibrationError(NO_MICROIMAGES)
    origin, basis = _nearest_point(middle, fit.origin, fit.basis), reduce_basis(fit.basis)
    lattice = Lattice(origin, basis, (width, height), _inradius(basis))
    return FirstLattice(lattice, features[0], centre.roundness, fit.half_difference, repeatability, doubt, proved)


def _choose_by_gaps(brightness: Singles, choices: list[Floats], side: int) -> tuple[Floats, Gaps]:
    """The likeliest of several bases (2, 2) [px], where gaps prove it, else the first; and the gaps of its cells.

    Scene detail that moves from lens to lens draws the period after it, but then gaps do not lie over gaps.
    """
    likely = max(choices, key=lambda one: window_likelihood(brightness, one, side))
    gaps = measure_gaps(brightness, likely, side)
    if gaps.prove_lattice():
        return gaps.basis, gaps
    if likely is not choices[0]:
        gaps = measure_gaps(brightness, choices[0], side)
    if gaps.lack_some():
        # Cells of several lenses, as of an array of several types.
        for finer in finer_bases(gaps.basis):
            found = measure_gaps(brightness, finer, side)
            if found.prove_lattice():
                return found.basis, found
    return choices[0], gaps


def _refine_cell(basis: Floats, picture: Singles, edges: Singles) -> tuple[Floats, int, list[Singles]]:
    """Refined basis of the cell of one microimage, side of the tiles [px], and normalised features."""
    window = 0.0
    for _ in range(3):
        pitch = float(np.sqrt(abs(np.linalg.det(basis))))
        if not 1 / 2 <= 2 * pitch / max(window, 1e-9) <= 2:
            window = 2 * pitch
            features = [normalise_locally(feature, window) for feature in (picture, edges)]
        # Tiles hold enough lenses for an average, and are small against a wandering period.
        side = int(max(2.5 * pitch, min(8 * pitch, min(picture.shape) / 5)))
        refined = refine_basis(fold_lit_tiles(picture, features, basis, side))
        if has_run_away(refined, basis):
            raise CalibrationError(NO_MICROIMAGES)
        basis, changed = _single_cell(features, refined, side)
        if not changed:
            break
    return basis, side, features


def _single_cell(features: list[Singles], basis: Floats, side: int) -> tuple[Floats, bool]:
    """The cell that holds one microimage, and whether that is another than the one of `basis`.

    Folded on two and three cells each way, the average picture must repeat from cell to cell (else there are gaps
    or several sizes among what was taken for microimages), and must not repeat within a cell.
    """
    for multiple in (1, 2, 3):
        wide = basis * multiple
        folds = fold_tiles(features, wide, side, BINS, CELL_TILES)
        first, second = zip(*(fold.half_means() for fold in folds), strict=True)
        found = find_primitive_cell(list(first), wide, list(second))
        if abs(abs(np.linalg.det(found) / np.linalg.det(basis)) - 1) > 0.1:
            return found, True
    return basis, False


def _nearest_point(place: Floats, origin: Floats, basis: Floats) -> Floats:
    """The lattice point next to `place`."""
    return origin + np.rint((place - origin) @ np.linalg.inv(basis)) @ basis


def _inradius(basis: Floats) -> float:
    """Half of the shortest lattice vector [px]."""
    return float(np.hypot(*reduce_basis(basis).T).min() / 2)
