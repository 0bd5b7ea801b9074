"""The presets of an analysis, `"fast"`, `"balanced"` and `"accurate"`: how much time each stage spends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["PRESETS", "Preset"]

# Merging more pixels than this each way loses a precision of a twentieth of a pixel of the flat.
_MAX_REDUCTION = 3


@dataclass(frozen=True)
class Preset:
    """How much time each stage of an analysis spends."""

    # [px] the flat is reduced by a whole factor to about this pitch for the search over all shifts
    search_pitch: float
    step: float  # [px of the reduced flat] between the shifts that are tried
    # [px] the same where the flat is not reduced: blur of the microlenses makes it less sharp than a reduced flat
    full_step: float
    row_step: int  # only every `row_step`-th row of pixels is matched
    iterations: int  # Gauss-Newton steps of the sub-pixel refinement, at most
    last_step: float = 0.02  # [px] a step shorter than this ends the refinement
    # [px] the whole analysis runs on a flat reduced by a whole factor that leaves at least this pitch
    least_pitch: float = np.inf
    surface_cells: int = 7  # grid values of the surface per pitch
    second_layer: bool = True  # what the first depth of a lens leaves unexplained is matched again
    edges: bool = False  # depth edges of the surface are located on the pixels

    def factor(self, pitch: float) -> int:
        """How many pixels of the flat, each way, are merged into one for the whole analysis."""
        return max(1, min(_MAX_REDUCTION, int(pitch / self.least_pitch)))


_BALANCED = Preset(search_pitch=24, step=0.75, full_step=1.0, row_step=2, iterations=5, edges=True)

PRESETS = {
    "fast": Preset(
        search_pitch=16,
        step=1.0,
        full_step=1.0,
        row_step=1,
        iterations=3,
        last_step=0.04,
        least_pitch=11,
        surface_cells=5,
        second_layer=False,
    ),
    "balanced": _BALANCED,
    "accurate": _BALANCED,
}
