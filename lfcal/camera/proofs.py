"""Proofs of lenses, and objections to them, that follow from the figures of a lattice.

There are four proofs: the average cell has the shape of a lens; neighbours match in content,
shifted; circles lie on the points, and neighbours match; or lenses touch each other on straight
lines, and neighbours match. Each proof and each objection is a product of shares, 0 to 1, and each
share is a ramp of one figure.
"""

from __future__ import annotations

from typing import NamedTuple

from .lattice_figures import LatticeFigures

__all__ = [
    "edges",
    "is_everywhere",
    "is_mesh",
    "is_one_lens",
    "proof_by_borders",
    "proof_by_circles",
    "proof_by_content",
    "proof_by_shape",
    "proof_terms",
]


class _Ramp(NamedTuple):
    """0 up to `low`, 1 from `high` on, linear between them."""

    low: float
    high: float

    def __call__(self, value: float) -> float:
        return float(min(max((value - self.low) / (self.high - self.low), 0.0), 1.0))


# The limits were chosen on random cameras (seeds 0 to 300, 900 to 929, 1000 to 1259, 1300 to 1339,
# single ones of 1400 to 1579), ray-traced scenes (seeds 0 to 36, 93), pictures that are no flats
# (seeds 0 to 311, 380 to 439) and the shared captures; other seeds test them.
# Average cell: shares of it, and [ln] light of its middle over that of its border.
_FINE = _Ramp(0.01, 0.06)  # waves have 0.00, blurred arrays of microscopes 0.09
_FINER = _Ramp(0.05, 0.08)  # woven cloth has 0.06 at most, and is inverted by 0.89 and more
_HARDLY_INVERTED = _Ramp(0.86, 0.9)  # arrays whose cells are as plain as cloth have 0.86 at most
_INVERTED = _Ramp(0.93, 0.97)  # boards and waves have 0.97 and more, arrays 0.88 at most
_LENS_SHAPE = _Ramp(0.75, 0.97)
_ROUGH_SHAPE = _Ramp(0.55, 0.8)
_ROUND = _Ramp(0.5, 0.95)
_HARDLY_ROUND = _Ramp(0.1, 0.5)
_CIRCULAR = _Ramp(0.8, 0.9)  # discs have 0.9 and more, squares 0.75 at most
_BRIGHT_MIDDLE = _Ramp(0.0, 0.05)
_CONTENT_INSIDE = _Ramp(0.5, 2.0)  # [ln] variance from lens to lens in the middle over that in gaps
_ALTERNATING = _Ramp(0.08, 0.15)  # lens types differ by 0.07 at most, half a cell by 0.16 and more
_ALTERNATING_BORDERS = _Ramp(0.15, 0.3)  # content leaves up to 0.15 where there are no gaps
_REPEATS = _Ramp(0.78, 0.88)  # gaps of real arrays 0.84 and more, content 0.77 at most
# Marks found without the lattice: share of its points.
_SOME_CIRCLES = _Ramp(0.02, 0.12)
_MANY_CIRCLES = _Ramp(0.1, 0.4)
_ALL_CIRCLES = _Ramp(0.0, 1.0)
_FEW_CIRCLES = _Ramp(0.1, 0.25)  # lenses of scenes have 0.23 and more, letters on a grid 0.02
_MOST_CIRCLES = _Ramp(0.5, 0.75)  # boards and letters behind round lenses have 0.72 and more
_RIMS = _Ramp(0.6, 0.9)  # simulated discs that touch have 0.98 and more
_OVERLAP = _Ramp(0.3, 0.6)  # overlapping discs of white images have 0.65 and more
# [local deviations] steps on outlines, and contrast of the lines between cells that touch.
_SOME_OUTLINE = _Ramp(0.0, 0.1)  # dots of print have less than 0, discs 0.14 and more
_BORDERS = _Ramp(0.3, 0.6)
_PLAIN_BORDERS = _Ramp(0.6, 0.85)  # ray-traced square lenses have 0.92 and more, content 0.5
# [ln] scatter of light inside cells and from cell to cell.
_TEXTURED = _Ramp(-4.6, -3.7)
_DETAILED = _Ramp(-3.5, -2.7)
_UNLIKE_TONES = _Ramp(-3.4, -2.4)
_UNLIKE_TONES_BORDERS = _Ramp(-3.2, -2.6)
_DARK_GAPS = _Ramp(0.5, 1.2)  # [ln] light; black gaps of ray-traced scenes have 1.2 and more
_TILE_TONES = _Ramp(-4.0, -2.8)
_BEYOND_INSIDE = _Ramp(1.2, 1.7)  # an unfocused camera has 1.2, other arrays 0.9, tiles 1.7
# [ln] gain of neighbours that are shifted against each other.
_SOME_MATCH = _Ramp(0.2, 0.35)
_MATCH = _Ramp(0.3, 1.0)
_STRONG_MATCH = _Ramp(0.8, 1.3)
_TILES_MATCH = _Ramp(0.0, 0.5)
_STILL = _Ramp(0.2, 0.5)
_MOVED = _Ramp(0.0, 0.15)
_GOES_ON = _Ramp(0.1, 0.3)
_SIDES_MATCH = _Ramp(0.4, 0.8)
# [pitch] difference of the lattices of two halves of the flat.
_HALVES = _Ramp(0.015, 0.05)
_HALVES_BORDERS = _Ramp(0.02, 0.06)
# Strengths of the proofs by shape and by content, as products of several shares.
_SHAPE_PROOF = _Ramp(0.1, 0.7)
_CONTENT_PROOF = _Ramp(0.5, 0.85)
# Share of a proof that is left for cells that are not round.
_NOT_ROUND = 0.6
# The same for dark discs without content: lenses in bright gaps, or a sheet with holes.
_MAY_BE_HOLES = 0.4


