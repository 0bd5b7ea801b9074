"""Features of a flat that repeat with its lattice: brightness, edges, and steps of brightness from
pixel to pixel.

Each is normalised by its local mean and deviation. Brightness and edges are normalised over two
pitches, so that the light of the scene does not outweigh the rims of the microimages. Steps are
edges normalised over a few pixels: every step counts alike, however strong it is. Elemental images
that touch each other without gaps show their borders in nothing else.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..images.preprocessing import edge_strength, normalise_locally
from ..runtime.arrays import Singles

__all__ = ["FlatFeatures"]

#: [px] side of the square that steps are normalised over: wider than a step, narrower than a lens.
_STEP_WINDOW = 7.0


class FlatFeatures:
    """Features of a picture (h, w), the square root of the luminance, each computed when it is
    first used.

    `stated_white` is 1 if the flat is stated to be a white image, else 0.
    """

    def __init__(self, picture: Singles, stated_white: float = 0.0) -> None:
        self.picture = picture
        self.stated_white = stated_white
        self._levelled: dict[int, tuple[Singles, Singles]] = {}

    @cached_property
    def edges(self) -> Singles:
        """(h, w) edge strength."""
        return edge_strength(self.picture)

    @cached_property
    def steps(self) -> Singles:
        """(h, w) edge strength, normalised over a few pixels."""
        return normalise_locally(self.edges, _STEP_WINDOW)

    def levelled(self, pitch: float) -> tuple[Singles, Singles]:
        """Brightness and edges (h, w), normalised over about two pitches of `pitch` [px]."""
        octave = round(np.log2(2 * pitch))
        if octave not in self._levelled:
            window = float(2**octave)
            brightness = normalise_locally(self.picture, window)
            edges = normalise_locally(self.edges, window)
            self._levelled[octave] = brightness, edges
        return self._levelled[octave]
