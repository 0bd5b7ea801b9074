"""First lattice of a flat: periods from its spectrum, made coherent, centres where the average microimage is round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .coherence import refine_basis
from .errors import CalibrationError
from .features import breaks, level_locally
from .folding import TileFolds, fold_tiles
from .harmonics import fit_harmonics
from .lattice import Lattice, reduce_basis
from .origin import is_board, lens_centre, round_centres, true_cell
from .spectrum import candidate_bases, spectrum_of

__all__ = ["FirstLattice", "first_lattice"]

_BINS = 36
# Support of a candidate by the spectrum above which longer periods are not looked for, and below which it is none.
_CLEAR = 0.3
_VAGUE = 0.1
# A refinement moves a basis by a thousandth; one that moves it by more than this share follows something else.
_RUNAWAY = 0.05

NO_MICROIMAGES = (
    "no microimages found: something repeats on the image, but not alike in all of it; "
    "give a raw flat from the sensor, not a rendered or scaled picture"
)
# Smaller microimages hold too few pixels to tell discs from gaps; measured pitches may be off by a hundredth.
_LEAST_PITCH = 0.99 * 6.0
# Tiles this many pitches wide hold enough lenses for an average and are small against a wandering period.
_TILE = 8
# Small flats are still cut into this many tiles each way where that leaves them so many pitches wide.
_TILES = 5
_LEAST_TILE = 2.5
# So many tiles are enough to see what an average cell looks like.
_FEW_TILES = 60
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
    brightness, breaks : (h, w) float32
        Locally levelled features.
    coherence : float
        Share of the harmonics' energy that all tiles have in common, 0..1.
    roundness : float
        Share of the variance of the average microimage that the distance to its centre explains, 0..1.
    halves_differ, tile_rms : float [px]
        Agreement of independent halves of the tiles, and of single tiles, with the lattice.
    support : float
        Share of the tiles that agree with the lattice, 0..1.
    repeatability : float
        Correlation of the average microimages of two independent halves of the tiles, the weaker feature of both.
    """

    lattice: Lattice
    brightness: NDArray[np.float32]
    breaks: NDArray[np.float32]
    coherence: float
    roundness: float
    halves_differ: float
    tile_rms: float
    support: float
    repeatability: float


def _first_basis(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Best supported basis over short and long periods; CalibrationError where there is none."""
    best = None
    for reduction in (1, 2, 4):
        spectrum = spectrum_of(picture, reduction)
        if spectrum is None:
            break
        for candidate in candidate_bases(spectrum, 1):
            if best is None or candidate.support > best.support:
                best = candidate
        if best is not None and best.support > _CLEAR:
            break
    if best is None or best.support < _VAGUE:
        raise CalibrationError(
            "no pattern repeats in two directions all over the image; "
            "give a raw flat from the sensor, not a rendered or scaled picture"
        )
    return best.basis


def first_lattice(picture: NDArray[np.float32]) -> FirstLattice:
    """Lattice from the spectrum, its periods made coherent, its origin on the round centres, fitted to all tiles.

    Parameters
    ----------
    picture : (h, w) float32
        As made by `features.tone`.

    Raises
    ------
    CalibrationError
        If nothing repeats in two directions.
    """
    height, width = picture.shape
    basis = _first_basis(picture)
    edges = breaks(picture)
    coherence, window = 0.0, 0.0
    for _ in range(3):
        pitch = float(np.sqrt(abs(np.linalg.det(basis))))
        if not 1 / _LEVEL_AGAIN <= _LEVEL * pitch / max(window, 1e-9) <= _LEVEL_AGAIN:
            window = _LEVEL * pitch
            levelled = [level_locally(feature, window) for feature in (picture, edges)]
        side = int(max(_LEAST_TILE * pitch, min(_TILE * pitch, min(height, width) / _TILES)))
        refined, coherence = refine_basis([fold_tiles(feature, basis, side, _BINS) for feature in levelled])
        basis = _kept(refined, basis)
        basis, changed = _right_cell(levelled, basis, side)
        if not changed:
            break
    folds = [fold_tiles(feature, basis, side, _BINS) for feature in levelled]
    cells = [fold.mean() for fold in folds]
    light = fold_tiles(picture, basis, side, _BINS, _FEW_TILES).mean() ** 2
    if is_board(*cells):
        raise CalibrationError("a checkerboard repeats on the image, not microimages; give a raw flat from the sensor")
    centre = lens_centre(round_centres(cells, [1.0, 1.0], basis), light, basis)
    middle = (np.array([width, height]) - 1) / 2
    origin = _nearest_to(middle, centre.position @ basis, basis)
    fit = fit_harmonics(folds[1:], origin)
    _kept(fit.basis, basis)
    origin, basis = _nearest_to(middle, fit.origin, fit.basis), reduce_basis(fit.basis)
    lattice = Lattice(origin, basis, (width, height), _inradius(basis))
    if 2 * lattice.radius < _LEAST_PITCH:
        raise CalibrationError(
            f"the image repeats every {2 * lattice.radius:.1f} px; microimages must be at least 6 px apart, "
            "give the flat at the full resolution of the sensor"
        )
    return FirstLattice(
        lattice,
        levelled[0],
        levelled[1],
        coherence,
        centre.roundness,
        fit.halves_differ,
        fit.tile_rms,
        fit.support,
        min(_repeatability(fold) for fold in folds),
    )


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
        cells = [fold_tiles(feature, wide, side, _BINS, _FEW_TILES).mean() for feature in levelled]
        found = true_cell(cells, wide)
        if abs(abs(np.linalg.det(found) / np.linalg.det(basis)) - 1) > 0.1:
            return found, True
    return basis, False


def _repeatability(fold: TileFolds) -> float:
    """Correlation of the average cells of the two colours of a checkerboard of tiles."""
    rows, columns = np.divmod(np.arange(len(fold.centre)), fold.grid[1])
    colour = (rows + columns) % 2
    if not 0 < colour.sum() < len(colour):
        return 0.0
    a, b = (fold.mean(colour == side).ravel() for side in (0, 1))
    spread = a.std() * b.std()
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) if spread > 0 else 0.0


def _nearest_to(
    place: NDArray[np.float64], origin: NDArray[np.float64], basis: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The lattice point next to `place`."""
    return origin + np.rint((place - origin) @ np.linalg.inv(basis)) @ basis


def _inradius(basis: NDArray[np.float64]) -> float:
    """Half of the shortest lattice vector [px]."""
    return float(np.hypot(*reduce_basis(basis).T).min() / 2)
