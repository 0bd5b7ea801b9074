"""Measure the evidence that a lattice is that of the microimages of a flat (`camera.evidence`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..camera.evidence import Evidence
from ..hough.circle_vote import Circles
from ..lattice.lattice import Lattice
from ..microimage.lit import STRAY, is_lit
from ..runtime.arrays import Floats, Singles
from .borders import LineProfile
from .cell_maps import CellMaps, CellParts
from .folding import BINS
from .neighbours import measure_likeness
from .tones import measure_tones

__all__ = ["Marks", "add_overlap", "add_parallax", "half_cell_likeness", "measure_evidence"]

#: Rings of an average cell.
_RINGS = 24
#: Nodes of a piecewise linear function of a distance.
_NODES = 12
#: [pitch] difference of halves that is assumed until it is measured.
_UNKNOWN_HALVES = 0.01
#: Width of the bands in which outlines are looked for, over half the distance to the nearest lens.
_BAND = 0.08
#: Fewer marks tell nothing.
_FEWEST_MARKS = 20
#: Share of the points beside a lattice with circles, from which on these are the lenses.
_RIMS_BESIDE = 0.3
#: [cells] Lines so far from the borders of a lattice are those of another one.
_BORDER_BESIDE = 0.15
#: Shifts [cells] that a wrong lattice may have against the right one.
_SHIFTS = ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (1 / 3, 1 / 3), (2 / 3, 2 / 3))


def measure_evidence(
    maps: CellMaps,
    centre: Floats,
    lattice: Lattice,
    marks: Sequence[Marks],
    lines: Sequence[LineProfile],
) -> Evidence:
    """Evidence from average cells and circles, without parallax and the agreement of halves.

    `centre` (2,) is that of the microimage in fractional coordinates of the maps, `marks` are
    circles and peaks of its pitch, found without the lattice, `lines` the profiles of the steps
    across the two lattice directions.
    """
    parts = CellParts.about(centre, maps.basis)
    middle = parts.middle
    border = parts.border
    content = maps.variance[middle].mean() + 1e-3
    content_beside = maps.variance[border].mean() + 1e-3
    likeness = half_cell_likeness(maps.brightness)
    counts = [_count_marks(one, lattice) for one in marks]
    # Bright gaps have peaks of their own; only lenses have round rims.
    rims_beside = counts[0][1] > max(counts[0][0], _RIMS_BESIDE)
    own, beside = counts[0] if rims_beside else max(counts)
    return Evidence(
        repeats=maps.repeats,
        halves=_UNKNOWN_HALVES,
        roundness=0.5 * (_roundness(maps.brightness, parts) + _roundness(maps.edges, parts)),
        light=float(
            np.log((maps.light[middle].mean() + 1e-3) / (maps.light[border].mean() + 1e-3))
        ),
        content=float(np.log(content / content_beside)),
        outline=_measure_outline(maps.steps, parts),
        circles=own,
        circles_beside=beside,
        fine=_fine_share(maps.brightness),
        inverted=min(likeness),
        repeated=max(likeness),
        explained=maps.explained(),
        shape=_shape_share(maps, parts, centre),
        **_measure_borders(lattice, centre, lines),
    )


def _measure_borders(
    lattice: Lattice, centre: Floats, lines: Sequence[LineProfile]
) -> dict[str, float]:
    """`borders` and `borders_beside`; 0 for hexagonal arrays, whose cells have no straight borders
    through the flat.
    """
    if len(lattice.steps) == 6:
        return {"borders": 0.0, "borders_beside": 0.0}
    places = (centre + 0.5) % 1
    strongest = np.array([line.strongest for line in lines])
    away = np.abs((strongest - places + 0.5) % 1 - 0.5)
    own = min(line.contrast(place) for line, place in zip(lines, places, strict=True))
    beside = min(line.contrast(line.strongest) for line in lines)
    return {"borders": own, "borders_beside": beside if away.max() > _BORDER_BESIDE else 0.0}


def add_overlap(evidence: Evidence, wide: Marks, lattice: Lattice) -> Evidence:
    """The evidence with `wide` circles, of microimages that overlap their neighbours."""
    own, beside = _count_marks(wide, lattice)
    return replace(evidence, overlap=own - max(beside, 0.0))


def add_parallax(evidence: Evidence, picture: Singles, lattice: Lattice) -> Evidence:
    """The evidence with parallax between neighbours on a picture (h, w), the root of the light."""
    likeness = measure_likeness(picture, lattice)
    tones = measure_tones(picture, lattice)
    if likeness is None or tones is None:
        return evidence
    return replace(evidence, **likeness._asdict(), **tones._asdict())


def _roundness(cell: Floats, parts: CellParts) -> float:
    """Share of the variance of a map (bins, bins) that its mean in rings explains."""
    ring = np.minimum(
        (parts.distance / parts.distance.max() * _RINGS).astype(int), _RINGS - 1
    ).ravel()
    rest = cell.ravel() - cell.mean()
    total = np.bincount(ring, rest, _RINGS)
    count = np.bincount(ring, minlength=_RINGS)
    return float((total**2 / np.maximum(count, 1)).sum() / max(float(rest @ rest), 1e-30))


def _shape_share(maps: CellMaps, parts: CellParts, centre: Floats) -> float:
    """Share of the average cell that is the sum of functions of the distances from the centre, from
    the border, and from the sides of a square, about which gaps may have different widths.
    """
    places = (np.arange(BINS) + 0.5) / BINS
    along, down = np.abs((places - centre[:, None] + 0.5) % 1 - 0.5)
    lengths = np.hypot(*maps.basis.T)
    square = np.maximum(along * lengths[0], down[:, None] * lengths[1])
    columns = []
    for distance in (parts.distance.ravel(), parts.to_border.ravel(), square.ravel()):
        place = (distance - distance.min()) / max(float(np.ptp(distance)), 1e-12) * (_NODES - 1)
        columns.append(np.clip(1 - np.abs(place[:, None] - np.arange(_NODES)), 0, None))
    design = np.hstack(columns)
    cells = np.column_stack([_smooth(cell).ravel() for cell in (maps.brightness, maps.edges)])
    cells = cells - cells.mean(0)
    normal = design.T @ design + 1e-6 * len(design) * np.eye(design.shape[1])
    fitted = design @ np.linalg.solve(normal, design.T @ cells)
    left = ((cells - fitted) ** 2).sum(0) / np.maximum((cells**2).sum(0), 1e-30)
    return float(1 - left.mean())


def _smooth(cell: Floats) -> Floats:
    for axis in (0, 1):
        cell = (np.roll(cell, 1, axis) + 2 * cell + np.roll(cell, -1, axis)) / 4
    return cell


def _measure_outline(steps: Floats, parts: CellParts) -> float:
    """Steps on the strongest outline of a lens, round or along the border, less those in the
    middle.
    """
    bands = [
        (parts.distance >= low) & (parts.distance < low + _BAND)
        for low in np.arange(0.6, 1.05, _BAND)
    ]
    bands += [
        (parts.to_border >= low) & (parts.to_border < low + _BAND)
        for low in np.arange(0.0, 0.4, _BAND)
    ]
    outline = max(float(steps[band].mean()) for band in bands if band.any())
    return outline - float(steps[parts.middle].mean())


def _fine_share(cell: Floats) -> float:
    power = np.abs(np.fft.fft2(cell - cell.mean())) ** 2
    order = np.abs(np.fft.fftfreq(BINS) * BINS)
    first = (order[:, None] <= 1) & (order <= 1)
    return 1 - float(power[first].sum() / max(float(power.sum()), 1e-30))


def half_cell_likeness(cell: Floats) -> list[float]:
    """Correlations of a map with itself, shifted by half a cell in three lattice directions."""
    rest = cell - cell.mean()
    half = BINS // 2
    moved = [np.roll(rest, shift, (0, 1)) for shift in ((half, 0), (0, half), (half, half))]
    energy = max(float((rest * rest).sum()), 1e-30)
    return [float((rest * one).sum()) / energy for one in moved]


@dataclass(frozen=True)
class Marks:
    """Circles or peaks found without a lattice, and how much of the flat between them is lit."""

    centres: Floats  # (n, 2) [px]
    lit_area: float  # [px^2]

    @classmethod
    def of(cls, circles: Circles, picture: Singles, pitch: float) -> Marks:
        """Marks on lit parts of a picture (h, w): noise shows circles on dark ones.

        Light is averaged over three pitches, so that gaps count as lit.
        """
        import cv2

        centres = circles.centres
        if len(centres) < _FEWEST_MARKS:
            return cls(np.zeros((0, 2)), 0.0)
        low = np.maximum(np.floor(centres.min(0)), 0).astype(int)
        high = np.ceil(centres.max(0)).astype(int) + 1
        side = int(3 * pitch) | 1
        mean = cv2.blur(picture[low[1] : high[1], low[0] : high[0]], (side, side))
        lit = is_lit(mean**2, STRAY)
        last = np.array(lit.shape[::-1]) - 1
        column, row = np.clip(np.rint(centres - low).astype(int), 0, last).T
        area = float(lit.mean()) * float((centres.max(0) - centres.min(0)).prod())
        return cls(centres[lit[row, column]], area)


def _count_marks(marks: Marks, lattice: Lattice) -> tuple[float, float]:
    """Shares of lit lattice points with a mark, of this lattice and of it shifted, beyond chance; 0
    for few marks.
    """
    if len(marks.centres) == 0:
        return 0.0, 0.0
    area = abs(float(np.linalg.det(lattice.basis)))
    points = max(marks.lit_area / area, 1.0)
    index = lattice.to_index(marks.centres)
    near = 0.15 * lattice.pitch
    chance = min(len(marks.centres) / points * np.pi * near**2 / area, 0.5)

    low = np.floor(index.min(0)) - 1
    columns = float(np.ceil(np.ptp(index[:, 0]))) + 4

    def share(shift: Floats) -> float:
        whole = np.rint(index - shift)
        away = np.hypot(*((index - shift - whole) @ lattice.basis).T)
        number = (whole - low) @ [1.0, columns]
        found = len(np.unique(number[away < near]))
        # Of the points, and of the marks: a lattice too fine has points, one too coarse marks
        # without the other.
        both = min(found / points, found / len(marks.centres))
        return float((both - chance) / (1 - chance))

    return share(np.zeros(2)), max(share(np.array(shift)) for shift in _SHIFTS)
