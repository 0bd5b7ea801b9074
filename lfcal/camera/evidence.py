"""Evidence that a lattice is that of the microimages of a flat, and the probability that follows
from it.

The same evidence is measured for every lattice, kind of camera and kind of flat. No single figure
decides: a logistic function of all of them was fitted to lattices of simulated cameras of all
kinds, right and wrong ones, and of pictures that are no flats (`python -m benchmarks.lattices
fit`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Evidence", "white_probability"]

# Fitted by `python -m benchmarks.lattices fit`: log odds without any evidence, and for each term.
_CONSTANT = -21.2
_WEIGHTS = {"proof": 6.6, "both_proofs": 8.4, "sound": 18.4, "unmatched": -4.3}
# The same for a white image against a scene. Lenses unlike their neighbours have the weight that
# tells a capture of an unfocused camera from its white image: simulated cameras leave it open.
_WHITE_CONSTANT = -7.95
_WHITE_WEIGHTS = {"inside": -2.7, "detail": -3.94, "unlike": -15.0}
# Probability of a lattice that ends the search for others, where the cells have the shape of
# lenses, and where not.
_CERTAIN_BY_SHAPE = 0.96
_CERTAIN = 0.985
# [pitch] error up to which a lattice is right.
_RIGHT = 0.05
# Certainty of a clause that is stated in words.
_STATED = 0.5


class _Ramp(NamedTuple):
    """0 up to `low`, 1 from `high` on, linear between them."""

    low: float
    high: float

    def __call__(self, value: float) -> float:
        return float(min(max((value - self.low) / (self.high - self.low), 0.0), 1.0))


# The limits were chosen on random cameras (seeds 0 to 300), ray-traced scenes, pictures that are no
# flats (seeds 0 to 130) and the shared captures; other seeds test them.
# Average cell: shares of it, and [ln] light of its middle over that of its border.
_FINE = _Ramp(0.01, 0.06)  # waves have 0.00, blurred arrays of microscopes 0.09
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
_CIRCLES_BESIDE = 0.3
_OVERLAP = _Ramp(0.3, 0.6)  # overlapping discs of white images have 0.65 and more
# [local deviations] steps on outlines, and contrast of the lines between cells that touch.
_OUTLINE = _Ramp(0.1, 0.6)
_BORDERS = _Ramp(0.3, 0.6)
# [ln] scatter of light inside cells and from cell to cell.
_TEXTURED = _Ramp(-4.6, -3.7)
_SOME_DETAIL = _Ramp(-4.8, -4.2)  # letters have -4.1, tiles of single tones -5.3
_DETAILED = _Ramp(-3.5, -2.7)
_UNLIKE_TONES = _Ramp(-3.4, -2.4)
_UNLIKE_TONES_BORDERS = _Ramp(-3.2, -2.6)
_UNEVEN = _Ramp(0.04, 0.12)  # share of lenses; white images have 0.01 at most, tiles 0.14 and more
_BLACK_GAPS = _Ramp(1.0, 2.0)
_TILE_TONES = _Ramp(-4.0, -2.5)
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


@dataclass(frozen=True)
class Evidence:
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

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> evidence = lfcal.calibrate(sample.white).evidence
    >>> evidence.probability > 0.9, evidence.white_probability > 0.9
    (True, True)
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
    overlap: float = 0.0
    parallax: float = 0.0
    still: float = 0.0
    continued: float = 0.0
    classes: float = 0.0
    fit_halves: float | None = None
    inside: float = 0.0
    detail: float = 0.0
    between: float = 0.0
    unlike: float = 0.0

    def with_halves(self, halves: float) -> Evidence:
        """The same with the agreement [pitch] of the halves of the final fit."""
        return replace(self, fit_halves=halves)

    @property
    def probability(self) -> float:
        """Probability that the lattice is right, to a twentieth of the pitch."""
        # The lattices of two halves differ by twice the error of the whole, which has a normal
        # distribution.
        halves = self.halves if self.fit_halves is None else self.fit_halves
        precise = 1 - np.exp(-2 * (_RIGHT / max(halves, 1e-6)) ** 2)
        return float(precise / (1 + np.exp(-self._log_odds())))

    @property
    def rank(self) -> float:
        """What lattices of one flat are sorted by: the log odds, and what goes beyond the proofs
        they need.
        """
        return (
            self._log_odds()
            + 0.5 * (self.parallax + self.outlined)
            + 2 * self.explained
            - 20 * max(self.halves - _RIGHT, 0.0)
        )

    @property
    def is_certain(self) -> bool:
        """Whether no other lattice needs to be tried: parallax alone may be that of a multiple or a
        part of a cell.
        """
        return self.probability > (_CERTAIN_BY_SHAPE if self.by_shape() > 0.9 else _CERTAIN)

    def _log_odds(self) -> float:
        return _CONSTANT + sum(_WEIGHTS[name] * value for name, value in self.terms().items())

    @property
    def outlined(self) -> float:
        """How much cells look like lenses: which centres to try first, before neighbours are
        compared.
        """
        return (
            self.shape
            + self.roundness
            + self.circles
            - self.circles_beside
            + self.outline
            + max(self.borders, 0.0)
        )

    @property
    def white_probability(self) -> float:
        """Probability that the flat is a white image: lenses are evenly lit, and as bright as their
        neighbours.
        """
        return white_probability(self.inside, self.detail, self.unlike)

    def describe(self) -> str:
        """What proves the lattice, or, if nothing does, what speaks against it, in a clause."""
        proofs = []
        if self.by_shape() > _STATED:
            circles = f"circles lie on {max(self.circles, 0.0):.0%} of the lattice points"
            proofs.append(f"the average cell has the shape of a lens, and {circles}")
        if self._content_proof() > _STATED:
            proofs.append("neighbours show the same content, shifted")
        if self._border_proof() > _STATED:
            proofs.append("cells touch each other on straight lines")
        return "; ".join(proofs) or self.describe_doubt()

    def describe_doubt(self) -> str:
        """What speaks most against the lattice, in a clause."""
        terms = self.terms()
        if not np.isfinite(self.halves):
            return "no lattice fits to the parts of the flat"
        if self.halves > _RIGHT:
            return f"the lattices of two halves of the flat differ by {self.halves:.2f} pitches"
        if self._edges() < _STATED:
            return "light and dark places have one shape, as in waves and on boards"
        if self._is_one_lens() < _STATED:
            return "its cells differ by turns: it has two or three points for each lens"
        if self._is_mesh() > _STATED:
            return "one picture goes on from cell to cell, as behind a mesh"
        if self._is_everywhere() < _STATED:
            return "what repeats is content without parallax, and changes across the flat"
        if self.circles_beside > max(self.circles, _CIRCLES_BESIDE):
            return (
                f"circles lie between its points (at {self.circles_beside:.0%} of the places there)"
            )
        if terms["unmatched"] > _STATED and self.inside == 0:
            return "too few of its cells are lit to compare neighbours"
        if terms["unmatched"] > _STATED:
            return "neighbours do not show the same, shifted, though they differ"
        shown = f"circles lie on {max(self.circles, 0.0):.0%} of its points, {self.shape:.0%} of the average cell have"
        return f"{shown} the shape of a lens, and hardly any neighbours show the same, shifted"

    def terms(self) -> dict[str, float]:
        """What the log odds are linear in, each 0 to 1.

        There are three proofs of lenses: the average cell has their shape, with circles at its
        centres or gaps that never change; neighbours match in content, shifted; or lenses touch
        each other on straight lines, and neighbours match. None counts for cells without edges.
        """
        by_shape = self.by_shape()
        content = self._content_proof() * self._edges() * self._is_one_lens()
        by_content = _CONTENT_PROOF(content)
        everywhere = self._is_everywhere()
        return {
            "proof": max(by_shape, by_content, self._border_proof()) * everywhere,
            "both_proofs": min(by_shape, by_content) * everywhere,
            "sound": self._edges() * (1 - self._is_mesh()),
            "unmatched": max(
                self._unmatched_tones(), self._unmatched_content(), self._uneven_white()
            ),
        }

    def by_shape(self) -> float:
        """How far the average cell proves lenses, 0 to 1: its shape, and circles or gaps that never
        change.
        """
        # What neighbours share is no noise.
        scene = self._shows_scene() * _SOME_MATCH(self.parallax)
        windows = _CONTENT_INSIDE(self.content) * scene
        overlap = _OVERLAP(self.overlap)
        shape = _LENS_SHAPE(self.shape) * max(_ALL_CIRCLES(self.circles), windows, overlap)
        shape *= _NOT_ROUND + (1 - _NOT_ROUND) * _ROUND(self.roundness)
        # Gaps of a white image are bright only where microimages overlap.
        shape *= max(_BRIGHT_MIDDLE(self.light), scene, overlap) * (1 - _OVERLAP(-self.overlap))
        return _SHAPE_PROOF(shape * self._edges() * self._is_one_lens())

    def _edges(self) -> float:
        """0 for waves and boards, whose light and dark places have one shape, else 1."""
        return _FINE(self.fine) * (1 - _INVERTED(-self.inverted))

    def _unmatched_tones(self) -> float:
        """How far cells with outlines differ in tone, as tiles do, and do not match, 0 to 1."""
        differ = _TILE_TONES(self.between)
        return _ALL_CIRCLES(self.circles) * differ * (1 - _TILES_MATCH(self.parallax))

    def _unmatched_content(self) -> float:
        """How far cells show detail that their neighbours do not, 0 to 1."""
        textured = _DETAILED(self.inside + self.detail)
        return (
            textured * self._is_angular_scene() * (1 - _SOME_MATCH(max(self.parallax, self.still)))
        )

    def _uneven_white(self) -> float:
        """How far evenly lit cells differ from their neighbours, as tiles do, 0 to 1.

        Lenses of a white image do not, but spots on black may: those of a Shack-Hartmann sensor.
        """
        even = max(self.white_probability, 1 - _SOME_DETAIL(self.inside + self.detail))
        return even * _UNEVEN(self.unlike) * (1 - _BLACK_GAPS(self.light))

    def _is_everywhere(self) -> float:
        """How far what repeats is that of the array, 0 to 1.

        Content that repeats with next to no parallax has a lattice of its own, slightly larger or
        smaller: it matches without a shift, and changes across the flat.
        """
        moved = self.parallax - self.still
        content = _STILL(self.still) * (1 - _MOVED(moved))
        return 1 - content * (1 - _REPEATS(self.repeats))

    def _is_one_lens(self) -> float:
        """1 if all cells have one shape, 0 for half or a third of the cell of an array.

        Three lens types differ by 0.07 at most, half a cell by 0.16 and more.
        """
        return 1 - _ALTERNATING(self.classes)

    def _is_mesh(self) -> float:
        """How far one picture goes on from cell to cell, 0 to 1."""
        behind = _GOES_ON(self.continued - max(self.parallax, self.still, 0.0))
        return behind * self._is_angular_scene()

    def _is_angular_scene(self) -> float:
        """0 for white images and round cells, else 1: the round lenses of an unfocused camera may
        show one picture that goes on, or each its own tone.
        """
        return (1 - self.white_probability) * (1 - _CIRCULAR(self.roundness))

    def _content_proof(self) -> float:
        """How far parallax proves lenses, 0 to 1: neighbours of a scene match, in cells that have
        an outline.
        """
        shape = _ROUGH_SHAPE(self.shape) * _SOME_CIRCLES(self.circles)
        outlined = max(shape, _MANY_CIRCLES(self.circles), _OUTLINE(self.outline))
        symmetric = _HARDLY_ROUND(self.roundness)
        match = _MATCH(self.parallax) * (1 - _HALVES(self.halves))
        # Facing sides of lenses show places far from each other, those of half tiles the same tile.
        match *= 1 - _SIDES_MATCH(self.continued) * self._is_angular_scene()
        return match * self._shows_scene() * outlined * (_NOT_ROUND + (1 - _NOT_ROUND) * symmetric)

    def _border_proof(self) -> float:
        """How far straight borders prove lenses, 0 to 1: they touch, and their neighbours match.

        Tiles, meshes and boards have borders, too; what lies between those does not match (0.12 at
        most on pictures that are no flats; 0.32 and more on arrays without gaps). Letters on a
        screen match now and then, but their cells differ in tone.
        """
        touching = _BORDERS(self.borders) * _SOME_MATCH(self.parallax)
        # Without gaps there is little else in the average cell than content. Parts of cells and
        # letters do not match as whole cells do.
        doubtful = 1 - _STRONG_MATCH(self.parallax)
        touching *= 1 - _ALTERNATING_BORDERS(self.classes) * doubtful
        differ = _UNLIKE_TONES_BORDERS(self.between) * doubtful
        scene = _TEXTURED(self.inside) * (1 - differ)
        return touching * scene * (1 - _HALVES_BORDERS(self.halves))

    def _shows_scene(self) -> float:
        """How far cells show a scene, 0 to 1: neighbours have about one tone, and more than noise."""
        textured = _TEXTURED(self.inside)
        alike = 1 - _UNLIKE_TONES(self.between)
        return textured * alike

    def to_dict(self) -> dict[str, float]:
        """The figures, and the probability that follows from them."""
        figures = {name: value and float(value) for name, value in asdict(self).items()}
        return {
            **figures,
            "probability": self.probability,
            "white_probability": self.white_probability,
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Evidence:
        """Rebuild the record from `to_dict`; figures that older files lack have their defaults."""
        known: dict[str, Any] = {
            field.name: data[field.name] for field in fields(cls) if field.name in data
        }
        figures: dict[str, Any] = {
            name: value if value is None else float(value) for name, value in known.items()
        }
        return cls(**figures)


def white_probability(inside: float, detail: float, unlike: float) -> float:
    """Probability of a white image by three figures of `Evidence`."""
    log_odds = _WHITE_CONSTANT + _WHITE_WEIGHTS["inside"] * inside
    log_odds += _WHITE_WEIGHTS["detail"] * detail + _WHITE_WEIGHTS["unlike"] * unlike
    return float(1 / (1 + np.exp(-log_odds)))
