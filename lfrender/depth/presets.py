"""How much time each stage of an analysis spends: presets `"fast"`, `"balanced"`; shortcuts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import get_args

from ..runtime.choices import Shortcut, check_choice

__all__ = ["PRESETS", "Preset", "Shortcuts"]


@dataclass(frozen=True)
class Preset:
    """How much time each stage of an analysis spends."""

    # [px] the flat is reduced by a whole factor to about this pitch for the search over all shifts
    search_pitch: float
    step: float  # [px of the reduced flat] between the shifts that are tried
    # [px] the same where the flat is not reduced: blur of the microlenses makes it less sharp than
    # a reduced flat
    full_step: float
    row_step: int  # only every `row_step`-th row of pixels is matched
    iterations: int  # Gauss-Newton steps of the sub-pixel refinement, at most
    last_step: float  # [px] a step shorter than this ends the refinement
    # [px] the whole analysis runs on a flat reduced by a whole factor that leaves at least this
    # pitch; 0 never reduces
    least_pitch: float
    surface_cells: int  # grid values of the surface per pitch
    # What the first depth of a lens leaves unexplained is matched again, and depth edges are
    # located on the pixels.
    second_layer: bool
    edges: bool

    def factor(self, pitch: float) -> int:
        """How many pixels of the flat, each way, are merged into one for the whole analysis; more
        than three lose precision.
        """
        return max(1, min(3, int(pitch / self.least_pitch))) if self.least_pitch else 1


PRESETS = {
    "fast": Preset(16, 1.0, 1.0, 1, 3, 0.04, 11, 5, False, False),
    "balanced": Preset(24, 0.75, 1.0, 2, 5, 0.02, 0, 7, True, True),
}


@dataclass(frozen=True)
class Shortcuts:
    """Which shortcuts an analysis takes."""

    blank: bool = True  # lenses without texture are not matched
    ranges: bool = (
        True  # most lenses are matched only near patch sizes that occur in a sparse sample of them
    )
    still: bool = True  # lenses whose pixels equal those of the previous frame keep their depth
    steady: bool = True  # so do lenses that still match at the depth they had. Needs `still`

    @classmethod
    def of(cls, skip: bool | Iterable[str]) -> Shortcuts:
        """All, none, or those with the given names; ValueError if there is no shortcut of such a
        name.
        """
        names = get_args(Shortcut)
        wanted = (
            names * skip
            if isinstance(skip, bool)
            else (skip,)
            if isinstance(skip, str)
            else tuple(skip)
        )
        for name in wanted:
            check_choice(name, Shortcut, "skip (True, False, or several)")
        return cls(**{name: name in wanted for name in names})
