"""Figures that are measured of a lattice and a flat, and tell microimages from other patterns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["LatticeFigures", "white_probability"]

# Log odds of a white image against a scene, fitted by `python -m benchmarks.lattices fit`. Lenses
# unlike their neighbours have the weight that tells a capture of an unfocused camera from its white
# image: simulated cameras leave it open.
_WHITE_CONSTANT = -7.95
# [ln] scatter of light inside microimages of white images without noise.
_EVENLY_LIT = -4.6
_WHITE_WEIGHTS = {"inside": -2.7, "detail": -3.94, "unlike": -15.0}


@dataclass(frozen=True)
class LatticeFigures:
    """Figures that tell a lattice of microimages from other patterns, and from the same lattice
    shifted.

    Parameters
    ----------
    repeats : float
        Least correlation of the average cells of opposite thirds of the flat, -1..1.
    halves : float [pitch]
        RMS distance between the lattices of two halves of the flat.
    roundness : float
        Share of the average cell that is a function of the distance from the centre, 0..1.
    shape : float
        Share of the average cell that the distances from the centre and from the border explain,
        0..1.
    light : float
        Logarithm of the light in the middle of cells over that at their borders.
    content : float
        Logarithm of what varies from lens to lens in the middle over that at the borders.
    outline : float
        Steps of brightness on the outline of lenses, round or along the cell, less those inside
        [local deviations].
    borders : float
        How far steps on straight lines midway between the lenses stand out from those between these
        lines, 1 for cells that touch each other without gaps.
    borders_beside : float
        How far the strongest straight lines of both directions stand out, where they do not lie
        midway between the lenses; else 0.
    circles : float
        Share of the lattice points that are centres of circles or peaks found without the lattice,
        or of these that lie on it, the smaller, beyond chance.
    circles_beside : float
        The same of the lattice shifted by half or a third of a cell, the largest.
    fine : float
        Share of the energy of the average cell beyond its first harmonics: waves have none.
    inverted : float
        Correlation of the average cell with itself half a cell further, the least: boards are their
        own negative.
    repeated : float
        The same, the largest: a multiple of the cell of an array consists of equal parts.
    explained : float
        Gain in log likelihood of a pixel if each place of a cell has a mean and a variance of its
        own [nats].
    overlap : float
        Share of the lattice points that are centres of circles wider than the pitch, beyond chance,
        less the same half a cell away; measured where gaps are bright, and on dubious white images.
    parallax : float
        Logarithm of how much less neighbours differ when they are shifted by the disparity than at
        any shift.
    still : float
        The same without a shift: whatever repeats with the lattice matches so, content as well as
        rims.
    continued : float
        Logarithm of how much less the facing sides of neighbours differ than the same sides: one
        picture goes on from cell to cell behind a mesh, not behind lenses.
    classes : float
        Share of the average cell in which two or three classes of rows or diagonals differ, as
        lenses and gaps do in half or a third of the cell of an array.
    irregularity : float
        How far the basis is from that of a square or hexagonal array, over its length.
    fit_halves : float or None [pitch]
        `halves` of the final fit, and how far that has moved the lattice; None before it.
    inside : float
        Logarithm of the scatter of light inside typical microimages; 0 if too few are lit to tell.
    detail : float
        Logarithm of that scatter in the microimages with most detail (95 %) over that in typical
        ones.
    between : float
        Logarithm of the scatter of light from one microimage to the next.
    unlike : float
        Share of the microimages that differ from their neighbours by a tenth of the light or more.
    stated_white : float
        1 if the flat is stated to be a white image, else 0.
    """

    repeats: float
    halves: float
    roundness: float
    shape: float
    light: float
    content: float
    outline: float
    borders: float
    circles: float
    circles_beside: float
    fine: float
    inverted: float
    explained: float
    borders_beside: float = 0.0
    repeated: float = 0.0
    overlap: float = 0.0
    parallax: float = 0.0
    still: float = 0.0
    continued: float = 0.0
    classes: float = 0.0
    irregularity: float = 0.0
    fit_halves: float | None = None
    inside: float = 0.0
    detail: float = 0.0
    between: float = 0.0
    unlike: float = 0.0
    stated_white: float = 0.0

    @property
    def white_probability(self) -> float:
        """Probability that the flat is a white image: lenses are evenly lit, and as bright as their
        neighbours.

        What scatters light inside all lenses of a stated white image alike is noise.
        """
        inside = min(self.inside, _EVENLY_LIT) if self.stated_white else self.inside
        return white_probability(inside, self.detail, self.unlike)


def white_probability(inside: float, detail: float, unlike: float) -> float:
    """Probability of a white image by three figures of `Evidence`."""
    log_odds = _WHITE_CONSTANT + _WHITE_WEIGHTS["inside"] * inside
    log_odds += _WHITE_WEIGHTS["detail"] * detail + _WHITE_WEIGHTS["unlike"] * unlike
    return float(1 / (1 + np.exp(-log_odds)))
