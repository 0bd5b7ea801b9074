"""First lattice of a flat: periods from its spectrum, made coherent, centres where the average microimage is round."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import edge_strength, normalise_locally
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.errors import CalibrationError
from .cell_centre import choose_lens_centre, find_primitive_cell, find_round_centres, is_checkerboard
from .cell_tests import check_cell, check_waves
from .folding import TileFolds, fold_tiles
from .period_refinement import refine_basis
from .spectrum import NARROW, compute_spectra, compute_spectrum, find_candidate_bases
from .tile_harmonics import fit_harmonics

__all__ = ["REPEATS", "FirstLattice", "find_first_lattice", "find_first_lattices", "find_first_lattices_at_half_size"]

_BINS = 36
# Support of a candidate by the spectrum above which longer periods are not looked for, and below which it is none.
_CLEAR = 0.3
_VAGUE = 0.1
# Sizes of the picture, as divisors, at which periods are looked for; of each so many candidates are kept, and so many
# of all are tried, none that is nearly the same as another by this share of its steps.
_REDUCTIONS = (1, 2, 4)
_CANDIDATES, _TRIES, _SAME = 6, 10, 0.04
# A refinement moves a basis by a thousandth; one that moves it by more than this share follows something else.
_RUNAWAY = 0.05

NO_MICROIMAGES = (
    "no microimages found: something repeats on the image, but not alike in all of it; "
    "give a raw flat from the sensor, not a rendered or scaled picture"
)
# Smaller microimages hold too few pixels to tell discs from gaps; measured pitches may be off by a hundredth.
_LEAST_PITCH = 0.99 * 6.0
# Halved microimages of this pitch [px] and more still show all that a first lattice asks for.
_HALVED_PITCH = 11.0
# Tiles this many pitches wide hold enough lenses for an average and are small against a wandering period.
_TILE = 8
# Small flats are still cut into this many tiles each way where that leaves them so many pitches wide.
_TILES = 5
_LEAST_TILE = 2.5
# So many tiles are enough to see what an average cell looks like.
_FEW_TILES = 60
# Share of the harmonics' energy that all tiles have in common: an eighth where compression and flattening left little.
_COHERENT = 0.05
# Tiles with less than these shares of the tone and of the lattice amplitude squared of good ones lie beside the array:
# stray light there is a sixth of the light in the array at most.
_DARK, _IDLE = 0.4, 0.1
# Pixels along a tile that tell its mean tone.
_TONE_SAMPLES = 32
# Where one feature is alike in two halves to this correlation, the other may be too faint to be.
_CERTAIN = 0.97
#: Two halves of a flat must show average microimages that correlate at least so much.
REPEATS = 0.8
# Halves whose lattices are no farther apart than this share of the pitch leave no doubt: of scenes a hundredth, of
# detail that comes back at other periods than those of the lenses a twentieth.
_SURE = 0.03
# An average microimage that leaves doubt must be this round at least, and may not be more alike than this in both
# halves: what a scene has left in it is round to 0.62 and alike to 0.98, bricks often to less than a half, and wholly.
_ROUND, _EXACT = 0.6, 0.99
# Features are levelled in windows of so many pitches, anew where that was wrong by the other factor.
_LEVEL = 2.0
_LEVEL_AGAIN = 2.0


@dataclass(frozen=True)
class FirstLattice:
    """A lattice, good to a fraction of a pixel or so, with the pictures it was found in.

    Parameters
    ----------
    lattice : Lattice [px]
        Its radius is half the distance to the nearest neighbour.
    brightness, edge_strength : (h, w) float32
        Locally levelled features, of half the size where the lattice was found at that.
    coherence : float
        Share of the harmonics' energy that all tiles have in common, 0..1.
    roundness : float
        Share of the variance of the average microimage that the distance to its centre explains, 0..1.
    half_difference, tile_rms : float [px]
        Agreement of independent halves of the tiles, and of single tiles, with the lattice.
    support : float
        Share of the tiles that agree with the lattice, 0..1.
    repeatability : float
        Correlation of the average microimages of two independent halves of the tiles, the weaker feature, or the mean
        of both where the better one leaves no doubt.
    doubt : CalibrationError, optional
        Why this may be no lattice of microimages, unless neighbours are seen to show the same.
    """

    lattice: Lattice
    brightness: NDArray[np.float32]
    edge_strength: NDArray[np.float32]
    coherence: float
    roundness: float
    half_difference: float
    tile_rms: float
    support: float
    repeatability: float
    doubt: CalibrationError | None = None


def _bases(picture: NDArray[np.float32]) -> Iterator[NDArray[np.float64]]:
    """Bases to try: the best supported over short and long periods, then others; CalibrationError where there is none.

    Detail of a flat scene comes back at another period than that of the lenses, and may stand out more.
    """
    best, known = None, []
    for reduction in _REDUCTIONS:
        spectrum = compute_spectrum(picture, reduction)
        if spectrum is None:
            break
        known.append(find_candidate_bases(spectrum, _CANDIDATES))
        for candidate in known[-1][:1]:
            if best is None or candidate.support > best.support:
                best = candidate
        if best is not None and best.support > _CLEAR:
            break
    if best is None or best.support < _VAGUE:
        raise CalibrationError(
            "no pattern repeats in two directions all over the image; "
            "give a raw flat from the sensor, not a rendered or scaled picture"
        )
    tried = [best.basis]
    yield best.basis
    spectra = [spectrum for reduction in _REDUCTIONS for spectrum in compute_spectra(picture, reduction, NARROW)]
    narrow = [candidate for spectrum in spectra for candidate in find_candidate_bases(spectrum, _CANDIDATES)]
    narrow.sort(key=lambda one: -one.support)
    wide = [one for rank in zip_longest(*known) for one in rank if one is not None]
    for candidate in narrow + wide:
        if len(tried) < _TRIES and not any(_same_lattice(candidate.basis, basis) for basis in tried):
            tried.append(candidate.basis)
            yield candidate.basis


def _same_lattice(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether two bases span nearly the same points."""
    steps = one @ np.linalg.inv(other)
    whole = np.rint(steps)
    return bool(abs(abs(np.linalg.det(whole)) - 1) < 0.5 and np.abs(steps - whole).max() < _SAME)


