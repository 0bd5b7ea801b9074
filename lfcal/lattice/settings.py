"""Tuned values of lattices: their form, their limits, and which lenses are lit."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["ARRANGEMENTS", "DEFAULT", "LIT_LENSES", "LatticeSettings", "LitLensSettings"]


_ROOT = math.sqrt(0.75)
#: Bases of pitch 1 by the name of their arrangement; rows of hexagonal arrays are those of nearest neighbours.
ARRANGEMENTS = {
    "hexagonal": ((1.0, 0.0), (0.5, _ROOT)),
    "hexagonal-vertical": ((0.0, 1.0), (-_ROOT, 0.5)),
    "square": ((1.0, 0.0), (0.0, 1.0)),
}


@dataclass(frozen=True)
class LatticeSettings:
    """Tuned values of `lattice`, `distortion`, `residuals` and `orientation`."""

    neighbour_length: float = 1.2  # [mean basis length] longest third neighbour: 1 in hexagons, 1.41 in squares
    equal_length: float = 5e-3  # [squared length] nearer is equal: measured hexagons get the basis of exact ones
    square_tolerance: float = 0.03  # [share of a side, cosine] up to which a cell counts as square; set by hand
    largest_distortion: float = 0.3  # [distance to the middle] beyond it neighbouring lenses change places
    largest_centre_step: float = 0.1  # [half the diagonal] of the distortion centre in one Gauss-Newton step
    inverse_iterations: int = 12  # of undistorting; each gains two digits at the distortions of real lenses
    residual_outlier: float = 4.0  # [median length] longer residuals are faults of single lenses; set by hand
    residual_grid: tuple[int, int] = (12, 9)  # rectangles across and down the flat over which residuals are averaged
    sample_first: int = 60_000  # [lenses] larger lattices are sampled before the few lenses at the border are left out
    steep_slope: float = 0.25  # of rows of lenses; from there on lenses are numbered in rows of pixels instead
    most_pixels: int = 1 << 31  # more than any camera has
    most_lenses: int = 1 << 27  # more than any camera has
    most_rows: float = 1e7  # [lenses] more than any camera has
    farthest_origin: float = 1e9  # [px] no microimage lies so far from its flat
    chunk: int = 1 << 20  # [lenses] handled at once, so that hardly more memory is needed than for the result
    most_cached: int = 1 << 20  # [lenses] up to which a lattice keeps its centres in memory


@dataclass(frozen=True)
class LitLensSettings:
    """Tuned values of `lit_lenses`."""

    gap_step: float = 0.3  # [brightness of a bright lens] least step to visible gaps; set by hand
    bright_quantile: float = 0.95  # of the lenses; bright, without being dust or a hot pixel
    quantile_sample: int = 20_000  # [lenses] from which the quantile is taken
    check_sample: int = 5000  # [lenses] if all of an even sample are lit, all count as lit
    same_lattice: float = 0.02  # [pitch] centres that move by less keep their lit lenses
    positions_per_side: int = 9  # of a grid over the flat at which such moves are measured


DEFAULT = LatticeSettings()
LIT_LENSES = LitLensSettings()