def proof_terms(figures: LatticeFigures) -> dict[str, float]:
    """What the log odds are linear in, each 0 to 1.

    There are four proofs of lenses: the average cell has their shape, with circles at its
    centres or gaps that never change; neighbours match in content, shifted; circles lie on the
    points, and neighbours match; or lenses touch each other on straight lines, and neighbours
    match. None counts for cells without edges.
    """
    by_shape = proof_by_shape(figures)
    content = proof_by_content(figures) * edges(figures) * is_one_lens(figures)
    by_content = max(_CONTENT_PROOF(content), proof_by_circles(figures))
    everywhere = is_everywhere(figures)
    return {
        "proof": max(by_shape, by_content, proof_by_borders(figures)) * everywhere,
        "both_proofs": min(by_shape, by_content) * everywhere,
        "sound": edges(figures) * (1 - is_mesh(figures)),
        "unmatched": max(_unmatched_tones(figures), _unmatched_content(figures)),
    }


def proof_by_shape(figures: LatticeFigures) -> float:
    """How far the average cell proves lenses, 0 to 1: its shape, and circles or gaps that never
    change.
    """
    # What neighbours share is no noise.
    textured = max(_TEXTURED(figures.inside), _DETAILED(figures.inside + figures.detail))
    scene = textured * _neighbours_are_alike(figures) * _SOME_MATCH(figures.parallax)
    windows = _CONTENT_INSIDE(figures.content) * scene
    overlap = _OVERLAP(figures.overlap)
    shape = _LENS_SHAPE(figures.shape) * max(_ALL_CIRCLES(figures.circles), windows, overlap)
    shape *= _NOT_ROUND + (1 - _NOT_ROUND) * _ROUND(figures.roundness)
    # Gaps of a white image are bright only where microimages overlap. Dark discs may be holes.
    dark = _MAY_BE_HOLES * _is_disc(figures)
    shape *= max(_BRIGHT_MIDDLE(figures.light), scene, overlap, dark)
    shape *= 1 - _OVERLAP(-figures.overlap)
    return _SHAPE_PROOF(shape * edges(figures) * is_one_lens(figures))


def _is_disc(figures: LatticeFigures) -> float:
    """How far cells are discs of one tone everywhere on the flat, 0 to 1."""
    same = _neighbours_are_alike(figures) * _REPEATS(figures.repeats)
    return _CIRCULAR(figures.roundness) * same


def edges(figures: LatticeFigures) -> float:
    """0 for waves, cloth and boards, whose light and dark places have one shape, else 1.

    Small or blurred lenses of a white image have hardly finer detail than waves, but circles on
    next to all points.
    """
    white = figures.white_probability * _RIMS(figures.circles)
    fine = max(_FINE(figures.fine), white)
    cloth = _HARDLY_INVERTED(-figures.inverted) * (1 - max(_FINER(figures.fine), white))
    return fine * (1 - _INVERTED(-figures.inverted)) * (1 - cloth)


def _unmatched_tones(figures: LatticeFigures) -> float:
    """How far cells with outlines differ in tone, as tiles do, and do not match, 0 to 1.

    Neighbours see a scene from places less than a pitch apart: it changes from lens to lens
    no more than inside lenses.
    """
    outlined = _ALL_CIRCLES(figures.circles) * (1 - _TILES_MATCH(figures.parallax))
    beyond = _BEYOND_INSIDE(figures.between - figures.inside - figures.detail / 2)
    return _TILE_TONES(figures.between) * max(outlined, beyond)


def _unmatched_content(figures: LatticeFigures) -> float:
    """How far cells show detail that their neighbours do not, 0 to 1."""
    textured = _DETAILED(figures.inside + figures.detail)
    return (
        textured
        * _is_angular_scene(figures)
        * (1 - _SOME_MATCH(max(figures.parallax, figures.still)))
    )


