"""First lattice of a flat: periods from its spectrum, made coherent, centres where the average microimage is round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .coherence import refine_basis
from .errors import CalibrationError
from .features import breaks, level_locally
from .folding import fold_tiles
from .lattice import Lattice, reduce_basis
from .origin import round_centres, true_cell
from .spectrum import candidate_bases, spectrum_of

__all__ = ["FirstLattice", "first_lattice"]

_BINS = 36
# Tiles this many pitches wide hold enough lenses for an average and are small against a wandering period.
_TILE = 8


@dataclass(frozen=True)
class FirstLattice:
    """First lattice, good to a fraction of the pitch, with the pictures it was found in."""

    lattice: Lattice
    pictures: list[NDArray[np.float32]]
    coherence: float
    roundness: float


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
        if best is not None and best.support > 0.4:
            break
    if best is None or best.support < 0.1:
        raise CalibrationError(
            "no pattern repeats in two directions all over the image; "
            "give a raw flat from the sensor, not a rendered or scaled picture"
        )
    return best.basis


def first_lattice(picture: NDArray[np.float32]) -> FirstLattice:
    """Lattice from the spectrum, its periods made coherent and its origin put on the round centres."""
    height, width = picture.shape
    basis = _first_basis(picture)
    edges = breaks(picture)
    pictures: list[NDArray[np.float32]] = []
    coherence = 0.0
    cells: list[NDArray[np.float64]] = []
    for _ in range(3):
        pitch = float(np.sqrt(abs(np.linalg.det(basis))))
        pictures = [level_locally(feature, 2 * pitch) for feature in (picture, edges)]
        side = int(_TILE * pitch)
        basis, coherence = refine_basis([fold_tiles(feature, basis, side, _BINS) for feature in pictures])
        cells = [fold_tiles(feature, basis, max(height, width), _BINS).mean() for feature in pictures]
        finer, _ = true_cell(cells, basis)
        if np.array_equal(finer, basis):
            break
        basis = finer
    centre = round_centres(cells, [1.0, 1.0], basis)[0]
    origin = centre.position @ basis
    middle = (np.array([width, height]) - 1) / 2
    origin = origin + np.rint((middle - origin) @ np.linalg.inv(basis)) @ basis
    basis = reduce_basis(basis)
    lattice = Lattice(origin, basis, (width, height), _inradius(basis))
    return FirstLattice(lattice, pictures, coherence, centre.roundness)


def _inradius(basis: NDArray[np.float64]) -> float:
    """Half of the shortest lattice vector [px]."""
    return float(np.hypot(*reduce_basis(basis).T).min() / 2)
