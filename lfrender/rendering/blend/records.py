"""What the kernels of blending read and write."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lfcal import Calibration

from ...flat.gray_flat import correction_cell
from ...flat.lens_graph import lens_displacements, lens_offsets
from ...flat.lens_type_weights import focus_weights

__all__ = [
    "AT_EDGES",
    "FARTHEST_SAMPLE",
    "OCCLUDED",
    "ONE_SAMPLE",
    "RIM",
    "Flat",
    "Grid",
    "Lenses",
    "Light",
    "Output",
    "Weighting",
    "tabulate_lenses",
]

#: The weight of a lens falls from this at its centre with the squared distance, and is still above
#: 0 at the rim.
RIM = np.float32(1.02)
#: Factor for a pixel that shows another depth than the surface has: it counts only if all do.
OCCLUDED = np.float32(1e-4)
#: [px^2 of the flat] Output pixels are sampled once if a smaller square is left to average.
ONE_SAMPLE = np.float32(0.25)
#: [px^2 of the flat] Square of the largest distance between samples: pixels and interpolation leave
#: little to alias.
FARTHEST_SAMPLE = np.float32(1.5)
#: [px of the flat] Distance between samples at depth edges, on the largest patches of the pixel:
#: the share of each surface is counted. With 1 or 0.67 px, coarse pictures of four scenes of
#: clutter are 0.03 and 0.02 dB worse.
AT_EDGES = np.float32(0.5)


class Flat(NamedTuple):
    """A part of a flat."""

    pixels: Any  # (h, w, C) array; (h, w) of C values each in one integer for `blend_rows`
    # (h, w) float32 [px]: patch size that pixels of `edged` lenses show, inf where unlit
    depth: Any
    corner: Any  # two int [px]: flat coordinates x, y of the first pixel
    size: Any  # two int [px]: width and height of the whole flat


class Lenses(NamedTuple):
    """The lenses by y, and how those about a scene point are looked up."""

    centres: Any  # (n, 2) float64 [px]
    types: Any  # (n,) int64: row of `shares`
    tables: Any  # (n,) int64: light table of each
    edged: Any  # (n,) bool: `Flat.depth` is known on their pixels
    # (nj, ni) int32: row of lens (i, j) in the arrays above at [j - low[1], i - low[0]]; -1 if none
    rows: Any
    low: Any  # (2,) int64
    origin: Any  # (2,) float64 [px]
    inverse: Any  # (2, 2) float64: of the basis
    # (m, n, 2) of a distorted lattice, from its straight one; (0, 0, 2) if straight
    displacements: Any
    lowest: Any  # (2,) int64: lattice index of the first displacement
    # (k,) float32 [px]: least distance of lenses so many steps apart, the nearest first
    offsets: Any
    steps: Any  # (k, 2) int32: those steps, in lattice indices
    shares: Any  # (types, r) float32: weight of a type over s / D from -1 to 1
    pitch: Any  # float32 [px]


class Light(NamedTuple):
    """Gain that undoes the vignetting over the squared distance from the centre of a lens; its
    inverse square is a weight.
    """

    gains: Any  # (t, k) float32
    step: Any  # float32 [px^2]: distance between entries
    applied: Any  # float32: 1, or 0 where pixels are even already


class Grid(NamedTuple):
    """Pixels of the picture that are drawn."""

    first: Any  # two float64 [px]: scene coordinates of pixel (0, 0) of the whole picture
    spacing: Any  # float [px]
    scale: Any  # float32: pixels per pitch
    start: Any  # two int: column and row of the first pixel of the part that is drawn
    wanted: Any  # (h, w) bool: pixels that `blend_pixels` draws, (0, 0) for all


class Weighting(NamedTuple):
    """Which lenses count, and how much."""

    reach: Any  # float32 [px]: lenses farther from a scene point are not read
    # float32 [px]: lenses are read up to so far from their centres, the viewpoint included
    widest: Any
    # Three float32: x, y [px] and squared radius [px^2] up to which lenses are read about it
    viewpoint: Any
    # float32: difference from the mean colour at which a lens counts a quarter; 0: nearest lens
    # alone
    tolerance: Any
    # (r,) float32 [px^2]: area of the flat that is left to average over s / D from -1 to 1
    squares: Any


class Output(NamedTuple):
    """The picture."""

    image: Any  # (h, w, C) float32
    valid: Any  # (h, w) bool: some lens shows the pixel
    left: Any  # (h, w) bool: `blend_rows` leaves the pixel to `blend_pixels`


def tabulate_lenses(calibration: Calibration, reach: float) -> tuple[Lenses, np.ndarray]:
    """The lenses by y, none of them `edged`, and their order (n,) in the lattice.

    `reach` [px] is that of lenses about a scene point.
    """
    lattice = calibration.lattice
    centres = lattice.centres()
    index = lattice.indices()
    order = np.argsort(centres[:, 1], kind="stable")
    low = index.min(0)
    rows = np.full((index.max(0) - low + 1)[::-1], -1, np.int32)
    rows[tuple((index[order] - low).T[::-1])] = np.arange(len(order))
    cell, shares = focus_weights(calibration.lens_types)
    types, tables = (
        one[tuple((index[order] % len(one)).T)].astype(np.int64)
        if one.size
        else np.zeros(len(order), np.int64)
        for one in (cell, correction_cell(calibration))
    )
    displacements, lowest = lens_displacements(lattice)
    offsets, steps = lens_offsets(lattice, reach)
    lenses = Lenses(
        centres[order],
        types,
        tables,
        np.zeros(len(order), bool),
        rows,
        low,
        lattice.origin,
        np.linalg.inv(lattice.basis),
        displacements,
        lowest,
        np.ascontiguousarray(offsets[:, 2]),
        steps,
        shares,
        np.float32(lattice.pitch),
    )
    return lenses, order
