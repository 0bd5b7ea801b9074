"""Evidence that a lattice is that of the microimages of a flat, and the probability that follows
from it.

The same evidence is measured for every lattice, kind of camera and kind of flat. No single figure
decides: a logistic function of all of them was fitted to lattices of simulated cameras of all
kinds, right and wrong ones, and of pictures that are no flats (`python -m benchmarks.lattices
fit`). The figures are defined in `lattice_figures`, the proofs that they give in `proofs`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from .lattice_figures import LatticeFigures
from .proofs import (
    edges,
    has_equal_halves,
    is_everywhere,
    is_mesh,
    is_one_lens,
    proof_by_borders,
    proof_by_circles,
    proof_by_content,
    proof_by_shape,
    proof_terms,
)

__all__ = ["Evidence"]

# Fitted by `python -m benchmarks.lattices fit`: log odds without any evidence, and for each term.
_CONSTANT = -21.2
_WEIGHTS = {"proof": 6.6, "both_proofs": 8.4, "sound": 18.4, "unmatched": -4.3}
# Probability of a lattice that ends the search for others, where the cells have the shape of
# lenses, and where not.
_CERTAIN_BY_SHAPE = 0.96
_CERTAIN = 0.985
# [pitch] error up to which a lattice is right.
_RIGHT = 0.05
# Certainty of a clause that is stated in words.
_STATED = 0.5
# Share of circles between the points that speaks against a lattice.
_CIRCLES_BESIDE = 0.3


@dataclass(frozen=True)
class Evidence(LatticeFigures):
    """The figures of a lattice, with the probability that follows from them.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> evidence = lfcal.calibrate(sample.white).evidence
    >>> evidence.probability > 0.9, evidence.white_probability > 0.9
    (True, True)
    """

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
        return self.probability > (_CERTAIN_BY_SHAPE if proof_by_shape(self) > 0.9 else _CERTAIN)

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

    def terms(self) -> dict[str, float]:
        """What the log odds are linear in, each 0 to 1."""
        return proof_terms(self)

    def describe(self) -> str:
        """What proves the lattice, or, if nothing does, what speaks against it, in a clause."""
        proofs = []
        if proof_by_shape(self) > _STATED:
            circles = f"circles lie on {max(self.circles, 0.0):.0%} of the lattice points"
            proofs.append(f"the average cell has the shape of a lens, and {circles}")
        if max(proof_by_content(self), proof_by_circles(self)) > _STATED:
            proofs.append("neighbours show the same content, shifted")
        if proof_by_borders(self) > _STATED:
            proofs.append("cells touch each other on straight lines")
        return "; ".join(proofs) or self.describe_doubt()

    def describe_doubt(self) -> str:
        """What speaks most against the lattice, in a clause."""
        terms = self.terms()
        if not np.isfinite(self.halves):
            return "no lattice fits to the parts of the flat"
        if self.halves > _RIGHT:
            return f"the lattices of two halves of the flat differ by {self.halves:.2f} pitches"
        if edges(self) < _STATED:
            return "light and dark places have one shape, as in waves and on boards"
        if has_equal_halves(self) > _STATED:
            return "its cells show the same twice: there are smaller ones"
        if is_one_lens(self) < _STATED:
            return "its cells differ by turns: it has two or three points for each lens"
        if is_mesh(self) > _STATED:
            return "one picture goes on from cell to cell, as behind a mesh"
        if is_everywhere(self) < _STATED:
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

    def to_dict(self) -> dict[str, float]:
        """The figures, and the probability that follows from them."""
        figures = {name: value and float(value) for name, value in asdict(self).items()}
        return {
            **figures,
            "probability": self.probability,
            "white_probability": self.white_probability,
        }