def find_first_lattice(picture: NDArray[np.float32]) -> FirstLattice:
    """Lattice from the best supported periods of the spectrum, made coherent, its origin on the round centres, fitted
    to all tiles.

    Parameters
    ----------
    picture : (h, w) float32
        As made by `features.tone`.

    Raises
    ------
    CalibrationError
        If nothing repeats in two directions, or no microimages do.
    """
    return _lattice_from(next(_bases(picture)), picture, edge_strength(picture))


def find_first_lattices(picture: NDArray[np.float32]) -> Iterator[FirstLattice]:
    """`find_first_lattice`, then, where that is doubtful or wrong, others without doubt, the roundest first.

    Raises
    ------
    CalibrationError
        As `find_first_lattice`, if there is none at all.
    """
    yield from _lattices_from(_bases(picture), picture)


def _lattices_from(bases: Iterator[NDArray[np.float64]], picture: NDArray[np.float32]) -> Iterator[FirstLattice]:
    """`find_first_lattices` from bases of the spectrum."""
    edges = edge_strength(picture)
    error: CalibrationError | None = None
    unsure: FirstLattice | None = None
    given: list[FirstLattice] = []
    try:
        first = _lattice_from(next(bases), picture, edges)
        if _is_sure(first):
            given.append(first)
            yield first
        else:
            unsure = first
    except CalibrationError as failure:
        error = failure
    sure = []
    for basis in bases:
        try:
            found = _lattice_from(basis, picture, edges)
        except CalibrationError:
            continue
        if _is_sure(found):
            sure.append(replace(found, doubt=found.doubt or error or CalibrationError(NO_MICROIMAGES)))
    # Lenses of several types, taken together, are less round than single ones.
    for found in sorted(sure, key=lambda one: -one.roundness):
        if not any(_same_lattice(found.lattice.basis, one.lattice.basis) for one in given):
            given.append(found)
            yield found
    if not given:
        if unsure is None:
            raise error or CalibrationError(NO_MICROIMAGES)
        yield unsure