def is_everywhere(figures: LatticeFigures) -> float:
    """How far what repeats is that of the array, 0 to 1.

    Content that repeats with next to no parallax has a lattice of its own, slightly larger or
    smaller: it matches without a shift, and changes across the flat. Rims and straight borders
    that show on all sides of the cells are no content.
    """
    moved = figures.parallax - figures.still
    circles = _RIMS(figures.circles) * _ROUND(figures.roundness)
    circles *= _SOME_OUTLINE(figures.outline)
    rims = max(_PLAIN_BORDERS(figures.borders), circles)
    content = _STILL(figures.still) * (1 - _MOVED(moved)) * (1 - rims)
    return 1 - content * (1 - _REPEATS(figures.repeats))


def is_one_lens(figures: LatticeFigures) -> float:
    """1 if all cells have one shape, 0 for half or a third of the cell of an array.

    Three lens types differ by 0.07 at most, half a cell by 0.16 and more.
    """
    return 1 - _ALTERNATING(figures.classes)


def is_mesh(figures: LatticeFigures) -> float:
    """How far one picture goes on from cell to cell, 0 to 1.

    Round cells count if they have detail that does not match.
    """
    behind = _GOES_ON(figures.continued - max(figures.parallax, figures.still, 0.0))
    textured = _TEXTURED(figures.inside) * (1 - _SOME_MATCH(figures.parallax))
    return behind * max(_is_angular_scene(figures), textured)


def _is_angular_scene(figures: LatticeFigures) -> float:
    """0 for white images and round cells, else 1: the round lenses of an unfocused camera may
    show one picture that goes on, or each its own tone.
    """
    return (1 - figures.white_probability) * (1 - _CIRCULAR(figures.roundness))


def proof_by_content(figures: LatticeFigures) -> float:
    """How far parallax proves lenses, 0 to 1: neighbours of a scene match, in cells that have
    an outline.
    """
    shape = _ROUGH_SHAPE(figures.shape) * _SOME_CIRCLES(figures.circles)
    outlined = max(shape, _MANY_CIRCLES(figures.circles))
    symmetric = _HARDLY_ROUND(figures.roundness)
    match = _MATCH(figures.parallax) * (1 - _HALVES(figures.halves))
    # Facing sides of lenses show places far from each other, those of half tiles the same tile.
    match *= 1 - _SIDES_MATCH(figures.continued) * _is_angular_scene(figures)
    return match * _shows_scene(figures) * outlined * (_NOT_ROUND + (1 - _NOT_ROUND) * symmetric)


def proof_by_circles(figures: LatticeFigures) -> float:
    """How far circles prove lenses, 0 to 1: they lie on the points, and neighbours match, shifted.

    Either on most points, or on some of them where the average cell has the shape of a lens.
    """
    circles = figures.circles - max(figures.circles_beside, 0.0)
    shape = _LENS_SHAPE(figures.shape) * _REPEATS(figures.repeats) * is_one_lens(figures)
    shape *= _SOME_OUTLINE(figures.outline) * (1 - _UNLIKE_TONES(figures.between))
    most = _MOST_CIRCLES(circles) * _ROUGH_SHAPE(figures.shape)
    circular = max(most, _FEW_CIRCLES(circles) * shape)
    match = _SOME_MATCH(figures.parallax) * _shows_scene(figures)
    return circular * match * edges(figures)


def proof_by_borders(figures: LatticeFigures) -> float:
    """How far straight borders prove lenses, 0 to 1: they touch, and their neighbours match.

    Tiles, meshes and boards have borders, too; what lies between those does not match (0.12 at
    most on pictures that are no flats; 0.32 and more on arrays without gaps). Letters on a
    screen and threads of a cloth match now and then, but their cells differ in tone, and have no
    dark gaps on straight lines.
    """
    touching = _BORDERS(figures.borders) * _SOME_MATCH(figures.parallax)
    # Without gaps there is little else in the average cell than content. Parts of cells and
    # letters do not match as whole cells do.
    doubtful = 1 - _STRONG_MATCH(figures.parallax)
    touching *= 1 - _ALTERNATING_BORDERS(figures.classes) * doubtful
    differ = _UNLIKE_TONES_BORDERS(figures.between) * doubtful
    gaps = _PLAIN_BORDERS(figures.borders) * _DARK_GAPS(figures.light) * is_one_lens(figures)
    differ *= 1 - gaps
    scene = _TEXTURED(figures.inside) * (1 - differ)
    return touching * scene * (1 - _HALVES_BORDERS(figures.halves))


def _shows_scene(figures: LatticeFigures) -> float:
    """How far cells show a scene, 0 to 1: neighbours have about one tone, or match well, and more
    than noise.
    """
    return _TEXTURED(figures.inside) * _neighbours_are_alike(figures)


def _neighbours_are_alike(figures: LatticeFigures) -> float:
    """How far neighbours have one tone, or match well, 0 to 1."""
    return 1 - _UNLIKE_TONES(figures.between) * (1 - _STRONG_MATCH(figures.parallax))