def _is_sure(found: FirstLattice) -> bool:
    """Whether two halves of the flat agree about a lattice and about what its microimages look like."""
    return found.repeatability >= REPEATS and found.half_difference <= _SURE * found.lattice.pitch


def _lattice_from(basis: NDArray[np.float64], picture: NDArray[np.float32], edges: NDArray[np.float32]) -> FirstLattice:
    """`find_first_lattice` from a basis of the spectrum; CalibrationError where that is none of microimages."""
    height, width = picture.shape
    coherence, window = 0.0, 0.0
    for _ in range(3):
        pitch = float(np.sqrt(abs(np.linalg.det(basis))))
        if not 1 / _LEVEL_AGAIN <= _LEVEL * pitch / max(window, 1e-9) <= _LEVEL_AGAIN:
            window = _LEVEL * pitch
            levelled = [normalise_locally(feature, window) for feature in (picture, edges)]
        side = int(max(_LEAST_TILE * pitch, min(_TILE * pitch, min(height, width) / _TILES)))
        refined, coherence = refine_basis(_lit_folds(picture, levelled, basis, side))
        basis = _kept(refined, basis)
        basis, changed = _right_cell(levelled, basis, side)
        if not changed:
            break
    if 2 * _inradius(basis) < _LEAST_PITCH:
        raise CalibrationError(
            f"the image repeats every {2 * _inradius(basis):.1f} px; microimages must be at least 6 px apart, "
            "give the flat at the full resolution of the sensor"
        )
    folds = _lit_folds(picture, levelled, basis, side)
    cells = [fold.mean() for fold in folds]
    if coherence < _COHERENT:
        raise CalibrationError(NO_MICROIMAGES)
    (tone,) = fold_tiles([picture], basis, side, 4 * _BINS, _FEW_TILES)
    check_waves(tone)
    if is_checkerboard(*cells):
        raise CalibrationError("a checkerboard repeats on the image, not microimages; give a raw flat from the sensor")
    light = tone.mean().reshape(_BINS, 4, _BINS, 4).mean((1, 3)) ** 2
    centre = choose_lens_centre(find_round_centres(cells, [1.0, 1.0], basis), light, basis)
    repeatability = _repeatability(folds)
    doubt = check_cell(cells, light, tone, centre.position, repeatability)
    if doubt is not None and (centre.roundness < _ROUND or repeatability > _EXACT):
        raise doubt
    middle = (np.array([width, height]) - 1) / 2
    origin = _nearest_to(middle, centre.position @ basis, basis)
    fit = fit_harmonics(folds[1:], origin)
    _kept(fit.basis, basis)
    origin, basis = _nearest_to(middle, fit.origin, fit.basis), reduce_basis(fit.basis)
    lattice = Lattice(origin, basis, (width, height), _inradius(basis))
    return FirstLattice(
        lattice,
        levelled[0],
        levelled[1],
        coherence,
        centre.roundness,
        fit.half_difference,
        fit.tile_rms,
        fit.support,
        repeatability,
        doubt,
    )


def find_first_lattices_at_half_size(picture: NDArray[np.float32]) -> Iterator[FirstLattice]:
    """`find_first_lattices` of a picture (h, w) of many pixels, at half its size where that leaves no doubt.

    The features are then of half the size; the lattice is in px of the picture.
    """
    import cv2

    height, width = (length // 2 for length in picture.shape)
    half: Any = cv2.resize(picture[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    bases = _bases(half)
    start: FirstLattice | None = None
    starts: Iterator[FirstLattice] = iter(())
    with suppress(CalibrationError):
        first = next(bases)
        # Where the pitch is too short to be halved, no lattice need be made of it to know.
        if 2 * _inradius(first) >= _HALVED_PITCH:
            starts = _lattices_from(chain([first], bases), half)
            start = next(starts)
    if start is None or start.lattice.pitch < _HALVED_PITCH or start.doubt is not None:
        yield from find_first_lattices(picture)
        return
    for found in chain([start], starts):
        small = found.lattice
        lattice = Lattice(2 * small.origin + 0.5, 2 * small.basis, picture.shape[::-1], 2 * small.radius)
        yield replace(found, lattice=lattice, half_difference=2 * found.half_difference, tile_rms=2 * found.tile_rms)


def _kept(refined: NDArray[np.float64], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """`refined`, or CalibrationError where it has run away from `basis`."""
    if not np.abs(refined @ np.linalg.inv(basis) - np.eye(2)).max() < _RUNAWAY:
        raise CalibrationError(NO_MICROIMAGES)
    return refined


def _right_cell(
    levelled: list[NDArray[np.float32]], basis: NDArray[np.float64], side: int
) -> tuple[NDArray[np.float64], bool]:
    """The cell that holds one microimage, and whether that is another than the one of `basis`.

    Folded on two and three cells each way, the average picture must repeat from cell to cell (else there are gaps
    or several sizes among what was taken for microimages), and must not repeat within a cell.
    """
    for multiple in (1, 2, 3):
        wide = basis * multiple
        folds = fold_tiles(levelled, wide, side, _BINS, _FEW_TILES)
        first, second = zip(*(fold.halves() for fold in folds), strict=True)
        found = find_primitive_cell(list(first), wide, list(second))
        if abs(abs(np.linalg.det(found) / np.linalg.det(basis)) - 1) > 0.1:
            return found, True
    return basis, False


def _lit_folds(
    picture: NDArray[np.float32], levelled: list[NDArray[np.float32]], basis: NDArray[np.float64], side: int
) -> list[TileFolds]:
    """Folds of the features, without the tiles beside the array: dark ones in which next to nothing repeats."""
    folds = fold_tiles(levelled, basis, side, _BINS)
    tone = _tile_tones(picture, folds[0].side)
    strength = sum(fold.strength() for fold in folds)
    beside = (tone < _DARK * np.quantile(tone, 0.9)) & (strength < _IDLE * np.quantile(strength, 0.9))
    return [fold.only(~beside) for fold in folds] if beside.any() else folds


def _tile_tones(picture: NDArray[np.float32], side: int) -> NDArray[np.float64]:
    """Mean of a picture in each square tile, in rows, from some thousand of its pixels."""
    step = max(1, side // _TONE_SAMPLES)
    few = picture[::step, ::step]
    # The first sample of each tile, of whichever row or column.
    rows, columns = (np.arange(0, length, side) + step - 1 for length in picture.shape)
    rows, columns = (np.minimum(v // step, n - 1) for v, n in zip((rows, columns), few.shape, strict=True))
    total = np.add.reduceat(np.add.reduceat(few, columns, axis=1, dtype=np.float64), rows, axis=0)
    area = np.outer(np.diff(rows, append=few.shape[0]), np.diff(columns, append=few.shape[1]))
    return np.asarray((total / np.maximum(area, 1)).ravel())


def _repeatability(folds: list[TileFolds]) -> float:
    """Correlation of the average cells of two halves of the tiles: the weaker feature unless the other is certain."""
    found = []
    for fold in folds:
        if len(fold.centre) < 2:
            return 0.0
        a, b = (half.ravel() - half.mean() for half in fold.halves())
        found.append(float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-30))
    return float(np.mean(found)) if max(found) > _CERTAIN else min(found)


def _nearest_to(
    place: NDArray[np.float64], origin: NDArray[np.float64], basis: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The lattice point next to `place`."""
    return origin + np.rint((place - origin) @ np.linalg.inv(basis)) @ basis


def _inradius(basis: NDArray[np.float64]) -> float:
    """Half of the shortest lattice vector [px]."""
    return float(np.hypot(*reduce_basis(basis).T).min() / 2)
